"""Every task against its own definition and against finite differences of its error."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from pydantic import TypeAdapter
from ruamel.yaml import YAML

import coopqp.tasks
from coopqp.checked import Pose as PoseValue
from coopqp.checked import spec
from coopqp.closed_chain import ClosedChain
from coopqp.controller_run import run
from coopqp.errors import CoopqpError
from coopqp.geometry import Turn, axes_along
from coopqp.grasp import Grasp, PassiveJoint
from coopqp.grasps import Rigid
from coopqp.held_object import HeldObject
from coopqp.profile import Profile
from coopqp.robot import RobotModel
from coopqp.robots import PlanarPair
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.form import chosen, one_of
from coopqp.scenario.loader import load
from coopqp.state import State
from coopqp.task import Task, TaskRows, TaskStack
from coopqp.tasks import (
    Distance,
    JointCentering,
    LineOnLine,
    LineOnPlane,
    Manipulability,
    MinimumKineticEnergy,
    MinimumVelocity,
    Orientation,
    PlaneOnPlane,
    Pointing,
    PointOnCircle,
    PointOnLine,
    PointOnPlane,
    PointOnPoint,
    Pose,
    Posture,
    Prismatic,
    RelativeMotion,
    Revolute,
    Twist,
)
from coopqp.tasks.posture import posture

Array = NDArray[np.float64]
Walk = Callable[[ClosedChain, int], list[Array]]

H = 1e-5  # step of the central differences [s]
POINT = (0.03, -0.02, 0.05)  # away from the object's origin [m]
SMOOTH = Profile(kind="quintic", duration=2.0, delay=0.3)
TURN = Turn(axis=(1, 2, -1), angle=0.8, profile=Profile(duration=1.5, delay=0.1))
MOVING = (0.02, -0.03, 0.01)  # [m/s]
THROUGH = (0.2, 0.01, 0.06)
AXIS = (2, -1, 0.5)  # of the object
TILTED = (1, -1, 3)  # direction of lines, normals
MOVES = {"point": POINT, "velocity": MOVING, "turn": TURN, "profile": SMOOTH}

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
    "point on line": PointOnLine(direction=TILTED, through=THROUGH, profile=SMOOTH),
    "line moves": PointOnLine(direction=TILTED, through=THROUGH, **MOVES),
    "point on circle": PointOnCircle(center=THROUGH, normal=TILTED, radius=0.03, profile=SMOOTH),
    "circle moves": PointOnCircle(center=THROUGH, normal=TILTED, radius=0.03, **MOVES),
    "distance": Distance(to=THROUGH, length=0.1, profile=SMOOTH),
    "distance to what moves": Distance(
        to=THROUGH, length=0.1, point=POINT, velocity=MOVING, profile=SMOOTH
    ),
    "pointing": Pointing(direction=TILTED, axis=AXIS, profile=SMOOTH),
    "pointing at once": Pointing(direction=TILTED, axis=AXIS, profile=Profile(kind="step")),
    "pointing turns": Pointing(direction=TILTED, axis=AXIS, turn=TURN, profile=SMOOTH),
    "pointing the opposite way": Pointing(direction=(-1, 0, 0), axis=(1, 0, 0), profile=SMOOTH),
    "orientation": Orientation(rpy_deg=(20, -10, 30), profile=SMOOTH),
    "orientation at once": Orientation(rpy=(2.0, -1.0, 1.5), profile=Profile(kind="step")),
    "line on plane": LineOnPlane(normal=TILTED, through=THROUGH, axis=AXIS, profile=SMOOTH),
    "line on plane that moves": LineOnPlane(normal=TILTED, through=THROUGH, axis=AXIS, **MOVES),
    "plane on plane": PlaneOnPlane(normal=TILTED, through=THROUGH, axis=AXIS, profile=SMOOTH),
    "plane on plane that moves": PlaneOnPlane(normal=TILTED, through=THROUGH, axis=AXIS, **MOVES),
    "line on line": LineOnLine(direction=TILTED, through=THROUGH, axis=AXIS, profile=SMOOTH),
    "line on line that moves": LineOnLine(
        direction=TILTED, through=THROUGH, axis=(-2, 1, 0), either_way=True, **MOVES
    ),
    "revolute": Revolute(direction=TILTED, through=THROUGH, axis=AXIS, profile=SMOOTH),
    "revolute that moves": Revolute(direction=TILTED, through=THROUGH, axis=AXIS, **MOVES),
    "prismatic": Prismatic(direction=TILTED, through=THROUGH, profile=SMOOTH),
    "prismatic that moves": Prismatic(
        direction=TILTED, through=THROUGH, rpy_deg=(20, -10, 30), **MOVES
    ),
    "relative motion": RelativeMotion(
        goal=PoseValue(position=(0.02, -0.05, 0.01), rpy_deg=(20, -10, 30)), profile=SMOOTH
    ),
    "twist": Twist(velocity={"rot_y": 0.2, "x": 0.01, "z": -0.02}, point=POINT, profile=SMOOTH),
    "twist in the object's axes": Twist(
        velocity={"y": 0.01, "rot_z": 0.0}, axes="object", point=POINT, profile=SMOOTH
    ),
    "spin": Twist(velocity={"rot_x": 0.1}),
    "least energy": MinimumKineticEnergy(),
    "joints to the middle": JointCentering(),
    "able to move": Manipulability(),
    "able to rise": Manipulability(axes=("z",)),
    "least velocity": MinimumVelocity(),
    "posture": Posture(goal={"right": [0.5, -0.3, 1.0, 0.8, 0.0], "LElbowRoll": -0.7}),
    "whole posture": Posture(goal=[0.1 * i for i in range(10)], profile=SMOOTH),
}
IN_SPACE = {name: task for name, task in EXAMPLES.items() if not task.joint_space}
IN_JOINTS = {name: task for name, task in EXAMPLES.items() if task.joint_space}
#: These wish a velocity and have no error that could change.
OF_VELOCITY = (Twist, MinimumKineticEnergy)
PLACED = {name: task for name, task in IN_SPACE.items() if not isinstance(task, OF_VELOCITY)}
AT_ONCE = [name for name in PLACED if name.endswith("at once") or name.startswith("step")]
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


@over(PLACED)
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


@over(PLACED)
def test_jacobian_holds_joint_by_joint(
    task: Task, chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    for q in closed_loop_walk(chain, 3):
        J = rows(task, at(chain, q, 0.7)).J
        for joint, unit in enumerate(np.eye(chain.n)):
            after = error(task, at(chain, q + H * unit, 0.7))
            before = error(task, at(chain, q - H * unit, 0.7))
            np.testing.assert_allclose(J[:, joint], (after - before) / (2 * H), atol=1e-8)


@over({n: k for n, k in IN_SPACE.items() if n not in AT_ONCE})
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


@pytest.mark.parametrize(
    "name", [n for n, task in EXAMPLES.items() if type(task) is PointOnPlane][1:]
)
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
    asked = np.ones(chain.n)
    if isinstance(task, Posture):  # joints without a goal are free
        asked = np.isfinite(posture(task.goal, chain)).astype(float)
    np.testing.assert_array_equal(stack.J, np.diag(asked))
    np.testing.assert_array_equal(stack.rate, np.zeros(chain.n))  # at rest before it sets out


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


def test_every_task_is_in_the_docs_with_an_example_that_can_be_read() -> None:
    """Its name, keys and example; keys in bold are those that must be given."""
    text = (Path(__file__).parents[1] / "docs" / "tasks.md").read_text(encoding="utf-8")
    lines = re.findall(r"^\| `(\w+)` \|.*\|.*\|(.*)\| `(.*)` \|$", text, re.MULTILINE)
    tasks = Catalog().entries("tasks")
    assert sorted(name for name, _, _ in lines) == sorted(tasks)
    read = TypeAdapter(one_of(Catalog(), "tasks"))
    for name, keys, example in lines:
        found = chosen(read.validate_json(json.dumps(YAML(typ="safe").load(example))))
        assert found[0] == name
        fields = {field.name: field for field in dataclasses.fields(tasks[name].cls)}
        assert set(re.findall(r"\w+", keys)) - {"or"} <= set(fields)
        needed = {n for n, f in fields.items() if f.default is dataclasses.MISSING}
        bold = " ".join(re.findall(r"\*\*(.*?)\*\*", keys))
        assert needed <= set(bold.split())


@over(EXAMPLES)
def test_parts_cover_the_rows_in_their_units(task: Task, chain: ClosedChain) -> None:
    parts = task.parts(chain)
    assert sum(part.rows for part in parts) == len(task.rows(chain))
    assert all(part.rows and part.unit and part.tolerance > 0.0 for part in parts)
    assert len({part.name for part in parts}) == len(parts)


@pytest.mark.parametrize(
    ("name", "dimension"),
    [
        ("point on plane", 1), ("distance", 1), ("point on line", 2), ("line on plane", 2),
        ("point on circle", 2), ("pointing", 2), ("point on point", 3), ("plane on plane", 3),
        ("orientation", 3), ("line on line", 4), ("revolute", 5), ("prismatic", 5), ("pose", 6),
        ("relative motion", 6), ("twist", 3), ("spin", 1),
    ],
)  # fmt: skip
def test_task_has_as_many_rows_as_dimensions_and_they_are_independent(
    name: str, dimension: int, chain: ClosedChain, rng: np.random.Generator
) -> None:
    # Two arms of five joints cannot move their object every way, but move apart every way.
    state = State(chain) if name == "relative motion" else FreeBody(rng).state
    block = block_of(EXAMPLES[name], state, chain)
    assert len(block.e) == np.linalg.matrix_rank(block.J, tol=1e-6) == dimension


class FreeBody:
    """An object that nothing holds, so that a task has all six motions; stands in for a state."""

    def __init__(self, rng: np.random.Generator | None = None) -> None:
        p, phi = (np.zeros(3), np.zeros(3)) if rng is None else rng.normal(size=(2, 3))
        self.state = cast(
            State,
            SimpleNamespace(
                chain=SimpleNamespace(n=6), t=0.0, p_WO=p.copy(), R_WO=np.array(pin.exp3(phi)),
                J_task=np.eye(6), _skew=np.zeros((3, 3)), _lever_J=np.zeros((3, 6)),
            ),
        )  # fmt: skip
        state: Any = self.state
        state.point_jacobian = lambda lever, out: State.point_jacobian(state, lever, out)

    def step(self, v: Array, dt: float) -> None:
        self.state.p_WO += dt * v[:3]
        self.state.R_WO[:] = pin.exp3(dt * v[3:]) @ self.state.R_WO
        self.state.t += dt

    def follow(
        self, task: Task, duration: float, dt: float = 0.005
    ) -> tuple[TaskRows, list[float]]:
        """Move as the task wishes and no more; the rows at the end and the errors on the way."""
        k = len(task.rows(self.state.chain))
        block = TaskRows(np.zeros(k), np.zeros((k, 6)), np.zeros(k))
        evaluate, errors = task.bind(self.state), []
        for _ in range(round(duration / dt)):
            evaluate(self.state, block)
            assert all(np.isfinite(a).all() for a in (block.e, block.J, block.rate))
            errors.append(float(np.linalg.norm(block.e)))
            v = np.linalg.pinv(block.J, rcond=1e-6) @ (block.rate - task.gain * block.e)
            self.step(v, dt)
        evaluate(self.state, block)
        return block, errors

    def turn_to(self, R: Array) -> None:
        self.state.R_WO[:] = R


def block_of(task: Task, state: State, chain: ClosedChain) -> TaskRows:
    k, n = len(task.rows(chain)), state.chain.n
    block = TaskRows(np.zeros(k), np.zeros((k, n)), np.zeros(k))
    task.bind(state)(state, block)
    return block


def angle_between(a: Array, b: Array) -> float:
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))


AXIS_O = np.array(AXIS) / np.linalg.norm(AXIS)


def reference_at(t: float) -> tuple[Array, Array]:
    """A point and the direction of the examples that move."""
    return plane_at(t, velocity=np.array(MOVING), turning=True)


def off_line(p: Array, c: Array, d: Array) -> float:
    return float(np.linalg.norm(np.cross(d, p - c)))


ENDS: dict[str, Callable[[Array, Array, Array, Array], list[float]]] = {
    # What must be zero at the end: p the point and a the axis of the object, c and d in space.
    "line moves": lambda p, a, c, d: [off_line(p, c, d)],
    "circle moves": lambda p, a, c, d: [off_line(p, c, d) - 0.03, d @ (p - c)],
    "pointing turns": lambda p, a, c, d: [angle_between(a, d)],
    "line on plane that moves": lambda p, a, c, d: [d @ (p - c), a @ d],
    "plane on plane that moves": lambda p, a, c, d: [d @ (p - c), angle_between(a, d)],
    "line on line that moves": lambda p, a, c, d: [off_line(p, c, d)],
    "revolute that moves": lambda p, a, c, d: [*(p - c), angle_between(a, d)],
    "prismatic that moves": lambda p, a, c, d: [off_line(p, c, d)],
}


@pytest.mark.parametrize("name", ENDS)
def test_free_object_ends_up_as_the_task_says_and_follows_the_reference(
    name: str, rng: np.random.Generator
) -> None:
    """The feed-forward is complete: nothing is left but what an Euler step is off by."""
    for _ in range(3):
        body = FreeBody(rng)
        _, errors = body.follow(EXAMPLES[name], 3.0, 0.005)
        assert max(errors) < 0.02
        state = body.state
        c, d = reference_at(3.0)
        left = ENDS[name](object_point(state, POINT), state.R_WO @ AXIS_O, c, d)
        np.testing.assert_allclose(left, 0, atol=1e-3)


def test_object_on_a_slide_turns_with_it(rng: np.random.Generator) -> None:
    body, task = FreeBody(rng), EXAMPLES["prismatic that moves"]
    body.follow(task, 3.0)
    turned = pin.exp3(0.8 * np.array([1, 2, -1]) / math.sqrt(6))
    wanted = turned @ pin.rpy.rpyToMatrix(*np.radians([20, -10, 30]))
    np.testing.assert_allclose(body.state.R_WO, wanted, atol=1e-3)


def test_object_on_a_slide_keeps_its_orientation_unless_told(rng: np.random.Generator) -> None:
    body = FreeBody(rng)
    before = body.state.R_WO.copy()
    body.follow(Prismatic(direction=TILTED, through=THROUGH, point=POINT), 1.5)
    np.testing.assert_allclose(body.state.R_WO, before, atol=1e-12)


@pytest.mark.parametrize("goal", [(20, -10, 30), (180, 0, 0), (0, 0, 179.9)])
def test_free_object_turns_to_its_orientation(goal: tuple[float, float, float]) -> None:
    body = FreeBody()
    block, errors = body.follow(Orientation(rpy_deg=goal), 2.0)
    assert max(errors) < 0.02
    np.testing.assert_allclose(body.state.R_WO, pin.rpy.rpyToMatrix(*np.radians(goal)), atol=1e-3)
    np.testing.assert_allclose(block.e, 0, atol=1e-3)


def test_half_a_turn_at_once_is_finite_and_done(rng: np.random.Generator) -> None:
    task = Orientation(rpy_deg=(180, 0, 0), profile=Profile(kind="step"))
    block, errors = FreeBody().follow(task, 3.0)
    assert errors[0] == pytest.approx(math.pi)
    assert errors[-1] < 1e-4
    assert np.isfinite(block.J).all()


@pytest.mark.parametrize("off", [0.0, 1e-15, 1e-9, 1e-4, 0.01, 0.1])
@pytest.mark.parametrize("kind", ["step", "quintic"])
@pytest.mark.parametrize("task", [Pointing, PlaneOnPlane, LineOnLine, Revolute])
def test_axis_leaves_the_opposite_direction(task: type[Task], kind: Any, off: float) -> None:
    """From straight against the direction, or nearly so, it turns round all the same."""
    body = FreeBody()
    body.turn_to(pin.exp3(np.array([0.6, -0.8, 0.0]) * (math.pi - off)))
    along = {} if task is Pointing else {"through": (0.1, 0.2, 0.3)}
    keys: Any = {("normal" if task is PlaneOnPlane else "direction"): (0, 0, 1), **along}
    _, errors = body.follow(task(axis=(0, 0, 2), profile=Profile(kind=kind), **keys), 4.0)
    assert errors[-1] < 1e-3
    assert body.state.R_WO[2, 2] > 1.0 - 1e-6
    if kind == "step" and task is Pointing:
        assert errors[0] == pytest.approx(math.pi - off)
        assert all(np.diff(errors) <= 1e-12)


def test_direction_error_is_exact_up_to_the_cone_about_the_opposite(
    rng: np.random.Generator,
) -> None:
    """Jacobian against central differences from zero to all but half a turn; rows stay bounded."""
    task = Pointing(direction=(0, 0, 1), axis=(0, 0, 1), profile=Profile(kind="step"))
    for lean in (0.0, 1e-13, 1e-10, 1e-6, 1e-3, 0.5, 1.57, 2.5, 3.0, 3.1):
        for _ in range(5):
            way, omega = rng.uniform(0, 2 * math.pi), rng.normal(size=3)
            R = np.array(pin.exp3(lean * np.array([math.cos(way), math.sin(way), 0.0])))
            e = []
            for h in (-1e-6, 0.0, 1e-6):
                body = FreeBody()
                body.turn_to(pin.exp3(h * omega) @ R)
                block = block_of(task, body.state, cast(Any, None))
                e.append(block.e.copy())
                if h == 0.0:
                    J = block.J.copy()
            assert np.linalg.norm(e[1]) == pytest.approx(lean, abs=1e-12)
            np.testing.assert_allclose(J[:, 3:] @ omega, (e[2] - e[0]) / 2e-6, rtol=1e-5, atol=1e-7)
    for lean in math.pi - np.array([0.0, 1e-18, 1e-12, 1e-6, 1e-3, 0.019]):
        body = FreeBody()
        body.turn_to(pin.exp3(np.array([lean, 0, 0])))
        block = block_of(task, body.state, cast(Any, None))
        assert np.linalg.norm(block.e) == pytest.approx(lean)
        assert np.abs(block.J).max() < math.pi / 0.02 + 1e-9


def test_line_may_end_either_way_when_allowed() -> None:
    for sign, axis in ((1, (1, 0, 0.3)), (-1, (1, 0, -0.3))):
        body = FreeBody()
        task = LineOnLine(direction=(0, 0, 1), through=(0, 0, 0), axis=axis, either_way=True)
        body.follow(task, 1.5)
        a = body.state.R_WO @ np.array(axis) / np.linalg.norm(axis)
        assert a[2] == pytest.approx(sign, abs=1e-5)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("kind", ["step", "quintic"])
def test_line_normal_to_the_plane_falls_into_it(kind: Any, sign: int) -> None:
    body = FreeBody()
    task = LineOnPlane(
        normal=(0, 0, 1), through=(0, 0, 0), axis=(0, 0, sign), profile=Profile(kind=kind)
    )
    block, errors = body.follow(task, 4.0)
    assert errors[-1] < 1e-3
    assert np.linalg.norm(block.J[1]) == pytest.approx(1.0)
    assert body.state.R_WO[2, 2] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("kind", ["step", "quintic"])
def test_point_leaves_the_circles_axis_and_the_middle_of_the_sphere(kind: Any) -> None:
    profile = Profile(kind=kind)
    body = FreeBody()
    circle = PointOnCircle(center=(0, 0, 0.1), normal=(0, 0, 1), radius=0.05, profile=profile)
    block, errors = body.follow(circle, 4.0)
    assert errors[-1] < 1e-5
    assert np.linalg.norm(body.state.p_WO[:2]) == pytest.approx(0.05, abs=1e-5)
    body = FreeBody()
    block, errors = body.follow(Distance(to=(0, 0, 0), length=0.05, profile=profile), 4.0)
    assert errors[-1] < 1e-5
    assert np.linalg.norm(block.J) == pytest.approx(1.0)
    assert np.linalg.norm(body.state.p_WO) == pytest.approx(0.05, abs=1e-5)


def test_lines_that_are_parallel_already_ask_for_no_turn() -> None:
    task = LineOnLine(direction=(0, 0, 3), through=(0, 0.1, 0), axis=(0, 0, 1))
    block = block_of(task, FreeBody().state, cast(Any, None))
    np.testing.assert_allclose(block.J[2:], [[0, 0, 0, 0, 1, 0], [0, 0, 0, -1, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(block.e, 0, atol=1e-12)


def test_axes_along_a_direction_are_right_handed_and_end_with_it(rng: np.random.Generator) -> None:
    for d in (*rng.normal(size=(20, 3)), *np.eye(3), *-np.eye(3)):
        axes = axes_along(tuple(3.0 * d))
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        np.testing.assert_allclose(axes[2], d / np.linalg.norm(d), atol=1e-15)


def test_distance_error_is_the_distance_less_its_reference(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    task = EXAMPLES["distance to what moves"]
    before = np.linalg.norm(object_point(State(chain), POINT) - THROUGH)
    for q in closed_loop_walk(chain, 5):
        for t in TIMES:
            x = min(max((t - 0.3) / 2.0, 0.0), 1.0)
            share = 10 * x**3 - 15 * x**4 + 6 * x**5
            state = at(chain, q, t)
            to = np.array(THROUGH) + np.array(MOVING) * t
            wanted = np.linalg.norm(object_point(state, POINT) - to) - 0.1
            wanted -= (1 - share) * (before - 0.1)
            assert error(task, state) == pytest.approx([wanted], abs=1e-14)


@pytest.mark.parametrize("turned", [False, True])
def test_twist_rows_are_the_velocity_of_the_point(
    turned: bool, chain: ClosedChain, closed_loop_walk: Walk, rng: np.random.Generator
) -> None:
    names = ("x", "y", "z", "rot_x", "rot_y", "rot_z")
    task = Twist(
        velocity=dict.fromkeys(reversed(names), 0.0),
        point=POINT,
        axes="object" if turned else "world",
    )
    assert task.rows(chain) == names
    for q in closed_loop_walk(chain, 3):
        v = rng.normal(size=chain.n)
        state, after, before = (at(chain, q + h * v, 0.0) for h in (0.0, H, -H))
        linear = (object_point(after, POINT) - object_point(before, POINT)) / (2 * H)
        angular = pin.log3(after.R_WO @ before.R_WO.T) / (2 * H)
        R = state.R_WO.T if turned else np.eye(3)
        stack = rows(task, state)
        np.testing.assert_allclose(stack.J @ v, [*(R @ linear), *(R @ angular)], atol=1e-7)
        np.testing.assert_array_equal(stack.e, np.zeros(6))


def test_twist_commands_the_velocity_given_once_it_has_grown(chain: ClosedChain) -> None:
    task = EXAMPLES["twist"]
    assert task.rows(chain) == ("x", "z", "rot_y")
    for t, share in ((0.3, 0.0), (1.3, 0.5), (9.0, 1.0)):
        rate = rows(task, at(chain, chain.q_start, t)).rate
        np.testing.assert_allclose(rate, share * np.array([0.01, -0.02, 0.2]), atol=1e-15)


def test_twist_can_be_commanded_from_python(chain: ClosedChain) -> None:
    task = Twist(
        velocity={"rot_z": 0.0, "x": 0.0},
        profile=Profile(kind="step"),
        command=lambda t: (2.0 * t, 0.1 * t),
    )
    stack = rows(task, at(chain, chain.q_start, 0.5))
    assert stack.names == ("task[twist].x", "task[twist].rot_z")
    np.testing.assert_allclose(stack.rate, [0.05, 1.0])


@pytest.mark.parametrize(("duration", "reached"), [(0.5, True), (6.0, False)])
def test_twist_is_missed_where_a_limit_stops_it(duration: float, reached: bool) -> None:
    """Upwards at 8 cm/s: the arms can follow for a while, then they stand still and stretched."""
    task = Twist(name="up", velocity={"z": 0.08})
    scenario = replace(load("point_on_point"), tasks=(task,), secondary=(), duration=duration)
    trace = run(scenario, controller="qp")
    (info,) = trace.tasks
    assert (info.name, info.unit) == ("up.velocity", "m/s")
    speed = (trace.position[-1] - trace.position[-2])[2] / scenario.dt
    assert trace.final_error[0] == pytest.approx(abs(0.08 - speed), abs=1e-3)
    if not reached:
        assert np.abs(trace.v[-50:]).max() < 0.1, "without rattling about the singular pose"
    assert bool(trace.final_error[0] <= info.tolerance) == reached


@pytest.mark.parametrize("velocity", [{}, {"roll": 1.0}, {"x": math.nan}])
def test_twist_of_nothing_or_of_unknown_components_is_refused(velocity: dict[Any, float]) -> None:
    with pytest.raises(ValueError, match="velocity"):
        Twist(velocity=velocity)


def test_relative_motion_holds_with_the_loop_open(
    chain: ClosedChain, rng: np.random.Generator
) -> None:
    """Its error is that of pinocchio's frames, and its rows are exact wherever the arms are."""
    task = EXAMPLES["relative motion"]
    model, data = chain.model, chain.model.createData()
    goal = pin.SE3(pin.rpy.rpyToMatrix(*np.radians([20, -10, 30])), np.array([0.02, -0.05, 0.01]))
    for q in chain.sample(rng, 5):
        stack = rows(task, at(chain, q, 9.0))
        pin.framesForwardKinematics(model, data, q)
        X = data.oMf[chain.frames[0]].actInv(data.oMf[chain.frames[1]])
        np.testing.assert_allclose(stack.e[:3], X.translation - goal.translation, atol=1e-13)
        np.testing.assert_allclose(stack.e[3:], pin.log3(X.rotation @ goal.rotation.T), atol=1e-12)
        v = rng.normal(size=chain.n)
        after, before = (error(task, at(chain, q + h * v, 9.0)) for h in (H, -H))
        np.testing.assert_allclose(stack.J @ v, (after - before) / (2 * H), atol=1e-6)


