"""Recording of a loop, and its session on disk, which can be played again.

    OUT/scenario.yaml        the scenario, begun where the robot was, fed from the files
    OUT/inputs/NAME.csv      t: of the tick for which it arrived; sent: when; the value's columns

``coopqp compare OUT/scenario.yaml`` plays it again, with the same law or others. With the same law
on the same plant the joints are bit-equal, if there was no stop and no silence in between.
"""

import json
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.base.table import csv_text
from coopqp.controller import Command
from coopqp.execution.controller_run import PhaseRun
from coopqp.limits import JointAcceleration
from coopqp.model.loop_observer import Observer
from coopqp.model.state import State
from coopqp.recordings.csv_file import FOLDER, InputRows, fed, file_name
from coopqp.scenario.input import Arrival
from coopqp.scenario.planned import FOLLOWED
from coopqp.scenario.scenario import Scenario
from coopqp.scenario.yaml import parsed
from coopqp.signal import Kind

#: Largest part of a session in memory; beyond it a tick itself writes [s].
AT_MOST = 1.0


class _File(InputRows):
    def __init__(self, path: Path, kind: Kind) -> None:
        super().__init__(kind)
        self.path, self.written = path, False

    def flush(self, now: float) -> None:
        if not (lines := self.take(now)):
            return
        whole = self.path.stat().st_size if self.written else 0
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(lines if self.written else self.header + lines)
        except OSError:
            with suppress(OSError):  # a torn row would make the file unreadable
                os.truncate(self.path, whole)
            raise
        self.written = True


class Session:
    """The files of a loop's session; CoopqpError: there is one already, or it cannot be written."""

    def __init__(self, folder: Path, loop: Any, given: Scenario) -> None:
        self._folder, self._loop, self._given = folder, loop, given
        self._sent: dict[str, _File] = {}
        scenario: Scenario = loop.scenario
        try:
            if (folder / "scenario.yaml").exists() or (folder / FOLDER).exists():
                raise CoopqpError(f"'{folder}' holds a session already; name another folder")
            (folder / FOLDER).mkdir(parents=True)
            if scenario.source and scenario.follows:
                plan = csv_text(scenario.follows.columns, 17)
                (folder / FOLLOWED).write_text(plan, encoding="utf-8")
            self._write_scenario()
        except OSError as error:
            raise CoopqpError(f"cannot write to '{folder}': {error.strerror or error}") from error

    def add(self, name: str, kind: Kind, t: float, sent: float, value: Array) -> None:
        if name not in self._sent:
            file = file_name(name, {sent.path.name for sent in self._sent.values()})
            self._sent[name] = _File(self._folder / FOLDER / file, kind)
        self._sent[name].add(t, sent, value)

    def flush(self, now: float) -> None:
        before = self._feeds()
        for sent in self._sent.values():
            sent.flush(now)
        if before != self._feeds():
            self._write_scenario()

    def close(self) -> None:
        self.flush(float("inf"))
        self._write_scenario()

    def replay(self) -> Scenario:
        begun: Scenario = self._loop.scenario
        feeds = self._feeds()
        inputs = {
            name: replace(settings, feed=None, feed_file=feeds.get(name))
            for name, settings in begun.inputs.items()
        }
        lasted = tuple(replace(run.phase, duration=_duration(run)) for run in self._loop.phases)
        if begun.phases and lasted:
            return replace(begun, inputs=inputs, phases=lasted)
        duration = lasted[0].duration if lasted else begun.duration
        return replace(begun, inputs=inputs, duration=duration)

    def _feeds(self) -> dict[str, Path]:
        return {name: sent.path for name, sent in self._sent.items() if sent.written}

    def _write_scenario(self) -> None:
        if text := scenario_text(self._loop, self._given, self._feeds(), self._folder):
            fresh = self._folder / "scenario.new"
            fresh.write_text(text, encoding="utf-8")
            fresh.replace(fresh.with_suffix(".yaml"))


def _duration(run: PhaseRun) -> float:
    return run.ticks * run.problem.dt


