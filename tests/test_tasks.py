"""Every task against its own definition and against finite differences of its error."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import coopqp.tasks
from coopqp.closed_chain import ClosedChain
from coopqp.grasp import Grasp, PassiveJoint
from coopqp.held_object import HeldObject
from coopqp.profile import Profile
from coopqp.robot import RobotModel
from coopqp.spec import Pose as PoseValue
from coopqp.spec import spec
from coopqp.state import State
from coopqp.task import Task, TaskStack
from coopqp.tasks import JointCentering, PointOnPlane, PointOnPoint, Pose
from coopqp.tasks.point_on_plane import Turn

Array = NDArray[np.float64]
Walk = Callable[[ClosedChain, int], list[Array]]

H = 1e-5  # step of the central differences [s]
POINT = (0.03, -0.02, 0.05)  # away from the object's origin [m]
SMOOTH = Profile(kind="quintic", duration=2.0, delay=0.3)
TURN = Turn(axis=(1, 2, -1), angle=0.8, profile=Profile(duration=1.5, delay=0.1))
MOVING = (0.02, -0.03, 0.01)  # [m/s]
THROUGH = (0.2, 0.01, 0.06)

#: At least one of every class; a new task needs a line here.
EXAMPLES: dict[str, Task] = {
    "pose": Pose(goal=PoseValue(position=(0.2, 0.02, 0.08), rpy_deg=(20, -10, 30)), profile=SMOOTH),
    "origin on point": PointOnPoint(goal=(0.2, 0.02, 0.08), profile=SMOOTH),
    "point on point": PointOnPoint(goal=(0.2, 0.02, 0.08), point=POINT, profile=SMOOTH),
    "step to a point": PointOnPoint(
        goal=(0.2, 0.02, 0.08), point=POINT, profile=Profile(kind="step")
    ),
    "origin on plane": PointOnPlane(normal=(0, 0, 2), through=THROUGH, profile=SMOOTH),
    "point on plane": PointOnPlane(normal=(1, -1, 3), through=THROUGH, point=POINT, profile=SMOOTH),
    "plane turns": PointOnPlane(
        normal=(1, -1, 3), through=THROUGH, point=POINT, turn=TURN, profile=SMOOTH
    ),
    "plane moves": PointOnPlane(
        normal=(1, -1, 3), through=THROUGH, velocity=MOVING, profile=SMOOTH
    ),
    "plane moves and turns": PointOnPlane(
        normal=(1, -1, 3), through=THROUGH, point=POINT, velocity=MOVING, turn=TURN, profile=SMOOTH
    ),
    "joints to the middle": JointCentering(),
}
IN_SPACE = {name: task for name, task in EXAMPLES.items() if not task.joint_space}
IN_JOINTS = {name: task for name, task in EXAMPLES.items() if task.joint_space}
TIMES = (0.05, 0.7, 1.2, 1.9, 2.2, 5.0)  # before, during and after the motions, off their corners


def over(tasks: dict[str, Task]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("task", tasks.values(), ids=tasks.keys())


def at(chain: ClosedChain, q: Array, t: float) -> State:
    return State(chain, q, t)


def rows(task: Task, state: State) -> TaskStack:
    """The task's rows at a state, its reference set out from the chain's start."""
    stack = TaskStack([task], State(state.chain))
    stack.update(state)
    return stack


def error(task: Task, state: State) -> Array:
    return rows(task, state).e


def object_point(state: State, point: tuple[float, float, float]) -> Array:
    return state.p_WO + state.R_WO @ np.array(point)


def test_every_task_has_an_example_here() -> None:
    assert {type(task).__name__ for task in EXAMPLES.values()} == set(coopqp.tasks.__all__)


@over(EXAMPLES)
def test_task_has_as_many_rows_as_names_and_all_are_finite(
    task: Task, chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    k = len(task.rows(chain))
    assert k == len(set(task.rows(chain))) > 0
    for q in closed_loop_walk(chain, 3):
        for t in TIMES:
            stack = rows(task, at(chain, q, t))
            assert (stack.e.shape, stack.rate.shape, stack.J.shape) == ((k,), (k,), (k, chain.n))
            assert all(np.isfinite(a).all() for a in (stack.e, stack.rate, stack.J))


@over(EXAMPLES)
def test_task_looks_at_the_state_and_leaves_it_alone(
    task: Task, chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    state = at(chain, closed_loop_walk(chain, 1)[0], 0.7)
    arrays = (state.q, state.v, state.p_WO, state.R_WO, state.J_ext, state.loop_error)
    before = [a.copy() for a in arrays]
    rows(task, state)
    for a, b in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(a, b)


@over(IN_SPACE)
@pytest.mark.parametrize("t", TIMES)
def test_error_changes_at_jacobian_times_velocity_less_rate(
    task: Task, t: float, chain: ClosedChain, closed_loop_walk: Walk, rng: np.random.Generator
) -> None:
    """e_dot = J v - rate, once with the joints moving and once with the reference alone."""
    for q in closed_loop_walk(chain, 4):
        stack = rows(task, at(chain, q, t))
        for v in (rng.normal(size=chain.n), np.zeros(chain.n)):
            after = error(task, at(chain, q + H * v, t + H))
            before = error(task, at(chain, q - H * v, t - H))
            e_dot = (after - before) / (2 * H)
            np.testing.assert_allclose(stack.J @ v - stack.rate, e_dot, atol=1e-7)


@over(IN_SPACE)
def test_jacobian_holds_joint_by_joint(
    task: Task, chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    for q in closed_loop_walk(chain, 3):
        J = rows(task, at(chain, q, 0.7)).J
        for joint, unit in enumerate(np.eye(chain.n)):
            after = error(task, at(chain, q + H * unit, 0.7))
            before = error(task, at(chain, q - H * unit, 0.7))
            np.testing.assert_allclose(J[:, joint], (after - before) / (2 * H), atol=1e-8)


@over({n: k for n, k in IN_SPACE.items() if n != "step to a point"})
def test_smooth_reference_sets_out_from_where_the_point_is(task: Task, chain: ClosedChain) -> None:
    np.testing.assert_allclose(error(task, State(chain)), 0, atol=1e-15)


def test_point_error_is_the_way_to_the_moving_reference(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    task = IN_SPACE["point on point"]
    start, goal = object_point(State(chain), POINT), np.array([0.2, 0.02, 0.08])
    for q in closed_loop_walk(chain, 5):
        for t in TIMES:
            x = min(max((t - 0.3) / 2.0, 0.0), 1.0)
            share = 10 * x**3 - 15 * x**4 + 6 * x**5
            state = at(chain, q, t)
            wanted = object_point(state, POINT) - (start + share * (goal - start))
            np.testing.assert_allclose(error(task, state), wanted, atol=1e-15)


def plane_at(t: float, *, velocity: Array, turning: bool) -> tuple[Array, Array]:
    """A point and the unit normal of the example's plane, the turn by Rodrigues' formula."""
    n = np.array([1, -1, 3]) / math.sqrt(11)
    k = np.array([1, 2, -1]) / math.sqrt(6)
    x = min(max((t - 0.1) / 1.5, 0.0), 1.0)
    angle = 0.8 * (10 * x**3 - 15 * x**4 + 6 * x**5) if turning else 0.0
    c, s = math.cos(angle), math.sin(angle)
    return np.array(THROUGH) + velocity * t, n * c + np.cross(k, n) * s + k * (k @ n) * (1 - c)


@pytest.mark.parametrize("name", [n for n in EXAMPLES if n.startswith(("plane", "point on plane"))])
def test_plane_error_is_the_height_above_the_moving_and_turning_plane(
    name: str, chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    task = EXAMPLES[name]
    assert isinstance(task, PointOnPlane)
    velocity, turning = np.array(task.velocity), task.turn is not None
    c, n = plane_at(0.0, velocity=velocity, turning=False)
    height = n @ (object_point(State(chain), task.point) - c)
    for q in closed_loop_walk(chain, 5):
        for t in TIMES:
            x = min(max((t - 0.3) / 2.0, 0.0), 1.0)
            reference = height * (1 - (10 * x**3 - 15 * x**4 + 6 * x**5))
            state = at(chain, q, t)
            c, n = plane_at(t, velocity=velocity, turning=turning)
            wanted = n @ (object_point(state, task.point) - c) - reference
            assert error(task, state) == pytest.approx([wanted], abs=1e-14)


def test_plane_has_turned_by_its_angle_at_the_end(chain: ClosedChain) -> None:
    """A quarter turn about x makes the plane z = 0.06 the plane y = 0.01, seen from -y."""
    turn = Turn(axis=(3, 0, 0), angle_deg=90.0, profile=Profile(duration=3.0))
    task = PointOnPlane(normal=(0, 0, 1), through=(0.2, 0.01, 0.06), turn=turn)
    assert task.end == 3.0
    state = at(chain, chain.q_start, task.end)
    assert error(task, state) == pytest.approx([-(state.p_WO[1] - 0.01)], abs=1e-15)


def test_length_of_the_normal_does_not_count(chain: ClosedChain) -> None:
    state = at(chain, chain.q_start, 1.0)
    short, long = (
        rows(PointOnPlane(normal=n, through=THROUGH), state) for n in ((0.1, 0, 0.2), (10, 0, 20))
    )
    np.testing.assert_allclose(short.e, long.e, rtol=1e-14)
    np.testing.assert_allclose(short.J, long.J, atol=1e-15)


def test_angle_in_degrees_is_the_angle_in_radians() -> None:
    assert Turn(axis=(0, 0, 1), angle_deg=180.0).radians == pytest.approx(math.pi)


@pytest.mark.parametrize("keys", [{}, {"angle": 1.0, "angle_deg": 57.3}])
def test_turn_needs_its_angle_once(keys: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="angle_deg"):
        Turn(axis=(0, 0, 1), **keys)


@pytest.mark.parametrize("normal", [(0, 0, 0), (0, 0), (0, 0, math.nan), (0, 0, math.inf)])
def test_plane_without_a_direction_is_refused(normal: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="normal"):
        PointOnPlane(normal=normal, through=(0, 0, 0))  # type: ignore[arg-type]


@over(IN_JOINTS)
def test_joint_objective_speaks_of_every_joint(task: Task, chain: ClosedChain) -> None:
    stack = rows(task, State(chain))
    assert task.rows(chain) == chain.joint_names
    np.testing.assert_array_equal(stack.J, np.eye(chain.n))
    np.testing.assert_array_equal(stack.rate, np.zeros(chain.n))


def test_joint_centering_pulls_down_the_slope_of_the_papers_criterion(
    chain: ClosedChain, rng: np.random.Generator
) -> None:
    """The criterion is phi = sum ((q - mid) / range)^2 and e its gradient."""
    middle, span = 0.5 * (chain.lower + chain.upper), chain.upper - chain.lower
    for q in chain.sample(rng, 10):
        e = error(JointCentering(), State(chain, q))
        for joint, unit in enumerate(np.eye(chain.n)):
            after, before = (np.sum(((q + s * H * unit - middle) / span) ** 2) for s in (1, -1))
            assert e[joint] == pytest.approx((after - before) / (2 * H), abs=1e-9)
    np.testing.assert_allclose(error(JointCentering(), State(chain, middle)), 0, atol=1e-15)


@spec
class Hinge(Grasp):
    """A passive joint without limits."""

    def passive_joints(self, *_: object) -> tuple[PassiveJoint, ...]:
        return (PassiveJoint(name="hinge", joint=pin.JointModelRX(), placement=pin.SE3.Identity()),)


def test_joint_without_limits_is_left_alone(nao: RobotModel, chain: ClosedChain) -> None:
    hinged = ClosedChain(nao, chain.q_start, Hinge(), HeldObject())
    q = np.full(hinged.n, 0.3)
    e = error(JointCentering(), State(hinged, q))
    np.testing.assert_array_equal(e[hinged.passive], [0.0, 0.0])
    assert np.isfinite(e).all()


def test_stack_keeps_tasks_in_order_with_their_gains_and_weights(chain: ClosedChain) -> None:
    tasks = [
        PointOnPoint(goal=(0.2, 0, 0.1), name="reach", gain=4.0, weight=2.0, profile=SMOOTH),
        PointOnPlane(normal=(0, 0, 1), through=THROUGH, name="lay", gain=3.0, weight=0.5),
    ]
    stack = TaskStack(tasks, State(chain))
    stack.update(at(chain, chain.q_start, 1.2))
    assert stack.names == ("task[reach].x", "task[reach].y", "task[reach].z", "task[lay].normal")
    assert stack.slices == (slice(0, 3), slice(3, 4))
    np.testing.assert_array_equal(stack.weights, [2, 2, 2, 0.5])
    np.testing.assert_allclose(stack.wanted, stack.rate - np.array([4, 4, 4, 3]) * stack.e)


KINDS = ("step", "constant_velocity", "trapezoid", "quintic")
MOVES = KINDS[1:]


@pytest.mark.parametrize("kind", KINDS)
def test_profile_rests_at_its_start_and_at_its_end(kind: str) -> None:
    profile = Profile(kind=kind, duration=1.7, delay=0.4)  # type: ignore[arg-type]
    for t in (-1.0, 0.0, 0.39):
        assert profile.at(t) == (0.0, 0.0)
    for t in (profile.end, profile.end + 1e-9, 100.0):
        assert profile.at(t) == (1.0, 0.0)
    assert profile.end == (0.4 if kind == "step" else pytest.approx(2.1))


@pytest.mark.parametrize("kind", MOVES)
def test_profile_goes_all_the_way_without_turning_back(kind: str) -> None:
    profile = Profile(kind=kind, duration=1.7, delay=0.4)  # type: ignore[arg-type]
    assert profile.at(0.4)[0] == 0.0
    times = np.linspace(0.4, 2.1, 2001)
    shares = np.array([profile.at(t)[0] for t in times])
    assert (np.diff(shares) >= 0).all()
    assert np.diff(shares).max() < 3 / 2000  # nor does it jump
    assert shares[1000] == pytest.approx(0.5)  # symmetric in time


@pytest.mark.parametrize("kind", MOVES)
def test_profile_rate_is_the_derivative_of_the_share(kind: str) -> None:
    profile = Profile(kind=kind, duration=1.7, delay=0.4)  # type: ignore[arg-type]
    for t in 0.4 + 1.7 * (np.arange(400) + 0.5) / 400:  # not at the trapezoid's corners
        rate = (profile.at(t + 1e-6)[0] - profile.at(t - 1e-6)[0]) / 2e-6
        assert profile.at(t)[1] == pytest.approx(rate, abs=1e-8)


@pytest.mark.parametrize(
    ("kind", "top"), [("constant_velocity", 1), ("trapezoid", 4 / 3), ("quintic", 15 / 8)]
)
def test_profile_has_its_known_top_speed(kind: str, top: float) -> None:
    profile = Profile(kind=kind, duration=2.0)  # type: ignore[arg-type]
    rates = [profile.at(t)[1] for t in np.linspace(0, 2, 201)[1:-1]]
    assert max(rates) == pytest.approx(top / 2.0)


def test_constant_velocity_is_there_from_the_first_instant() -> None:
    """The first tick moves by rate dt; without it the point lags one tick's way behind."""
    profile = Profile(kind="constant_velocity", duration=2.0)
    assert profile.at(0.0) == (0.0, 0.5)


@pytest.mark.parametrize("keys", [{"duration": 0.0}, {"duration": math.inf}, {"delay": -1.0}])
def test_profile_out_of_time_is_refused(keys: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(keys))):
        Profile(**keys)
