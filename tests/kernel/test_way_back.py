"""Joints that are outside their limits come back in C++, as in the plain law."""

from __future__ import annotations

import gc
from weakref import ref

import numpy as np
import pytest
from conflicts import OUTSIDE, TURN, started_outside
from laws import DT, LIMITS, STEP, problem
from scipy.optimize import LinearConstraint, minimize
from side_by_side import drive, needs_kernel
from stress.draw import LAW as STRESSED
from stress.draw import draw

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.kernel.law import KernelLaw
from coopqp.limit import Limit
from coopqp.limits import FollowingError, JointAcceleration, Workspace
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.qp_law.limit_recovery import KEPT, LEAST_MOTION
from coopqp.robot import RobotModel
from coopqp.solver import Status
from coopqp.task import Task
from coopqp.tasks import JointCentering, PointOnPoint, Posture

pytestmark = needs_kernel

CAN_COME_BACK = ("elbow", "shoulder", "both elbows")
SAME = 1e-10  # [rad/s]


def hold(chain: ClosedChain, *limits: Limit, **settings: object) -> ControlProblem:
    """The object a little farther on, the joints to their middles."""
    x, y, z = chain.start_position + np.array([0.02, 0.01, -0.02])
    reach = PointOnPoint(name="reach", goal=(x, y, z))
    centre = JointCentering(name="centre", gain=0.5)
    given: dict[str, object] = {"limits": (*LIMITS, *limits), "secondary": [centre], **settings}
    return problem(chain, reach, **given)


def kernel(given: ControlProblem) -> KernelLaw:
    law = QPController(engine="kernel").build(given)
    assert isinstance(law, KernelLaw)
    return law


@pytest.mark.parametrize(
    "more",
    [(), (JointAcceleration(max=20.0),), (Workspace(normal=(0, 0, 1), through=(0, 0, -0.5)),)],
    ids=["", "acceleration", "plane"],
)
@pytest.mark.parametrize("joints", CAN_COME_BACK)
def test_the_whole_way_is_as_the_plain_laws(
    joints: str, more: tuple[Limit, ...], nao: RobotModel
) -> None:
    """Every tick, what it says and what it leaves to the next."""
    seen = drive(hold(started_outside(nao, "rigid", OUTSIDE[joints]), *more), 60)
    assert seen.decided == 60, (seen.left, seen.otherwise)
    assert seen.v < SAME
    assert seen.memory < 1e-6


@pytest.mark.parametrize("joints", CAN_COME_BACK)
def test_what_is_measured_bounds_the_way_back(joints: str, nao: RobotModel) -> None:
    """A joint that is held up is not left behind; such ticks have Python in them."""
    given = hold(started_outside(nao, "rigid", OUTSIDE[joints]), FollowingError(max=0.01))
    laws = [QPController(engine=e).build(given) for e in ("kernel", "python")]
    states = [law.start() for law in laws]
    stuck = states[0].q.copy()
    for _ in range(20):
        for law, state in zip(laws, states, strict=True):
            state.q_measured = stuck
            assert Status.RECOVERING in law.tick(state).causes
        found, wanted = (law.command.v for law in laws)
        assert laws[0].compiled
        np.testing.assert_allclose(found, wanted, atol=SAME)
        for state in states:
            state.advance(wanted, DT)
    assert np.abs(states[0].q - stuck).max() == pytest.approx(0.01, abs=1e-9)


