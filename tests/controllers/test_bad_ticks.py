"""When things go wrong: solvers, states and tasks that give no motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Literal

import numpy as np
import pytest
from chains import HANDS
from example_controllers import each_controller
from laws import DT, LIMITS, NEAR, STEP, problem
from own_task import Own

from coopqp.base.qp import QP, Row
from coopqp.base.spec import Array, spec, type_name
from coopqp.controller import Controller
from coopqp.controllers import QPController, TorqueQp
from coopqp.grasps import Rigid
from coopqp.limit import Limit, LimitRows, Tighten
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State
from coopqp.robot import RobotModel
from coopqp.solver import Solution, Solve, Solver, Status
from coopqp.solvers import Daqp, Osqp, Proxqp
from coopqp.task import Evaluate, Task, TaskRows
from coopqp.tasks import JointCentering, PointOnPoint


@spec
class GivesUp(Solver):
    """Answers with a status, and with a motion that must not be used."""

    status: Status

    def open(self, qp: QP, solution: Solution) -> Solve:
        def solve() -> None:
            solution.v[:], solution.status = 1.0, self.status

        return solve


@spec
class Lies(Solver):
    """Calls one and the same motion optimal, whatever is asked."""

    speed: float | None
    """NaN when omitted."""

    def open(self, qp: QP, solution: Solution) -> Solve:
        def solve() -> None:
            solution.v[:] = np.nan if self.speed is None else self.speed
            solution.status = Status.OPTIMAL

        return solve


def not_a_number(state: State, rows: TaskRows) -> None:
    """A measurement is broken."""
    rows.e[0], rows.J[0] = np.nan, state.J_task[2]


@pytest.mark.parametrize("status", [status for status in Status if not status.usable])
def test_robot_holds_still_when_the_solver_gives_up(status: Status, chain: ClosedChain) -> None:
    law = QPController().build(
        problem(chain, PointOnPoint(goal=NEAR), solver=GivesUp(status=status))
    )
    answer = law.tick(law.start())
    assert answer.status is status
    np.testing.assert_array_equal(answer.v, np.zeros(chain.n))


@pytest.mark.parametrize(
    ("speed", "status"),
    [
        (None, Status.NOT_FINITE),
        (1.0, Status.EQUALITY_RESIDUAL),
        (100.0, Status.BOUND_RESIDUAL),
    ],
)
def test_robot_holds_still_when_the_solver_lies(
    speed: float | None, status: Status, chain: ClosedChain
) -> None:
    given = problem(chain, PointOnPoint(goal=NEAR), solver=Lies(speed=speed), limits=LIMITS)
    law = QPController().build(given)
    answer = law.tick(law.start())
    assert answer.status is status
    np.testing.assert_array_equal(answer.v, np.zeros(chain.n))


def test_standing_still_while_the_goal_is_away_is_no_optimum(chain: ClosedChain) -> None:
    given = problem(chain, PointOnPoint(goal=NEAR, profile=STEP), solver=Lies(speed=0.0))
    law = QPController().build(given)
    assert law.tick(law.start()).status is Status.INACCURATE


def test_law_stops_for_a_tick_that_fails_and_then_goes_on_as_before(chain: ClosedChain) -> None:
    law = QPController().build(problem(chain, PointOnPoint(goal=NEAR, profile=STEP), limits=LIMITS))
    good, bad = law.start(), law.start(np.full(chain.n, np.nan))
    before = law.tick(good).v.copy()
    assert not law.tick(bad).status.usable
    np.testing.assert_array_equal(law.command.v, np.zeros(chain.n))
    assert law.tick(good).status is Status.OPTIMAL
    np.testing.assert_array_equal(law.command.v, before)


WEIRD: dict[str, Callable[[ClosedChain], Array]] = {
    "not a number": lambda chain: np.full(chain.n, np.nan),
    "infinite": lambda chain: np.full(chain.n, np.inf),
    "stretched out": lambda chain: np.zeros(chain.n),
    "outside the limits": lambda chain: chain.upper + 2.0,
    "far outside": lambda chain: np.full(chain.n, 1e9),
}


@each_controller
@pytest.mark.parametrize("where", WEIRD.values(), ids=WEIRD.keys())
def test_tick_raises_nothing_and_commands_only_numbers(
    controller: Controller, where: Callable[[ClosedChain], Array], chain: ClosedChain
) -> None:
    """Warnings count as errors here, so numpy is quiet too."""
    given = problem(
        chain,
        PointOnPoint(goal=NEAR),
        secondary=[JointCentering()],
        limits=LIMITS,
        kappa=1 / DT,
    )
    law = controller.build(given)
    answer = law.tick(law.start(where(chain)))
    assert np.isfinite(answer.v).all()
    assert answer.status.usable or not answer.v.any()


@pytest.mark.parametrize("solver", [Daqp(), Osqp(max_iter=1000), Proxqp(max_iter=10)], ids=str)
def test_robot_holds_still_when_a_task_is_not_a_number(solver: Solver, chain: ClosedChain) -> None:
    law = QPController().build(problem(chain, Own(write=not_a_number), solver=solver))
    answer = law.tick(law.start())
    assert not answer.status.usable
    np.testing.assert_array_equal(answer.v, np.zeros(chain.n))


@spec
class SickLimit(Limit):
    """A limit whose measurement is broken."""

    what: str

    def rows(self, chain: ClosedChain) -> tuple[Row, ...]:
        return (Row(name="sick", kind="limit", owner="sick", unit="m/s"),)

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        def tighten(state: State, rows: LimitRows) -> None:
            rows.h[0] = 1.0
            getattr(rows, self.what)[0] = np.nan

        return tighten


@spec
class SickForce(Task):
    """A force that is no number."""

    of_forces: ClassVar[bool] = True
    what: str

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return ("force",)

    def bind(self, start: State) -> Evaluate:
        def evaluate(state: State, rows: TaskRows) -> None:
            rows.J[:], rows.rate[:] = 1.0, 1.0
            getattr(rows, self.what)[:] = np.nan if state.t > 0.0 else 1.0

        return evaluate


@pytest.mark.parametrize("solver", [Daqp(), Proxqp()], ids=["daqp", "proxqp"])
@pytest.mark.parametrize("law", [QPController(), TorqueQp()], ids=lambda law: law.name)
@pytest.mark.parametrize("what", ["lb", "ub", "G", "h"])
def test_a_limit_that_is_not_a_number_is_named(
    what: str, law: Controller, solver: Solver, box_of_nao: ClosedChain
) -> None:
    limits = (*LIMITS, SickLimit(what=what))
    given = problem(box_of_nao, PointOnPoint(goal=NEAR), limits=limits, solver=solver)
    built = law.build(given)
    answer = built.tick(built.start())
    assert answer.status is Status.NOT_FINITE
    name = type_name(SickLimit)
    assert answer.note == f"limit '{name}' gives NaN or infinite values in {what}"


@pytest.mark.parametrize("engine", ["auto", "python"])
def test_a_later_level_that_is_not_a_number_is_named_and_those_before_go_on(
    engine: Literal["auto", "python"], chain: ClosedChain
) -> None:
    reach = PointOnPoint(name="reach", goal=NEAR)
    given = problem(chain, reach, Own(name="fever", write=not_a_number, priority=1))
    law = QPController(engine=engine).build(given)
    state = law.start()
    for _ in range(50):
        answer = law.step(state)
    assert answer.status is Status.INACCURATE
    assert answer.note == "task 'fever' gives NaN or infinite values in e"
    alone = QPController().build(problem(chain, reach))
    other = alone.start()
    for _ in range(50):
        alone.step(other)
    np.testing.assert_allclose(state.q, other.q, atol=1e-9)


@pytest.mark.parametrize("solver", [Daqp(), Proxqp()], ids=["daqp", "proxqp"])
@pytest.mark.parametrize("what", ["J", "rate"])
def test_a_force_that_is_not_a_number_is_named(
    what: str, solver: Solver, box_of_nao: ClosedChain
) -> None:
    wrenches = (SickForce(name="fever", what=what),)
    given = problem(box_of_nao, PointOnPoint(goal=NEAR), wrenches=wrenches, solver=solver)
    law = TorqueQp().build(given)
    state = law.start()
    assert law.tick(state).status.usable
    state.t = 1.0
    answer = law.tick(state)
    assert answer.status is Status.NOT_FINITE
    assert answer.note == f"task 'fever' gives NaN or infinite values in {what}"


@pytest.fixture(scope="module")
def box_of_nao(nao: RobotModel) -> ClosedChain:
    return ClosedChain.attach(nao, nao.configuration(HANDS), Rigid(), HeldObject(mass=0.2))


@each_controller
def test_tick_leaves_the_state_alone_and_answers_alike_twice(
    controller: Controller, chain: ClosedChain
) -> None:
    law = controller.build(problem(chain, PointOnPoint(goal=NEAR, profile=STEP), limits=LIMITS))
    state = law.start()

    def arrays() -> list[Array]:
        seen = state.q, state.v, state.J_ext, state.loop_error, state.p_WO, state.R_WO
        return [a.copy() for a in seen]

    before = arrays()
    first, after = law.tick(state).v.copy(), arrays()
    np.testing.assert_array_equal(law.tick(state).v, first)
    for a, b, c in zip(before, after, arrays(), strict=True):
        # The kernel rounds otherwise than pinocchio, which has computed what there was before.
        np.testing.assert_allclose(b, a, rtol=0.0, atol=1e-15 if law.compiled else 0.0)
        np.testing.assert_array_equal(c, b)
    np.testing.assert_array_equal(after[:2], before[:2])
