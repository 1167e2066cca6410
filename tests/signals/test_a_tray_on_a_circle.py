"""PR2 carries a tray round a circle, written in the scenario and read from a file."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenario_files import needs_robots

from coopqp.execution.controller_run import run
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.signals import Waypoints
from coopqp.trace import Trace

CENTER, RADIUS, PERIOD = np.array([0.55, 0.0, 0.75]), 0.08, 4.0
AFTER = 1.5  # when the tray has come onto the circle [s]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return replace(load("pr2_circle"), duration=2.5)


@pytest.fixture(scope="module")
def trace(scenario: Scenario) -> Trace:
    return run(scenario, controller="qp")


@needs_robots
def test_the_tray_goes_round_and_stays_level(trace: Trace) -> None:
    on = trace.t > AFTER
    radius = np.linalg.norm(trace.position[on] - CENTER, axis=1)
    np.testing.assert_allclose(radius, RADIUS, atol=1e-3)
    angle = np.unwrap(np.arctan2(*(trace.position[on] - CENTER).T[[1, 0]]))
    np.testing.assert_allclose(np.diff(angle) * 100.0, 2.0 * math.pi / PERIOD, rtol=0.02)
    tilt = np.degrees(np.arccos(np.minimum(trace.rotation[:, 2, 2], 1.0)))
    assert tilt.max() < 0.01, "degrees"
    assert set(trace.status) == {"OPTIMAL"}


@needs_robots
def test_the_same_from_a_file_is_the_same_motion(
    scenario: Scenario, trace: Trace, tmp_path: Path
) -> None:
    """Forty points a second of the circle's closed form, with its ramp of one second."""
    lines = ["t,x,y,z"]
    for t in np.linspace(0.0, 3.0, 121).tolist():
        x = min(t, 1.0)
        angle = 2.0 * math.pi / PERIOD * (x**3 * (1.0 - 0.5 * x) + max(t - 1.0, 0.0))
        p = CENTER + RADIUS * np.array([math.cos(angle), math.sin(angle), 0.0])
        lines.append(",".join(map(repr, [t, *p.tolist()])))
    path = tmp_path / "circle.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    first, *others = scenario.tasks
    tasks = (replace(first, goal=Waypoints(file=path)), *others)  # type: ignore[call-arg]
    again = run(replace(scenario, tasks=tasks), controller="qp")
    np.testing.assert_allclose(again.position, trace.position, atol=2e-5)
