"""A problem and its tasks, in the order of the plain law, as flat arrays for the kernel."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.kernel import native
from coopqp.limit import DistanceBounds, JointBounds, TwistBounds, movers, opening
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.geometry import Reference
from coopqp.model.state import State
from coopqp.program import sees_twist
from coopqp.robot import Convex, axis_of
from coopqp.signal import InputValues, Moment
from coopqp.task import Programs, Task, TaskStack, curvature_bounds_of, evaluate_all

Flat = dict[str, Any]

LARGE = 1e300  # stands for no limit


def flat_model(chain: ClosedChain) -> Flat | None:
    """Joints with their axes turned to z, and the arms; None where a joint is of another kind."""
    model = chain.model
    kinds = [_axis(model.joints[j]) for j in range(1, model.njoints)]
    if None in kinds or any(model.idx_vs[j] != j - 1 for j in range(1, model.njoints)):
        return None
    axes, placements, objects = chain.once(turned), [], []
    for j in range(1, model.njoints):
        A, X = axes[model.parents[j]].T, model.jointPlacements[j]
        placements += [(A @ X.rotation @ axes[j]).ravel(), A @ X.translation]
    frames = [model.frames[frame] for frame in chain.frames]
    for f in frames:
        A, X = axes[f.parentJoint].T, f.placement
        objects += [(A @ X.rotation).ravel(), A @ X.translation]
    return {
        "parents": np.array([float(parent - 1) for parent in list(model.parents)[1:]]),
        "slides": np.array([float(kind[0]) for kind in kinds if kind]),
        "placements": np.concatenate(placements),
        "tips": np.array([float(f.parentJoint - 1) for f in frames]),
        "object_placements": np.concatenate(objects),
        "alpha": np.ascontiguousarray(chain.alpha),
        "holding": float(chain.holding),
    }


def turned(chain: ClosedChain) -> list[Array]:
    """Rotation of the kernel's frame of each joint in the joint's own; the world's first."""
    axes = [_axis(chain.model.joints[j]) for j in range(1, chain.model.njoints)]
    return [np.eye(3), *(np.eye(3) if axis is None else _z_along(axis[1]) for axis in axes)]


def flat_settings(
    problem: ControlProblem, damping: float, error_damping: float, inequalities: int
) -> Flat:
    """Constants of a problem; arguments as in :class:`coopqp.kernel.compiled.Compiled`."""
    chain, budget = problem.chain, problem.budget
    return {
        "dt": problem.dt,
        "kappa": problem.kappa,
        "damping": damping,
        "error_damping": error_damping,
        "reach": chain.reach,
        "budget": np.array([
            budget.equality, budget.bound, budget.accuracy,
            budget.loop_position, budget.loop_orientation,
        ]),
        "lower": np.maximum(chain.lower, -LARGE),
        "upper": np.minimum(chain.upper, LARGE),
        "second_order": opening(chain, problem.dt).ravel(),
        "inequalities": float(inequalities),
        "relaxes": float(problem.on_infeasible == "scale"),
    }  # fmt: skip


def flat_joint_limit(bounds: JointBounds) -> Flat:
    """Bounds on the joints as numbers."""
    return {
        "kind": float(bounds.of),
        "lower": np.maximum(bounds.lower, -LARGE),
        "upper": np.minimum(bounds.upper, LARGE),
        "step": np.zeros(0) if bounds.step is None else bounds.step,
        "speed": float(bounds.speed),
    }


def flat_twist_limit(bounds: TwistBounds, at: int) -> Flat:
    """Bounds on the object's twist as numbers; ``at``: the first of their rows."""
    return {
        "at": float(at),
        "components": np.array(bounds.components, float),
        "bounds": np.array(bounds.bounds, float),
        "points": np.array(bounds.points, float).ravel(),
        "normal": np.array(bounds.normal, float),
        "offset": float(bounds.offset),
        "gain": float(bounds.gain),
    }


def flat_distances(chain: ClosedChain, bounds: DistanceBounds) -> Flat:
    """Pairs of bodies as numbers."""
    bodies = zip(bounds.bodies, bounds.max_point_speeds, strict=True)
    return {
        "solids": [_flat_solid(chain, *body, speeds) for body, speeds in bodies],
        "pairs": bounds.pairs.astype(float).ravel(),
        "distance": float(bounds.distance),
        "gain": float(bounds.gain),
        "within": float(bounds.within),
    }


