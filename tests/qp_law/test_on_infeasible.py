"""Scale, hold or stop: what a tick does that cannot do its tasks."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Literal

import laws
import numpy as np
import pytest
from conflicts import REACH, TURN, jerked
from laws import LIMITS, PLAIN, STEP, run

from coopqp.base.qp import QP
from coopqp.base.spec import spec
from coopqp.controllers import QPController
from coopqp.limits import JointAcceleration
from coopqp.model.closed_chain import ClosedChain
from coopqp.scenario.loader import load
from coopqp.solver import Solution, Solve, Solver, Status
from coopqp.tasks import Pointing, PointOnPoint, Twist

problem = partial(laws.problem, limits=LIMITS)


def test_hold_stands_still_for_the_tick_and_goes_on(chain: ClosedChain) -> None:
    """One impossible tick between two possible ones."""
    limits = (*LIMITS, JointAcceleration(max=20.0))
    law = PLAIN.build(problem(chain, REACH, limits=limits, on_infeasible="hold"))
    calm = law.start()
    before = law.tick(calm).v.copy()
    assert np.abs(before).max() > 1e-2
    command = law.tick(jerked(law, 5.0))
    assert not command.status.usable
    np.testing.assert_array_equal(command.v, np.zeros(chain.n))
    np.testing.assert_array_equal(law.tick(calm).v, before)


def test_stop_stands_still_from_then_on(chain: ClosedChain) -> None:
    limits = (*LIMITS, JointAcceleration(max=20.0))
    law = PLAIN.build(problem(chain, REACH, limits=limits, on_infeasible="stop"))
    state = law.start()
    assert law.tick(state).v.any()
    state.v[3] = 5.0
    for _ in range(3):
        command = law.tick(state)
        assert not command.status.usable
        np.testing.assert_array_equal(command.v, np.zeros(chain.n))
        state.v[:] = 0.0
    # The stop is in the state, so that another run starts afresh.
    assert law.tick(law.start()).v.any()


@pytest.mark.parametrize("engine", ["python", "auto"])
def test_scaled_task_of_which_nothing_can_be_done_is_not_optimal(
    engine: Literal["python", "auto"],
) -> None:
    """A limit ends the straight way to the goal of joint_limit_stress."""
    given = load("joint_limit_stress").problem()
    goal = (0.10, -0.05, 0.04)
    task = PointOnPoint(name="reach", goal=goal, profile=STEP, mode="scaled")
    law = QPController(engine=engine).build(replace(given, tasks=(task,), on_infeasible="hold"))
    state = law.start()
    law.run(state, 600)
    command = law.tick(state)
    assert np.abs(command.v).max() < 1e-6
    assert np.linalg.norm(state.p_WO - goal) > 1e-3
    assert command.causes == (Status.TASKS_RELAXED,)
    assert command.scale < 1e-6


@pytest.mark.parametrize("on_infeasible", ["hold", "stop"])
@pytest.mark.parametrize("engine", ["python", "auto"])
def test_scaled_tasks_of_which_nothing_can_be_done_are_feasible(
    engine: Literal["python", "auto"], on_infeasible: Literal["hold", "stop"]
) -> None:
    """Standing still does them, though the solver finds no motion for their rows."""
    axis = Pointing(name="axis", axis=(0.603, 0.744, -0.31), direction=(0.367, 1.71, 1.061))
    velocity = {"y": -0.1, "rot_y": -0.131, "rot_x": -0.519}
    turn = Twist(name="turn", mode="scaled", velocity=velocity)
    given = load("point_on_point").problem()
    asked = replace(given, tasks=(replace(axis, mode="scaled"), turn), on_infeasible=on_infeasible)
    law = QPController(engine=engine, error_damping=1.0).build(asked)
    state = law.start()
    said = {law.step(state).causes for _ in range(5)}
    assert said <= {(Status.OPTIMAL,), (Status.TASKS_RELAXED,)}
    assert (Status.TASKS_RELAXED,) in said


@pytest.mark.parametrize("on_infeasible", ["scale", "hold", "stop"])
def test_run_with_an_impossible_task_ends_as_asked(
    on_infeasible: Literal["scale", "hold", "stop"], chain: ClosedChain
) -> None:
    trace = run(PLAIN, problem(chain, TURN, on_infeasible=on_infeasible), 20)
    moved = bool(np.abs(trace.q[-1] - trace.q[0]).max() > 1e-3)
    assert moved == (not trace.failures) == (on_infeasible == "scale")
    assert len(trace.failures) == (0 if on_infeasible == "scale" else 20)


@spec
class Rubbish(Solver):
    """Fails, and leaves rubbish in its answer, as DAQP does when it finds nothing."""

    def open(self, qp: QP, solution: Solution) -> Solve:
        def solve() -> None:
            solution.v[:], solution.status = -1000.0, Status.INFEASIBLE

        return solve


@pytest.mark.parametrize("on_infeasible", ["hold", "stop"])
def test_share_of_a_tick_that_stands_still_is_a_share(
    on_infeasible: Literal["hold", "stop"], chain: ClosedChain
) -> None:
    scaled = replace(REACH, mode="scaled")
    trace = run(PLAIN, problem(chain, scaled, solver=Rubbish(), on_infeasible=on_infeasible), 5)
    assert ((trace.scale >= 0.0) & (trace.scale <= 1.0)).all()
