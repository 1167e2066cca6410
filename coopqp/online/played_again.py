"""The scenario of a session: as it was begun, fed from files, as long as it took."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.limits import JointAcceleration
from coopqp.phase_run import PhaseRun
from coopqp.recordings.sent import fed
from coopqp.scenario.scenario import Scenario
from coopqp.scenario.yaml import parsed


def played_again(
    scenario: Scenario, runs: Sequence[PhaseRun], feeds: Mapping[str, Path]
) -> Scenario:
    """The scenario of a session, in Python."""
    inputs = {
        name: replace(settings, feed=None, feed_file=feeds.get(name))
        for name, settings in scenario.inputs.items()
    }
    found = replace(scenario, inputs=inputs)
    if not runs:
        return found
    phases = tuple(replace(run.phase, duration=_duration(run)) for run in runs)
    if scenario.phases:
        return replace(found, phases=phases)
    return replace(found, duration=phases[0].duration)


def _duration(run: PhaseRun) -> float:
    return run.ticks * run.problem.dt


def scenario_text(
    scenario: Scenario,
    given: Scenario,
    controller: str,
    runs: Sequence[PhaseRun],
    feeds: Mapping[str, Path],
    folder: Path,
) -> str:
    """The same as the text of a scenario file.

    A reference must arrive before the end of its phase, so a phase that was cut short is written
    with the time that its references take.
    """
    data = dict(parsed(Path(given.name), given.source).data)
    for key in ("start_deg", "start_near"):
        data.pop(key, None)
    data["start"] = {name: np.asarray(x, float).tolist() for name, x in scenario.start.items()}
    if not scenario.chain.starts_inside:
        data["start_outside"] = True
    if controller in data.get("grasp_of", {}):
        data["grasp"] = data.pop("grasp_of")[controller]
        data.pop("grasps", None)
    if scenario.held.pose != given.held.pose:
        _place_object(data, scenario)
    _add_limits(data, scenario)
    if scenario.inputs:
        data["inputs"] = fed(data["inputs"], _seen_from(None if scenario.folder else folder, feeds))
    if scenario.folder:
        data["folder"] = str(scenario.folder)
    _set_durations(data, runs)
    return json.dumps(data, indent=2) + "\n"


def text_of_begun(scenario: Scenario, given: Scenario, controller: str) -> str:
    """The text of a scenario as begun, not fed; empty where it has none."""
    if not scenario.source:
        return ""
    return scenario_text(scenario, given, controller, (), {}, Path())


def _place_object(data: dict[str, Any], scenario: Scenario) -> None:
    """Where the object is, instead of where it is in the hands that hold it."""
    pose = scenario.held.pose
    assert pose is not None
    where = {"position": list(pose.position), "rpy": list(pose.angles)}
    data["object"] = {**(data.get("object") or {}), "pose": where}
    one, by_arm = data.pop("grasp", "rigid"), data.pop("grasps", None) or {}
    holders, grasps = scenario.chain.hold.holders, {}
    for arm in (arm.name for arm in scenario.robot_model.arms):
        slot = by_arm.get(arm, one)
        if arm in holders and isinstance(slot, dict):
            ((name, keys),) = slot.items()
            slot = {name: {k: v for k, v in (keys or {}).items() if k != "object_in_hand"}}
        grasps[arm] = slot
    data["grasps"] = grasps


def _add_limits(data: dict[str, Any], scenario: Scenario) -> None:
    """The acceleration limit, where the loop has added it."""
    written = data.get("limits", ["joint_position", "joint_velocity"])
    if len(written) < len(scenario.limits):
        limit = scenario.limits[-1]
        assert isinstance(limit, JointAcceleration)
        keys = {"max": limit.max, "joints": limit.joints, "margin": limit.margin}
        data["limits"] = [*written, {"joint_acceleration": keys}]


def _seen_from(folder: Path | None, feeds: Mapping[str, Path]) -> dict[str, str]:
    """Paths of what was sent, from a folder if one is given."""
    return {
        name: str(path.relative_to(folder) if folder else path.resolve())
        for name, path in feeds.items()
    }


def _set_durations(data: dict[str, Any], runs: Sequence[PhaseRun]) -> None:
    if not runs:
        return
    lasted = [max(_duration(run), *(task.end for task in run.phase.tasks)) for run in runs]
    if "phases" in data:
        pairs = zip(data["phases"], lasted, strict=False)  # those that there were
        data["phases"] = [{**phase, "duration": duration} for phase, duration in pairs]
    else:
        data["duration"] = lasted[0]