def fastest(chain: ClosedChain, state: State, lb: Array, ub: Array) -> Array:
    """The way back by a solver of another kind, at a state whose loops are closed."""
    back = np.maximum(chain.lower - state.q, 0.0) - np.maximum(state.q - chain.upper, 0.0)
    wish, out = np.clip(back / DT, lb, ub), back != 0.0
    found = minimize(
        lambda v: 0.5 * (((v - wish)[out] ** 2).sum() + LEAST_MOTION * v @ v),
        np.zeros(chain.n),
        jac=lambda v: (v - wish) * out + LEAST_MOTION * v,
        constraints=LinearConstraint(state.J_loop, 0.0, 0.0),  # type: ignore[arg-type]
        bounds=np.column_stack([lb, ub]),
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert found.success
    return np.asarray(found.x)


@pytest.mark.parametrize("joints", [*CAN_COME_BACK, "both wrists"])
def test_who_is_outside_comes_back_almost_as_fast_as_can_be(joints: str, nao: RobotModel) -> None:
    """Though a task wants all joints to go farther out."""
    chain = started_outside(nao, "rigid", OUTSIDE[joints])
    side = np.sign(np.maximum(chain.lower - chain.q_start, 0.0) - (chain.q_start > chain.upper))
    farther = chain.q_start - side
    away = Posture(name="away", goal=farther.tolist(), profile=STEP, gain=10.0)
    law = kernel(problem(chain, away, limits=LIMITS))
    state = law.start()
    v = law.tick(state).v
    assert (law.compiled, law.command.causes) == (True, (Status.RECOVERING,))
    speed = np.minimum(chain.velocity, 20.0)
    out = side != 0.0
    lb = np.maximum(np.minimum((chain.lower - state.q) / DT, 0.0), -speed)
    ub = np.minimum(np.maximum((chain.upper - state.q) / DT, 0.0), speed)
    ub[out & (side > 0.0)], lb[out & (side < 0.0)] = 0.5, -0.5
    best = fastest(chain, State(chain, state.q), lb, ub)
    np.testing.assert_allclose(v[out], KEPT * best[out], rtol=1e-4)


def test_a_law_whose_command_tells_of_it_is_no_leak(nao: RobotModel) -> None:
    """The engine holds the command, which knows the law that says why."""
    law = kernel(hold(started_outside(nao, "rigid", OUTSIDE["elbow"])))
    state = law.start()
    command = law.step(state)
    assert (law.compiled, command.causes) == (True, (Status.RECOVERING,))
    assert "above its range" in command.note
    gone = ref(law), ref(state), ref(command)
    del law, state, command
    gc.collect()
    assert [of() for of in gone] == [None] * 3


@pytest.mark.parametrize("seed", [10, 22, 123, 163, 221, 647, 822])
def test_a_drawn_run_that_starts_outside_is_its_ticks_and_its_steps(seed: int) -> None:
    """On the way tasks are given up, nothing else is possible, steps are shortened."""
    given = draw(seed).problem
    law, by_tick, by_step = STRESSED.unprepared(given), STRESSED.build(given), STRESSED.build(given)
    state, ticked, stepped = law.start(), by_tick.start(), by_step.start()
    found = law.run(state, 120)
    assert any(Status.RECOVERING in causes for causes in found.causes)
    for k in range(120):
        command, other = by_tick.tick(ticked), by_step.step(stepped)
        for one, decided in ((command, by_tick.compiled), (other, by_step.compiled)):
            np.testing.assert_array_equal(found.v[k], one.v)
            assert (found.causes[k], found.scale[k], found.compiled[k]) == (
                one.causes, one.scale, decided,
            )  # fmt: skip
        ticked.advance(command.v, given.dt)
    for ended in (ticked, stepped):
        np.testing.assert_array_equal(state.q, ended.q)
        np.testing.assert_array_equal(state.memory.numbers, ended.memory.numbers)


@pytest.mark.parametrize("on_infeasible", ["hold", "stop", "scale"])
def test_where_tasks_contradict_each_other_joints_come_back_all_the_same(
    on_infeasible: str, nao: RobotModel
) -> None:
    chain = started_outside(nao, "rigid", OUTSIDE["elbow"])
    tasks: tuple[Task, ...] = (TURN,)
    given = problem(chain, *tasks, limits=LIMITS, on_infeasible=on_infeasible)
    seen = drive(given, 30)
    assert seen.decided == 30, (seen.left, seen.otherwise)
    assert seen.v < SAME


def test_what_is_written_beside_the_way_is_not_used(nao: RobotModel) -> None:
    """NaN among the joints, or in what the last way has pulled, is a status and not an answer."""
    law = kernel(hold(started_outside(nao, "rigid", OUTSIDE["elbow"])))
    state = law.start()
    state.memory["recovery"][0] = np.nan
    assert np.isfinite(law.tick(state).v).all()
    state.q[3] = np.nan
    assert law.tick(state).status is Status.NOT_FINITE