def _flat_solid(chain: ClosedChain, joint: int, convex: Convex, speeds: Array) -> Flat:
    A, X = chain.once(turned)[joint].T, convex.placement
    return {
        "joint": float(joint - 1),
        "placement": np.concatenate([(A @ X.rotation).ravel(), A @ X.translation]),
        "form": float(convex.form),
        "half": np.array(convex.half, float),
        "radius": float(convex.radius),
        "rim": float(convex.rim),
        "points": np.array(convex.points, float).ravel(),
        "edges": convex.edges.astype(float).ravel(),
        "max_point_speeds": np.array(speeds, float),
    }


def kept_rows(chain: ClosedChain) -> Array:
    """1 for each loop row that the solvers see, shape (6 L,) of the closed loops."""
    kept = np.zeros(chain.loops.closed)
    kept[list(chain.loops.kept)] = 1.0
    return kept


def _axis(joint: pin.JointModel) -> tuple[bool, Array] | None:
    """Whether a joint slides, and along or about which axis."""
    S = axis_of(joint)
    if S is None:
        return None
    linear, angular = S[:3], S[3:]
    if linear.any() and angular.any():
        return None
    slides = bool(linear.any())
    return slides, linear if slides else angular


def _z_along(axis: Array) -> Array:
    """A rotation A with A e_z along the axis."""
    d = axis / np.linalg.norm(axis)
    if d[2] == 1.0:
        return np.eye(3)
    least = int(np.argmin(np.abs(d)))
    x = np.eye(3)[least] - d[least] * d
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(d, x), d])


#: Numbers of a level's rows.
ROW = ("gain", "weight", "curvature_bound", "asks_velocity", "twist", "share")


@dataclass(frozen=True)
class Group:
    """The tasks of one level, by mode; later levels have soft ones alone."""

    soft: Sequence[Task]
    hard: Sequence[Task] = ()
    scaled: Sequence[Task] = ()


class Levels:
    """Tasks level by level; programs: of tasks, from the state where their references start.

    Attributes:
        flat: each level's numbers.
        primitives: the tasks that the kernel evaluates itself, as numbers.
        filled, bound: the others, which Python fills: a stack of each alone; its arrays for the
            kernel to read, its level, first row, whether J is the identity, weight and gain.
        arriving: references whose place is an input and nothing else, each with the index of its
            primitive; the kernel reads the input itself.
        followed: other references that signals move.
    """

    def __init__(self, groups: Sequence[Group], programs: Programs) -> None:
        self.primitives: list[Flat] = []
        self.filled: list[TaskStack] = []
        self.bound: list[tuple[Any, ...]] = []
        self.arriving: list[tuple[int, Reference]] = []
        self.followed: list[tuple[int, Reference]] = []
        self._programs, self._start = programs, programs.start
        self._heard: InputValues | None = None
        self.flat = [self._level(level, group) for level, group in enumerate(groups)]

    @property
    def compiled(self) -> bool:
        return not self.filled

    @property
    def in_python(self) -> tuple[str, ...]:
        return tuple(task.name for stack in self.filled for task in stack.tasks)

    def follow(self, state: State) -> None:
        """Move the references that follow signals; kinematics need not be up to date."""
        if state.inputs is not self._heard:
            self._heard, self._shown = state.inputs, state.inputs.shown()
        at = Moment(state.t, self._shown)
        with np.errstate(all="ignore"):
            for _, reference in self.followed:
                reference.update(at)

    def update(self, state: State) -> None:
        self.follow(state)
        evaluate_all([pair for stack in self.filled for pair in stack.bound], state)

    def _level(self, level: int, group: Group) -> Flat:
        rows: list[tuple[float, ...]] = []
        joint_weight, first = 0.0, list[float]()
        for task in group.hard:
            first.append(float(len(rows)))
            self._take(level, task, rows)
        hard = len(rows)
        for share, task in enumerate(group.scaled):
            self._take(level, task, rows, share)
        exact = len(rows)
        for task in group.soft:
            joints = task.joint_space and task.all_joints
            self._take(level, task, rows, joints=joints)
            joint_weight += float(task.weight) if joints else 0.0
        columns = np.array(rows, float).reshape(-1, len(ROW)).T
        return {
            **{name: column.copy() for name, column in zip(ROW, columns, strict=True)},
            "hard": float(hard),
            "exact": float(exact),
            "shares": float(len(group.scaled)),
            "task": np.array(first),
            "joint_weight": joint_weight,
        }

    def _take(
        self,
        level: int,
        task: Task,
        rows: list[tuple[float, ...]],
        share: int = -1,
        *,
        joints: bool = False,
    ) -> None:
        """Add a task's rows to a level, as primitives where it has any."""
        program, at, twist = self._programs.of(task), len(rows), False
        bounds, weight, gain = curvature_bounds_of(task, self._start.chain), task.weight, task.gain
        if program is None or not all(p.compiles and p.of_joints == joints for p in program):
            stack = TaskStack([task], self._start)
            block = stack.e, stack.J, stack.rate
            self.filled.append(stack)
            self.bound.append((*block, level, at, joints, float(weight), float(gain)))
        else:
            numbers = {"level": float(level), "weight": float(weight), "gain": float(gain)}
            twist = sees_twist(program)
            for primitive in program:
                if primitive.reference.follows:
                    of_kind = self.arriving if primitive.reference.arrives else self.followed
                    of_kind.append((len(self.primitives), primitive.reference))
                self.primitives.append({**primitive.flat(self._start), **numbers, "at": float(at)})
                at += len(primitive.rows)
            bounds = bounds[: at - len(rows)]
        if not joints:
            rows += [(gain, weight, bound, task.asks_velocity, twist, share) for bound in bounds]


