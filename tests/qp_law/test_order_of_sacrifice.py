"""What is given up when not everything can hold, in which order, and what never is."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Literal

import laws
import numpy as np
import pytest
from conflicts import REACH, TURN, jerked, slightly_open
from laws import DT, LIMITS, NEAR, PLAIN, run, ticks
from scipy.optimize import linprog, lsq_linear

from coopqp.base.qp import QP
from coopqp.base.spec import Array
from coopqp.grasps import Rigid
from coopqp.limit import Limit
from coopqp.limits import JointAcceleration, JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.solver import Budget, Status
from coopqp.task import TaskStack
from coopqp.tasks import JointCentering, PointOnPoint

problem = partial(laws.problem, limits=LIMITS)


def tightened(chain: ClosedChain, q: Array, margin: float) -> ClosedChain:
    """The same chain, with position limits this far around q [rad]."""
    model = chain.robot.model.copy()
    model.lowerPositionLimit, model.upperPositionLimit = q - margin, q + margin
    narrow = replace(chain.robot, model=model)
    return ClosedChain.attach(narrow, chain.q_start, Rigid(), HeldObject())


def keeps_position_and_velocity_limits(chain: ClosedChain, q: Array, v: Array) -> bool:
    """At the end of the step, to a nano-radian."""
    after = q + DT * v
    return bool(
        (after >= chain.lower - 1e-9).all()
        and (after <= chain.upper + 1e-9).all()
        and (np.abs(v) <= chain.velocity + 1e-9).all()
    )


def test_hard_task_that_the_grasp_rules_out_becomes_soft(chain: ClosedChain) -> None:
    """Firm hands leave the box four motions, the pose asks for six: it comes nearer and says so."""
    trace = run(PLAIN, problem(chain, TURN), 300)
    assert set(trace.status) <= {"TASKS_RELAXED", "STEP_SHORTENED"}
    assert not trace.failures
    assert np.hypot(*trace.task_error[-1]) < 0.2 * np.hypot(*trace.task_error[0])
    assert trace.loop_position.max() <= 1e-3
    assert trace.loop_orientation.max() <= 1e-2
    assert np.maximum(chain.lower - trace.q, trace.q - chain.upper).max() <= 1e-9


def test_hard_task_that_cannot_hold_is_the_least_squares_nearest(chain: ClosedChain) -> None:
    """Against scipy's bounded least squares in the null space of the loops, and nothing beside."""
    task, beside = replace(TURN, mode="hard"), replace(REACH, mode="soft", weight=1e4)
    given = problem(chain, task, beside, budget=Budget(loop_position=1.0, loop_orientation=1.0))
    law = PLAIN.plain(given)
    state = law.start()
    command = law.tick(state)
    assert command.status is Status.TASKS_RELAXED
    J, wanted = law.exact.J, law.exact.wanted
    lb, ub = law.limit_recovery.bounds.lb, law.limit_recovery.bounds.ub
    firmly = 1e4  # the weight of the loops beside the task
    rows = np.vstack([firmly * state.J_loop, J])
    sides = np.concatenate([-firmly * given.kappa * state.e_loop, wanted])
    best = lsq_linear(rows, sides, bounds=(lb, ub), tol=1e-14)
    least, found = np.linalg.norm(J @ best.x - wanted), np.linalg.norm(J @ command.v - wanted)
    assert found == pytest.approx(least, rel=1e-5)
    assert least / np.linalg.norm(wanted) > 0.1
    lacks = float(np.linalg.norm(state.memory["missed"]))
    assert lacks == pytest.approx(found, rel=1e-9)
    assert command.scale == pytest.approx(1.0 - found / np.linalg.norm(wanted), rel=1e-9)


def test_objectives_give_way_before_anything_is_given_up(chain: ClosedChain) -> None:
    """An unreachable soft goal is no emergency: the ticks stay optimal."""
    far = PointOnPoint(name="far", goal=(0.19, 0.1, 0.25), profile=Profile(duration=2.0))
    trace = run(PLAIN, problem(chain, far, secondary=[JointCentering(name="centre")]), 300)
    assert set(trace.status) == {"OPTIMAL"}
    assert trace.task_error[-1] > 0.01


def test_acceleration_limits_give_way_to_the_loops(chain: ClosedChain) -> None:
    """Braking from a speed that the loops forbid takes more than the limit."""
    limits = (*LIMITS, JointAcceleration(max=20.0))
    law = PLAIN.build(problem(chain, REACH, limits=limits))
    state = jerked(law, 5.0)
    command = law.tick(state)
    assert command.status is Status.ACCELERATION_GIVEN_UP
    np.testing.assert_allclose(state.J_rel @ command.v, -state.loop_error / DT, atol=1e-8)
    assert np.abs(command.v - state.v).max() > 20.0 * DT
    assert keeps_position_and_velocity_limits(chain, state.q, command.v)
    # Without the limit it is what the law would have done.
    free = PLAIN.build(problem(chain, REACH))
    np.testing.assert_allclose(command.v, free.tick(state).v, atol=1e-7)
    # From rest there is no conflict.
    assert law.tick(law.start()).status is Status.OPTIMAL