def scenario_text(
    loop: Any, given: Scenario, feeds: Mapping[str, Path] | None = None, folder: Path = Path()
) -> str:
    """The scenario of a session as a file's text; empty where it was made in Python.

    A reference must end before its phase, so a phase that was cut short is written with the time
    that its references take.
    """
    scenario: Scenario = loop.scenario
    if not scenario.source:
        return ""
    data = dict(parsed(Path(given.name), given.source).data)
    for key in ("start_deg", "start_near"):
        data.pop(key, None)
    data["start"] = {name: np.asarray(x, float).tolist() for name, x in scenario.start.items()}
    if not scenario.chain.starts_inside:
        data["start_outside"] = True
    if loop.controller in data.get("grasp_of", {}):
        data["grasp"] = data.pop("grasp_of")[loop.controller]
        data.pop("grasps", None)
    if scenario.held.pose != given.held.pose:
        _place_object(data, scenario)
    written = data.get("limits", ["joint_position", "joint_velocity"])
    if len(written) < len(scenario.limits):  # the loop has added one
        limit = scenario.limits[-1]
        assert isinstance(limit, JointAcceleration)
        keys = {"max": limit.max, "joints": limit.joints, "margin": limit.margin}
        data["limits"] = [*written, {"joint_acceleration": keys}]
    if scenario.observer != Observer() or "observer" in data:
        data["observer"] = asdict(scenario.observer)
    _name_files(data, scenario, feeds or {}, folder)
    runs = loop.phases if loop.begun and feeds is not None else ()
    _set_durations(data, [run for run in runs if not run.phase.leads])
    return json.dumps(data, indent=2) + "\n"


def _name_files(
    data: dict[str, Any], scenario: Scenario, feeds: Mapping[str, Path], folder: Path
) -> None:
    """The session's own files, by relative paths where the scenario names no others."""
    away = scenario.folder
    if away:
        data["folder"] = str(away)
    if scenario.follows:
        data |= scenario.keys_with(folder / FOLLOWED)
        away = data["folder"] or data.pop("folder")
    if scenario.inputs:
        paths = {
            name: str(path.resolve() if away else path.relative_to(folder))
            for name, path in feeds.items()
        }
        data["inputs"] = fed(data["inputs"], paths)


def _place_object(data: dict[str, Any], scenario: Scenario) -> None:
    """The object's pose, instead of its place in the hands that hold it."""
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


def _set_durations(data: dict[str, Any], runs: Sequence[PhaseRun]) -> None:
    lasted = [max(_duration(run), *(task.end for task in run.phase.tasks)) for run in runs]
    if lasted and "phases" in data:
        pairs = zip(data["phases"], lasted, strict=False)  # those that there were
        data["phases"] = [{**phase, "duration": duration} for phase, duration in pairs]
    elif lasted:
        data["duration"] = lasted[0]


class Record(Protocol):
    """Records ticks, as :class:`coopqp.online.recording.LiveRecording`; raises nothing."""

    def tick(self, state: State, command: Command, us: float) -> None:
        """Record a tick, before the state advances."""

    def begin(self, state: State, since: float = 0.0) -> None:
        """Go on from another state than the last tick's, as after a stop."""

    def close(self) -> None:
        """Write the rest and the end."""


class Keeper:
    """Session and recording of a loop."""

    def __init__(self, loop: Any, out: Path | None, record: Callable[[Any], Record] | None) -> None:
        self._loop = loop
        self._out, self._make = out, record
        self.session: Session | None = None
        self._record: Record | None = None
        self.fault, self._flushed = "", 0.0

    def begin(self, given: Scenario) -> None:
        if self._out is not None:
            self.session = Session(self._out, self._loop, given)
            self._out, self._flushed = None, 0.0
        self._record = self._make(self._loop) if self._make else None

    def go_on(self) -> None:
        """The loop goes on from another state, as after a stop or in another phase."""
        now = self._loop.phases[-1]
        self._safely("_record", "begin", now.state, now.since)

    def arrived(self, arrivals: Sequence[Arrival]) -> None:
        """Add what arrived and was accepted to the session; write it when it is much."""
        if self.session is None:
            return
        run = self._loop.phases[-1]
        since, t = run.since, run.state.t
        taken = run.state.inputs.arrived
        for name, value, _ in arrivals:
            if name in taken:
                kind = run.inputs.channels[name].kind
                self.session.add(name, kind, since + t, since + taken[name][0], value)
        if since + t - self._flushed > AT_MOST:
            self.flush()

    def tick(self, state: State, command: Command, us: float) -> None:
        self._safely("_record", "tick", state, command, us)

    def flush(self) -> None:
        if self.session is None or not self._loop.phases:
            return
        run = self._loop.phases[-1]
        self._flushed = run.since + run.state.t
        self._safely("session", "flush", self._flushed)

    def close(self) -> None:
        self._safely("_record", "close")
        self._safely("session", "close")
        self.session = self._record = None

    def _safely(self, whose: Literal["session", "_record"], method: str, *given: Any) -> None:
        try:
            if (written := getattr(self, whose)) is not None:
                getattr(written, method)(*given)
        except Exception as error:  # noqa: BLE001 - the robot comes before its record
            self.fault = f"the record is not whole: {error}"
            setattr(self, whose, None)