#: What the compiled arrays hold: joints of two arms, joints that move several arms, loops.
MOST_LANES, MOST_SHARED, MOST_LOOPS = 64, 6, 16


def why_not(problem: ControlProblem) -> str:
    """Why the kernel cannot do a problem; empty where it can."""
    chain = problem.chain
    if native.module() is None:
        return native.MISSING
    if not problem.solver.kernel_instead:
        return "the scenario asks for another solver"
    return unfit(chain)


def unfit(chain: ClosedChain) -> str:
    """What of a chain the kernel cannot do; empty where it can do all."""
    if chain.loops.varying:
        return "which loop rows depend on others changes with the pose"
    return chain.once(_unfit)


def _unfit(chain: ClosedChain) -> str:
    if chain.once(flat_model) is None:
        return "a joint is neither a hinge nor a slide"
    if chain.n <= len(chain.loops.kept):
        return "the loops leave no motion"
    moved = movers(chain, [chain.model.frames[frame].parentJoint for frame in chain.frames])
    shared = moved.sum(axis=0) > 1.0
    first = np.count_nonzero(shared | (moved[0] > 0.0))
    others = (moved[1 : chain.holding] * ~shared).sum(axis=1)
    widest = max(first, 6 + np.count_nonzero(shared)) + others.max(initial=0.0)
    if widest > MOST_LANES and chain.holding > 1:
        return f"two arms have more than {MOST_LANES} joints together"
    if np.count_nonzero(shared) > MOST_SHARED:
        return f"more than {MOST_SHARED} joints move several arms"
    carry, kept = int(first), kept_rows(chain).reshape(-1, 6).sum(axis=1)
    for own, rows in zip(others, kept, strict=True):
        left = int(carry + own - rows)
        if left < 0:
            return "a loop has fewer joints than rows"
        carry = min(left, 6 + int(np.count_nonzero(shared)))
    if chain.holding - 1 > MOST_LOOPS:
        return f"there are more than {MOST_LOOPS} loops"
    return ""


#: slide(q, direction, length, steps) moves q in place along the projection of a direction on the
#: motions that keep the loops closed, and closes them by Newton steps; returns the largest loop
#: error [m, rad], below zero where rows that are independent in general are not so.
Slide = Callable[[Array, Array, float, int], float]


def slide(chain: ClosedChain) -> Slide | None:
    """The function that moves a chain along its loops; None where the kernel cannot."""
    return chain.once(_slide)


def _slide(chain: ClosedChain) -> Slide | None:
    engine: Any = native.module()
    model = chain.once(flat_model)
    if engine is None or model is None or unfit(chain):
        return None
    step: Slide = engine.Slide({"model": model, "kept": kept_rows(chain)}).step
    return step