def test_relative_motion_knows_its_arms(chain: ClosedChain) -> None:
    left = RelativeMotion(arm=chain.arms[1].name)
    np.testing.assert_array_equal(
        rows(left, State(chain)).J, rows(RelativeMotion(), State(chain)).J
    )
    for wrong in (chain.arms[0].name, "lft"):
        with pytest.raises(CoopqpError, match=r"relative_motion\.arm"):
            rows(RelativeMotion(arm=wrong), State(chain))


def test_posture_error_is_the_way_left_to_the_reference(
    chain: ClosedChain, rng: np.random.Generator
) -> None:
    goal = np.array([0.1 * i for i in range(10)])
    for t in TIMES:
        q = chain.sample(rng, 1)[0]
        x = min(max((t - 0.3) / 2.0, 0.0), 1.0)
        share = 10 * x**3 - 15 * x**4 + 6 * x**5
        stack = rows(EXAMPLES["whole posture"], at(chain, q, t))
        reference = chain.q_start + share * (goal - chain.q_start)
        np.testing.assert_allclose(stack.e, q - reference, atol=1e-14)
        after, before = (error(EXAMPLES["whole posture"], at(chain, q, t + h)) for h in (H, -H))
        np.testing.assert_allclose(-stack.rate, (after - before) / (2 * H), atol=1e-7)


