"""Solvers that fail, lie or stall now and then."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import laws
import numpy as np
import pytest
from chains import HANDS
from conflicts import GRASPS, REACH, TURN, beyond, each_grasp
from laws import LIMITS, PLAIN, run

from coopqp.base.qp import QP
from coopqp.base.spec import spec
from coopqp.limits import JointAcceleration
from coopqp.metrics.relaxed_ticks import RelaxedTicks
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.robot import RobotModel
from coopqp.solver import Solution, Solve, Solver, Status, causes_of
from coopqp.solvers import Daqp
from coopqp.task import Task
from coopqp.tasks import JointCentering, PointOnPoint

problem = partial(laws.problem, limits=LIMITS)


@spec
class Faulty(Solver):
    """DAQP that goes wrong in a share of its calls, by chance but seeded."""

    fault: Literal["nan", "wrong", "failure", "stalls", "huge"]
    share: float = 0.2
    seed: int = 0

    def open(self, qp: QP, solution: Solution) -> Solve:
        solve, rng = Daqp().open(qp, solution), np.random.default_rng(self.seed)

        def faulty() -> None:
            solve()
            if rng.random() >= self.share:
                return
            if self.fault == "nan":
                solution.v[rng.integers(qp.n)] = np.nan
            elif self.fault == "wrong":
                solution.v += rng.normal(size=qp.n)
            elif self.fault == "huge":
                solution.v *= 1e9
            elif self.fault == "failure":
                solution.status = Status.SOLVER_ERROR
            else:
                solution.status = Status.ITERATION_LIMIT

        return faulty


FAULTS = ("nan", "wrong", "failure", "stalls", "huge")
each_fault = pytest.mark.parametrize("fault", FAULTS)


@pytest.mark.each_value
@each_fault
@each_grasp
@pytest.mark.parametrize("secondary", [(), (JointCentering(name="centre", gain=0.5),)], ids=str)
def test_run_goes_on_with_a_solver_that_fails_now_and_then(
    fault: Any, grasp: str, secondary: tuple[Task, ...], nao: RobotModel
) -> None:
    """Every fifth call goes wrong: limits and loops hold, the goal is reached, all is counted."""
    chain = ClosedChain.attach(nao, nao.configuration(HANDS), GRASPS[grasp], HeldObject())
    goal = chain.start_position + np.array([0.01, -0.01, 0.02])
    reach = PointOnPoint(name="reach", goal=(goal[0], goal[1], goal[2]))
    given = problem(chain, reach, secondary=secondary, solver=Faulty(fault=fault))
    trace = run(PLAIN, given, 200)
    counts = Counter(trace.status)
    assert counts["OPTIMAL"] > 100
    assert counts["SOLVER_FAILED"] > 20  # the last attempt has an answer
    assert counts["DRIFT_SLOWED"] == 0  # nothing was in conflict
    failed = [k for k, status in enumerate(trace.status) if not causes_of(status)[0].usable]
    assert failed  # it failed as well now and then
    assert not trace.v[failed].any()
    assert np.isfinite(trace.q).all()
    assert beyond(chain, trace.q).max() <= 1e-9
    assert (np.abs(trace.v) <= chain.velocity + 1e-9).all()
    assert trace.loop_position.max() <= 1e-3
    assert trace.loop_orientation.max() <= 1e-2
    assert trace.task_error[-1] < 5e-4
    given_up = sum(
        n * sum(cause.relaxed for cause in causes_of(name)) for name, n in counts.items()
    )
    assert sum(RelaxedTicks().measure(trace).values()) == given_up
    assert [failure.tick for failure in trace.failures] == failed


@each_fault
@pytest.mark.parametrize("on_infeasible", ["scale", "hold", "stop"])
def test_solver_that_always_fails_leaves_the_robot_standing(
    fault: Any, on_infeasible: Literal["scale", "hold", "stop"], chain: ClosedChain
) -> None:
    """Not one tick is usable, nothing moves, nothing is raised."""
    given = problem(
        chain,
        REACH,
        replace(TURN, name="other"),
        secondary=[JointCentering(name="centre")],
        limits=(*LIMITS, JointAcceleration(max=20.0)),
        solver=Faulty(fault=fault, share=1.0),
        on_infeasible=on_infeasible,
    )
    trace = run(PLAIN, given, 30)
    assert not trace.v.any()
    np.testing.assert_array_equal(trace.q, np.tile(chain.q_start, (31, 1)))
    assert len(trace.failures) == 30
    assert RelaxedTicks().measure(trace) == {}


@pytest.mark.parametrize("part", ["v", "multipliers"])
@pytest.mark.parametrize("size", [1e155, 1e200, 1e308, np.inf])
def test_answer_beyond_all_measure_is_refused_without_a_warning(
    size: float, part: str, chain: ClosedChain
) -> None:
    @spec
    class Beyond(Solver):
        def open(self, qp: QP, solution: Solution) -> Solve:
            def solve() -> None:
                solution.v[:], solution.status = 0.0, Status.OPTIMAL
                getattr(solution, part)[:] = size

            return solve

    law = PLAIN.build(problem(chain, REACH, solver=Beyond()))
    assert not law.tick(law.start()).status.usable


def test_faults_in_a_later_level_cost_only_that_level(chain: ClosedChain) -> None:
    """The main task moves as without a secondary objective in ticks in which that fails."""

    class SecondFails(Solver):
        def open(self, qp: QP, solution: Solution) -> Solve:
            second = "free" in {row.kind for row in qp.rows.variables}
            solve = Daqp().open(qp, solution)

            def maybe() -> None:
                solve()
                if second:
                    solution.v[:], solution.status = np.nan, Status.OPTIMAL

            return maybe

    centre = [JointCentering(name="centre")]
    law = PLAIN.build(problem(chain, REACH, secondary=centre, solver=SecondFails()))
    alone = PLAIN.plain(problem(chain, REACH))
    command = law.tick(law.start())
    assert command.status is Status.INACCURATE
    np.testing.assert_array_equal(command.v, alone.tick(alone.start()).v)
