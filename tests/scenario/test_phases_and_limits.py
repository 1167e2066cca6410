"""Stops, accelerations and secondary tasks from phase to phase."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenario_files import HEAD, PHASES, TAIL, phased

from coopqp.base.errors import CoopqpError, ScenarioError
from coopqp.execution.controller_run import run

LIMITS = "limits:\n  - joint_position: {}\n  - joint_velocity: {}\n"


@pytest.mark.xfail(strict=True, reason="each phase has a new memory, so that 'stop' is forgotten")
def test_a_stop_lasts_beyond_the_phase(tmp_path: Path) -> None:
    far = "point_on_point: {mode: hard, goal: [2, 0, 0], gain: 50, profile: {kind: step}}"
    near = "point_on_point: {name: up, goal: [0.17, 0.01, 0.07], gain: 5, profile: {duration: 0.2}}"
    phases = "phases:\n"
    for name, task in (("a", far), ("b", near)):
        phases += f"  - name: {name}\n    duration: 0.3\n    tasks:\n      - {task}\n"
    trace = run(phased(tmp_path, HEAD + phases + TAIL + "on_infeasible: stop\n"), controller="qp")
    assert not trace.v[:30].any(), "it stops"
    assert not trace.v[30:].any(), "from then on"


def test_the_audit_of_accelerations_knows_that_a_phase_begins_in_motion(tmp_path: Path) -> None:
    phases = "phases:\n"
    for name in ("a", "b"):
        phases += f"  - name: {name}\n    duration: 0.3\n    tasks:\n"
        phases += "      - twist: {velocity: {y: 0.05}}\n"
    text = HEAD + phases + TAIL + LIMITS + "  - joint_acceleration: {max: 5}\n"
    trace = run(phased(tmp_path, text), controller="qp")
    assert set(trace.status) == {"OPTIMAL"}
    assert np.abs(np.diff(trace.v, axis=0)).max() / trace.dt < 5.0 + 1e-9
    left = [margin.min() for row, margin in trace.margins.items() if row.owner == "acceleration"]
    assert min(left) > -1e-9


def test_an_acceleration_limit_given_up_at_a_regrasp_is_kept_again_soon(tmp_path: Path) -> None:
    phases = "phases:\n"
    for name, z, more in (("alone", 0.037, "    released: [left]\n"), ("both", 0.1, "")):
        phases += f"  - name: {name}\n    duration: 1.0\n{more}    tasks:\n"
        phases += f"      - point_on_point: {{goal: [0.157, 0.068, {z}], gain: 20,"
        phases += " profile: {kind: step}}\n"
    text = HEAD + phases + TAIL + LIMITS + "  - joint_acceleration: {max: 30}\n"
    trace = run(phased(tmp_path, text), controller="qp")
    assert trace.status[150:].count("ACCELERATION_GIVEN_UP") == 0
    assert np.abs(trace.v[150:]).max() < 3.0, "at rest or nearly so, not at full speed"


@pytest.mark.parametrize(
    "task",
    [
        "relative_motion: {arm: left, profile: {kind: step}}",  # left is the first arm in 'alone'
        "minimum_kinetic_energy: {}",  # which needs the masses of a hinge that swings
    ],
)
def test_a_secondary_task_that_fails_in_any_phase_is_refused_when_loaded(
    tmp_path: Path, task: str
) -> None:
    text = HEAD + PHASES + TAIL + f"secondary:\n  - {task}\n"
    if "relative" in task:
        text = text.replace("released: [left]", "released: [right]")
    else:
        text = text.replace("{rigid: {}}", "{revolute: {axis: [1, 0, 0]}}")
    try:
        made = phased(tmp_path, text)
    except ScenarioError:
        return
    try:
        run(made, controller="qp")
    except CoopqpError as error:
        pytest.fail(f"in the middle of the run: {error}")