def test_posture_leaves_joints_alone_that_it_does_not_name(chain: ClosedChain) -> None:
    """Those named come by arm or by joint; a list has all."""
    q = chain.q_start + 0.1
    stack = rows(EXAMPLES["posture"], at(chain, q, 5.0))
    named = [i for i, n in enumerate(chain.joint_names) if n[0] == "R" or n == "LElbowRoll"]
    others = [i for i in range(chain.n) if i not in named]
    assert np.abs(stack.e[named]).min() > 0.01
    np.testing.assert_array_equal(stack.e[others], 0.0)
    np.testing.assert_array_equal(stack.rate[others], 0.0)


@pytest.mark.parametrize(
    ("goal", "match"),
    [
        ({"RElbowRol": 0.1}, "did you mean 'RElbowRoll'"),
        ({"right": [0.1]}, "needs 5"),
        ([0.0] * 9, "needs 10"),
    ],
)
def test_posture_of_another_robot_is_refused(goal: Any, match: str, chain: ClosedChain) -> None:
    with pytest.raises(CoopqpError, match=match):
        rows(Posture(goal=goal), State(chain))


def manipulability(state: State, axes: list[int]) -> tuple[float, float]:
    """The volume of the object's velocities with the loops closed, and its scale, by SVD."""
    _, sizes, basis = np.linalg.svd(state.J_rel)
    free = basis[np.sum(sizes > 1e-8 * sizes[0]) :].T
    sizes = np.linalg.svd(state.J_task[axes] @ free)[1]
    return float(np.prod(sizes)), float(np.mean(sizes**2) ** (0.5 * len(axes)))