@pytest.mark.parametrize("engine", ["auto", "python"])
def test_no_tick_of_a_built_law_waits_for_what_gives_up(
    chain: ClosedChain, engine: Literal["auto", "python"], monkeypatch: pytest.MonkeyPatch
) -> None:
    limits = (*LIMITS, JointAcceleration(max=20.0))
    law = replace(PLAIN, engine=engine).build(problem(chain, REACH, limits=limits))
    state = jerked(law, 5.0)

    def built(*args: object, **settings: object) -> None:
        raise AssertionError("built in a tick")

    for part in (QP, TaskStack, State):
        monkeypatch.setattr(part, "__init__", built)
    assert law.tick(state).status is Status.ACCELERATION_GIVEN_UP


def most_correction(chain: ClosedChain, state: State, speed: float) -> float:
    """The largest share of the Baumgarte stabilisation under bounds, by a linear program."""
    n, gap = chain.n, state.loop_error / DT
    top = np.minimum((chain.upper - state.q) / DT, speed * chain.velocity)
    low = np.maximum((chain.lower - state.q) / DT, -speed * chain.velocity)
    found = linprog(
        np.append(np.zeros(n), -1.0),
        A_eq=np.hstack([state.J_rel, gap[:, None]]),
        b_eq=np.zeros(6),
        bounds=[*zip(low, top, strict=True), (0.0, 1.0)],
    )
    return float(found.x[-1])


@pytest.mark.parametrize("acceleration", [(), (JointAcceleration(max=20.0),)], ids=["", "a"])
def test_baumgarte_stabilisation_is_slowed_by_position_limits(
    acceleration: tuple[Limit, ...], chain: ClosedChain
) -> None:
    """The joints may move 10 micro-radians and the gap is 0.1 mm: it closes as far as they go."""
    q = slightly_open(chain, 1e-4)
    narrow = tightened(chain, q, 1e-5)
    state = State(narrow, q)
    law = PLAIN.build(problem(narrow, REACH, limits=(*LIMITS, *acceleration)))
    command = law.tick(state)
    assert command.status is Status.DRIFT_SLOWED
    assert command.drift == pytest.approx(most_correction(narrow, state, 1.0), abs=1e-3)
    assert 0.0 < command.drift < 0.5
    wanted = -command.drift * state.loop_error / DT
    np.testing.assert_allclose(state.J_rel @ command.v, wanted, atol=1e-8)
    assert keeps_position_and_velocity_limits(narrow, q, command.v)
    after = State(narrow, q + DT * command.v)
    assert np.linalg.norm(after.loop_error) < np.linalg.norm(state.loop_error)


def test_baumgarte_stabilisation_is_slowed_by_velocity_limits(chain: ClosedChain) -> None:
    """A gap of 0.5 mm in one tick would take more than the speed that is allowed."""
    q = slightly_open(chain, 5e-4)
    slow = JointVelocity(scale=1e-3)
    law = PLAIN.build(problem(chain, REACH, limits=(JointPosition(), slow)))
    state = law.start(q)
    command = law.tick(state)
    assert command.status is Status.DRIFT_SLOWED
    assert (np.abs(command.v) <= 1e-3 * chain.velocity + 1e-9).all()
    assert command.drift == pytest.approx(most_correction(chain, state, 1e-3), abs=1e-3)
    wanted = -command.drift * state.loop_error / DT
    np.testing.assert_allclose(state.J_rel @ command.v, wanted, atol=1e-8)


def test_a_gap_that_limits_slow_closes_in_the_end(chain: ClosedChain) -> None:
    """Where nothing blocks for good each tick closes a share of what is left."""
    law = PLAIN.build(problem(chain, REACH, limits=(JointPosition(), JointVelocity(scale=1e-2))))
    state = law.start(slightly_open(chain, 5e-4))
    statuses = [command.status for command in ticks(law, state, 100)]
    assert statuses[0] is Status.DRIFT_SLOWED
    assert statuses[-1] is Status.OPTIMAL
    assert state.loop_position_error < 1e-6


def test_least_is_given_up_first(chain: ClosedChain) -> None:
    """Tasks alone, then the Baumgarte stabilisation in part, then acceleration limits as well."""
    limits = (*LIMITS, JointAcceleration(max=20.0))
    law = PLAIN.build(problem(chain, TURN, limits=(*LIMITS, JointAcceleration(max=1e4))))
    assert law.tick(law.start()).causes == (Status.TASKS_RELAXED,)
    law = PLAIN.build(problem(chain, TURN, limits=limits))
    assert law.tick(jerked(law, 5.0)).status is Status.ACCELERATION_GIVEN_UP
    q = slightly_open(chain, 5e-5)
    narrow = tightened(chain, q, 5e-6)
    law = PLAIN.build(problem(narrow, TURN, limits=limits))
    assert law.tick(State(narrow, q)).causes == (Status.DRIFT_SLOWED, Status.TASKS_RELAXED)


def test_hard_task_within_its_means_survives_an_open_loop(chain: ClosedChain) -> None:
    """Nothing is given up that need not be: a gap alone costs no hard task."""
    law = PLAIN.build(problem(chain, replace(REACH, mode="hard", gain=1.0)))
    state = law.start(slightly_open(chain, 1e-4))
    command = law.tick(state)
    assert command.status is Status.OPTIMAL
    np.testing.assert_allclose(state.J_task[:3] @ command.v, np.array(NEAR) - state.p_WO, atol=1e-8)
