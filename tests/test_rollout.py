"""A run is the same however it is done: at once or tick by tick, with the kernel or without."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from laws import LIMITS, NEAR, problem
from side_by_side import needs_kernel

from coopqp.assessment import assess
from coopqp.base.errors import MissingDependencyError
from coopqp.controller import ControlProblem, Law
from coopqp.controllers import QPController
from coopqp.execution import instants
from coopqp.execution.controller_run import run
from coopqp.execution.rollout import rollout
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.plant import Disturbance
from coopqp.plants import Kinematic
from coopqp.scenario.loader import load, shipped
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status
from coopqp.tasks import JointCentering, PointOnPoint, Twist
from coopqp.trace import TickBatch, Trace

pytestmark = needs_kernel

TICKS = 25  # of a phase
#: What the law decides, and from what: the same bits, whoever looks at it.
DECIDED = {"q", "v", "t", "commanded", "loop_offset", "memory", "scale", "compiled", "status"}


@cache
def shortened(name: str) -> Scenario:
    """A shipped scenario without masses, of a few ticks; each phase of as many."""
    try:
        scenario = load(name)
    except MissingDependencyError as error:
        pytest.skip(str(error))
    if scenario.plant.takes_torques:
        pytest.skip("the plant has masses")
    few = TICKS * scenario.dt
    phases = tuple(replace(phase, duration=few) for phase in scenario.phases)
    return replace(scenario, duration=0.0 if phases else few, phases=phases)


def looked_at(scenario: Scenario, law: str, monkeypatch: pytest.MonkeyPatch) -> Trace:
    """The trace in which every instant was looked at with pinocchio and the tasks' own code."""
    with monkeypatch.context() as patched:
        patched.setattr(instants, "survey", lambda *_: None)
        return run(scenario, controller=law)


def check_equal(one: Trace, other: Trace, atol: float) -> None:
    """All fields but the times of ticks; those that are decided to the last bit."""
    for field in fields(Trace):
        if field.name not in ("tick_us", "rows_us"):
            exact = field.name in DECIDED
            _check(field.name, getattr(one, field.name), getattr(other, field.name), atol, exact)


def _check(name: str, one: Any, other: Any, atol: float, exact: bool) -> None:
    if isinstance(one, dict):
        assert list(one) == list(other), name
        for key, value in one.items():
            _check(f"{name} {key}", value, other[key], atol, exact)
    elif not isinstance(one, np.ndarray):
        assert one == other, name
    elif exact or atol == 0.0 or one.dtype == bool:
        np.testing.assert_array_equal(one, other, err_msg=name)
    else:
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=atol, err_msg=name)


@pytest.mark.few(6)
@pytest.mark.parametrize("name", list(shipped()))
def test_a_shipped_run_is_its_ticks(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bit for bit; and what was computed at the end is what would be seen on the way."""
    scenario = shortened(name)
    for law in scenario.controllers:
        timed, untimed = (run(scenario, controller=law, timed=asked) for asked in (True, False))
        assert np.isfinite(timed.tick_us).all()
        check_equal(untimed, timed, 0.0)
        check_equal(timed, looked_at(scenario, law, monkeypatch), 1e-12)


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many ticks were asked for at once, whenever they were."""
    found: list[int] = []
    kept = Law.run

    def counted(self: Law, state: State, ticks: int) -> TickBatch:
        found.append(ticks)
        return kept(self, state, ticks)

    monkeypatch.setattr(Law, "run", counted)
    return found


def test_untimed_runs_are_done_at_once(runs: list[int]) -> None:
    scenario = shortened("planar_pair")
    for law in scenario.controllers:
        assert np.isnan(run(scenario, controller=law, timed=False).tick_us).all()
        run(scenario, controller=law)
    assert runs == [TICKS] * len(scenario.controllers)


@pytest.mark.parametrize(
    "change",
    [
        {"disturbance": Disturbance(link_length=1e-3)},
        {"tasks": (JointCentering(gain=1.0),)},
        {"plant": "rigid_body"},
    ],
    ids=["a model with errors", "rows for all joints", "a plant with masses"],
)
def test_what_has_to_be_looked_at_is_done_tick_by_tick(
    change: dict[str, Any], runs: list[int]
) -> None:
    given = shortened("planar_pair")
    if change.get("plant"):
        change = {"plant": given.catalog.entries("plants")["rigid_body"].cls()}
    scenario = replace(given, **change)
    traces = [run(scenario, controller="qp", timed=asked) for asked in (True, False)]
    assert runs == []
    assert all(np.isfinite(trace.tick_us).all() for trace in traces)
    check_equal(*traces, 0.0)


class Runaway(Law):
    """Goes faster and faster."""

    def decide(self, state: State) -> Any:
        self.command.v[:] = 1e6 * (1.0 + 1e3 * np.abs(state.v))
        self.command.say(Status.OPTIMAL)
        return self.command


def test_joints_that_run_away_stop_where_they_do_tick_by_tick(chain: ClosedChain) -> None:
    given = problem(chain, PointOnPoint(goal=NEAR))
    traces = [_rolled(given, Runaway(given), timed=asked) for asked in (True, False)]
    assert assess(traces[0]).ended
    check_equal(*traces, 0.0)


def test_a_velocity_is_missed_by_what_the_joints_do(
    chain: ClosedChain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A task that asks for a velocity is judged by J v, which the kernel computes, too."""
    twist = Twist(velocity={"x": 0.05, "z": 0.02, "rot_y": 0.3})
    given = problem(chain, twist, PointOnPoint(goal=NEAR), limits=LIMITS)
    found = _rolled(given, QPController().build(given), timed=False)
    monkeypatch.setattr(instants, "survey", lambda *_: None)
    other = _rolled(given, QPController().build(given), timed=False)
    assert found.task_error[:, 0].max() > 1e-3
    check_equal(found, other, 1e-12)


def _rolled(given: ControlProblem, law: Law, *, timed: bool) -> Trace:
    plant = Kinematic().build(given, 0, Disturbance())
    return rollout(law, plant, 30, controller="law", solver=None, timed=timed)