@pytest.mark.parametrize("axes", ["xyz", "xy", "z"])
def test_manipulability_climbs_its_gradient(
    axes: str, chain: ClosedChain, closed_loop_walk: Walk, rng: np.random.Generator
) -> None:
    kept = ["xyz".index(axis) for axis in axes]
    _, scale = manipulability(State(chain), kept)
    task = Manipulability(axes=tuple(axes))  # type: ignore[arg-type]
    for q in [*closed_loop_walk(chain, 3), *chain.sample(rng, 3)]:
        e = error(task, State(chain, q))
        for joint, unit in enumerate(np.eye(chain.n)):
            after, before = (
                manipulability(State(chain, q + h * unit), kept)[0] for h in (1e-6, -1e-6)
            )
            assert e[joint] == pytest.approx(-(after - before) / 2e-6 / scale, abs=2e-6)


def test_manipulability_stays_finite_where_there_is_none(rng: np.random.Generator) -> None:
    """A planar robot cannot rise: with z it has no gradient, without it has one."""
    robot = PlanarPair().build()
    q = robot.configuration({"right": [0.3, 0.6, 0.4], "left": [-0.3, -0.6, -0.4]})
    planar = ClosedChain(robot, q, Rigid(), HeldObject())
    for q in (planar.q_start, np.zeros(planar.n), *planar.sample(rng, 5)):
        state = State(planar, q)
        assert np.abs(error(Manipulability(), state)).max() < 1e-3
        assert np.isfinite(error(Manipulability(axes=("x", "y")), state)).all()
    q = planar.q_start
    e = error(Manipulability(axes=("y", "x")), State(planar))
    _, scale = manipulability(State(planar), [0, 1])
    for joint, unit in enumerate(np.eye(planar.n)):
        after, before = (
            manipulability(State(planar, q + h * unit), [0, 1])[0] for h in (1e-6, -1e-6)
        )
        assert e[joint] == pytest.approx(-(after - before) / 2e-6 / scale, abs=1e-5)


