"""Motions that went wrong when strangers tried them: frozen, rattling, never back inside.

The scenarios in ``motion/`` are theirs. How often a joint changes its sign is counted here anew,
not by the stress test's own detectors.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conflicts import slightly_open
from laws import problem, ticks
from scenario_files import HAS_ROBOTS

from coopqp.assessment import assess
from coopqp.base.spec import Array
from coopqp.controllers import QPController
from coopqp.execution.controller_run import run
from coopqp.limits import JointPosition, JointVelocity, Workspace
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.scenario.loader import load
from coopqp.solver import Status, causes_of
from coopqp.tasks import PointOnPoint
from coopqp.trace import Trace

MOTION = Path(__file__).parent / "motion"
FROZEN = ("freeze_kappa0", "k0_planar_pair", "k0_three_ur")
STALLED = ("recover_stall_hard", "recover_stall_weights")
RATTLED = ("roll_10078", "roll_10163", "roll_10325", "recover_stall_weights")


def path(name: str) -> Path:
    if name == "k0_three_ur" and not HAS_ROBOTS:
        pytest.skip("needs example-robot-data")
    return MOTION / f"{name}.yaml"


@cache
def ran(name: str) -> Trace:
    return run(load(path(name)), controller="qp")


def flips(trace: Trace, least: float) -> float:
    """Share of the second half's ticks in which some joint turns round at a share of its speed."""
    v = trace.v[trace.ticks // 2 :] / trace.velocity
    back_and_forth = (v[1:] * v[:-1] < 0.0) & (np.minimum(abs(v[1:]), abs(v[:-1])) > least)
    return float(back_and_forth.mean(axis=0).max())


def outside(trace: Trace) -> Array:
    beyond: Array = np.maximum(trace.lower - trace.q, trace.q - trace.upper).max(axis=1)
    return np.maximum(beyond, 0.0)


@pytest.mark.parametrize("name", FROZEN)
@pytest.mark.parametrize("kappa", ["omitted", "zero"])
def test_arms_do_not_freeze_at_the_loop_budget(name: str, kappa: str) -> None:
    """Without a kappa it is 1/dt; with the paper's 0 it is raised as the budget is used up."""
    scenario = load(path(name))
    assert scenario.drift_gain == pytest.approx(1.0 / scenario.dt)
    trace = run(scenario if kappa == "omitted" else replace(scenario, kappa=0.0), controller="qp")
    assert (np.abs(trace.v).max(axis=1) > 0.0).all()
    assert trace.loop_position.max() <= 1e-3
    assert trace.loop_orientation.max() <= 1e-2
    assert (assess(trace).errors <= [task.tolerance for task in trace.tasks]).all()


@pytest.mark.parametrize("name", RATTLED)
def test_no_joint_oscillates(name: str) -> None:
    trace = ran(name)
    assert flips(trace, 0.3) == 0.0
    assert flips(trace, 0.02) == 0.0
    assert not trace.failures


@pytest.mark.parametrize("name", STALLED)
def test_joints_that_start_outside_come_back_before_any_task(name: str) -> None:
    trace = ran(name)
    out = outside(trace)
    assert out[0] > 0.0
    assert (np.diff(out) <= 1e-12).all()
    inside = int(np.flatnonzero(out == 0.0)[0]) if (out == 0.0).any() else trace.ticks
    assert inside * trace.dt < 1.0
    assert (out[inside:] == 0.0).all()
    for status in trace.status[:inside]:
        assert Status.RECOVERING in causes_of(status)


@pytest.mark.parametrize("name", ["outside_yaw", "outside_roll"])
def test_joints_that_cannot_recover_do_not_oscillate(name: str) -> None:
    """Both arms alike, so that the loops leave hardly a way: at first order, none."""
    trace = ran(name)
    assert flips(trace, 0.3) == 0.0
    assert len(trace.failures) < 0.01 * trace.ticks
    assert (np.diff(outside(trace)) <= 1e-12).all()
    assert trace.loop_position.max() <= 1e-3


def test_a_hard_task_that_was_relaxed_holds_again(chain: ClosedChain) -> None:
    """On the way a joint comes to its limit; at the goal nothing is in the way any more."""
    reach = PointOnPoint(name="reach", goal=(0.13, 0.05, 0.03), mode="hard")
    law = QPController().plain(problem(chain, reach, limits=(JointPosition(), JointVelocity())))
    state = law.start()
    seen = [command.status for command in ticks(law, state, 300)]
    assert 0 < seen.count(Status.TASKS_RELAXED) < 100
    assert seen[-50:] == [Status.OPTIMAL] * 50


def test_what_else_was_given_up_is_said_while_joints_come_back() -> None:
    causes = {cause for status in ran("recover_stall_hard").status for cause in causes_of(status)}
    assert Status.RECOVERING in causes
    assert any(
        {Status.RECOVERING, Status.TASKS_RELAXED} <= set(causes_of(status))
        for status in ran("recover_stall_hard").status
    )


def test_a_slip_at_low_speed_does_not_freeze_the_arms(chain: ClosedChain) -> None:
    """20 mrad in one joint, more than 5 % of the speeds takes back in a tick."""
    reach = PointOnPoint(name="reach", goal=(0.13, 0.05, 0.03), profile=Profile(duration=2.0))
    limits = (JointPosition(), JointVelocity(scale=0.05))
    law = QPController().build(problem(chain, reach, limits=limits))
    state, seen = law.start(), []
    for k, command in enumerate(ticks(law, state, 800)):
        if k == 20:
            state.q[3] += 0.02
        seen.append(command.status)
    assert Status.DRIFT_SLOWED in seen
    assert not any(status.relaxed or not status.usable for status in seen[-100:])
    assert state.loop_position_error < 1e-6
    assert np.linalg.norm(state.p_WO - reach.goal) < 5e-4


def test_zero_velocity_for_the_loop_budget_is_a_failed_tick(chain: ClosedChain) -> None:
    """A loop that is open beyond a budget which no step can keep."""
    reach = PointOnPoint(name="reach", goal=(0.13, 0.05, 0.03), profile=Profile(kind="step"))
    law = QPController().plain(problem(chain, reach, limits=(JointPosition(), JointVelocity())))
    state = law.start(slightly_open(chain, 1e-4))
    law.probe.within = lambda state, v: False  # type: ignore[method-assign]
    command = law.tick(state)
    assert command.status is Status.LOOP_BUDGET
    assert not command.status.usable
    assert not command.v.any()


def test_no_solver_takes_half_a_minute_for_a_tick() -> None:
    """Numbers that no solver can do anything with; a bound on iterations ends each try.

    From Python: files may not hold a point that is 1e308 m away.
    """
    scenario = load(path("proxqp_hang"))
    limits = tuple(
        replace(limit, points=((-1e308, 0.0, 0.0),)) if isinstance(limit, Workspace) else limit
        for limit in scenario.limits
    )
    trace = run(replace(scenario, limits=limits, duration=0.2), controller="qp")
    assert len(trace.failures) == trace.ticks
    assert np.median(trace.tick_us) < 1e6