def test_least_energy_rows_measure_the_kinetic_energy(
    chain: ClosedChain, closed_loop_walk: Walk, rng: np.random.Generator
) -> None:
    """Against the sum over the links and the object."""
    model, data = chain.model, chain.model.createData()
    for q in closed_loop_walk(chain, 3):
        state, v = State(chain, q), rng.normal(size=chain.n)
        v -= np.linalg.pinv(state.J_rel) @ (state.J_rel @ v)
        energy = pin.computeKineticEnergy(model, data, q, v)
        body, V = chain.held.body(), state.J_task @ v
        V_O = np.concatenate([state.R_WO.T @ V[:3], state.R_WO.T @ V[3:]])
        energy += body.vtiv(pin.Motion(V_O)) / 2
        J = rows(MinimumKineticEnergy(), state).J
        assert np.sum((J @ v) ** 2) == pytest.approx(2.0 * energy, rel=1e-6)


def test_least_energy_is_finite_with_joints_that_move_no_mass(
    nao: RobotModel, chain: ClosedChain
) -> None:
    hinged = ClosedChain(nao, chain.q_start, Hinge(), HeldObject())
    J = rows(MinimumKineticEnergy(), State(hinged)).J
    assert np.isfinite(J).all()
    assert np.linalg.matrix_rank(J) >= hinged.n - 1


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
SMOOTH_KINDS = KINDS[1:]


@pytest.mark.parametrize("kind", KINDS)
def test_profile_rests_at_its_start_and_at_its_end(kind: str) -> None:
    profile = Profile(kind=kind, duration=1.7, delay=0.4)  # type: ignore[arg-type]
    for t in (-1.0, 0.0, 0.39):
        assert profile.at(t) == (0.0, 0.0)
    for t in (profile.end, profile.end + 1e-9, 100.0):
        assert profile.at(t) == (1.0, 0.0)
    assert profile.end == (0.4 if kind == "step" else pytest.approx(2.1))


@pytest.mark.parametrize("kind", SMOOTH_KINDS)
def test_profile_goes_all_the_way_without_turning_back(kind: str) -> None:
    profile = Profile(kind=kind, duration=1.7, delay=0.4)  # type: ignore[arg-type]
    assert profile.at(0.4)[0] == 0.0
    times = np.linspace(0.4, 2.1, 2001)
    shares = np.array([profile.at(t)[0] for t in times])
    assert (np.diff(shares) >= 0).all()
    assert np.diff(shares).max() < 3 / 2000  # nor does it jump
    assert shares[1000] == pytest.approx(0.5)  # symmetric in time


@pytest.mark.parametrize("kind", SMOOTH_KINDS)
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
