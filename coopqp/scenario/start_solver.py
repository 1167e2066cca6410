"""Find a start that closes all loops: where every arm reaches its grasp, inside the limits.

The object's pose X_WO and every grasp's object_in_hand are given. X_i(q) is where arm i carries the
object, L the length that a radian counts as:

    r_i(q) = [p_i - p_WO; L log(R_i R_WO')],   minimise |r|^2 subject to lower <= q <= upper

by damped Gauss-Newton steps, each a QP with bounds (:mod:`coopqp.scenario.bounded_steps`), from
many random configurations. Every start found is moved to where W |r|^2 + |(q - middle) / half
range|^2 is least and closed again; that with the largest margin wins. A posture to be near takes
the place of the middle, and the start nearest to it wins. Passive joints are variables like all
others; what turns without limits is at most half a turn from the middle. Arms that share a joint (a
torso) are solved together.

Where the object's pose is not given, a start that nearly closes the loops is closed by Newton's
method: the object is where that puts it. Arms that reach few poses need this, since no rounded pose
is exactly reachable.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.sparse.csgraph import connected_components

from coopqp.assessment.thresholds import AT_LIMIT, LOOP_CLOSED
from coopqp.base.errors import GraspError
from coopqp.base.spec import UNLIMITED, Array, seeded
from coopqp.closed_loop.mobility import EXACT, closed_near
from coopqp.closed_loop.screw import LENGTH
from coopqp.grasp import Grasp, pose_matrix
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import (
    HeldObject,
    add_object_frame,
    grasp_of_each,
    object_at_end,
    with_passive_joints,
)
from coopqp.robot import RobotModel
from coopqp.scenario.bounded_steps import MIN_DAMPING, BoundedSteps, Stop
from coopqp.scenario.start import Start, by_arm, start_of

Progress = Callable[[int, int], None]
"""Called after each try with the number of tries made and the most there can be."""

#: Random configurations that are tried per group of arms, and starts after which that ends.
TRIES, ENOUGH = 120, 12
#: Starts of a group that differ by more [rad or m], and of all, that are looked at.
EACH, APART, LOOKED_AT = 8, 0.1, 64
#: Steps of one try, and farthest that a joint goes in one [rad or m].
STEPS, STEP = 80, 0.5
#: A start is closed when no part of r is larger [m].
CLOSED = 1e-11
#: Steps away from the limits, and the weight W of |r|^2 in them [1/m2].
CENTERING_STEPS, CLOSING_WEIGHT = 30, 1e4
#: Digits after the point of joint values to be pasted; loops then close to about 1e-8 m. Of starts
#: that were nearly closed there are more: over-constrained loops move only where they close.
DIGITS, FINE_DIGITS = 8, 12
#: What joints of grippers are called; they place no arm, and turn or slide into their limits.
GRIPPERS = re.compile(r"finger|gripper|jaw|knuckle", re.IGNORECASE)
#: What to do where arms cannot reach, or miss by rounding alone.
MOVE = "move object.pose or change object_in_hand"
ROUNDED = (
    "the pose is rounded: leave object.pose out and give a start (or start_near), near which the "
    "loops are closed then"
)
#: Starts keep this far off the limits, so that rounded values are inside them too [rad or m].
INSIDE = 1e-7


class StartProblem:
    """The robot with its passive joints, and where each arm carries the object.

    Attributes:
        frames: of the object as each arm carries it, by arm.
        columns: indices of the joints that move each arm, by arm.
        middle, half: of the ranges, shape (n,); zero and infinite without limits.
        near: indices of joints that have a posture to be near, which is their middle then.
    """

    def __init__(
        self,
        robot: RobotModel,
        grasps: Mapping[str, Grasp],
        held: HeldObject,
        near: Mapping[str, float | Sequence[float]],
    ) -> None:
        assert held.pose is not None
        self.robot = robot
        X_WO = pose_matrix(held.pose)
        joints = {}
        for name, grasp in grasps.items():
            assert grasp.object_in_hand is not None
            # An axis given in the world is the same in the hand wherever the hinge has turned it.
            R_WT = X_WO.rotation @ pose_matrix(grasp.object_in_hand).rotation.T
            joints[name] = grasp.passive_joints(R_WT)
        self.model, ends = with_passive_joints(robot, joints)
        model = self.model
        self.frames, self.columns = {}, {}
        for arm in robot.arms:
            end, tip = model.getFrameId(ends[arm.name]), model.getFrameId(arm.tip)
            X_EO = object_at_end(model, end, tip, grasps[arm.name])
            self.frames[arm.name] = add_object_frame(model, arm.name, ends[arm.name], X_EO)
            way = model.supports[model.frames[end].parentJoint]
            self.columns[arm.name] = [model.idx_vs[j] for j in way if j > 0]
        self._data = model.createData()
        self._p, self._RT = X_WO.translation.copy(), X_WO.rotation.T.copy()
        self.lower = np.array(model.lowerPositionLimit) + INSIDE
        self.upper = np.array(model.upperPositionLimit) - INSIDE
        self._center()
        self._place(near)

    def _place(self, near: Mapping[str, float | Sequence[float]]) -> None:
        """Let a posture take the place of the middle."""
        robot = self.robot
        arms = {arm.name: robot.arm_joints(arm) for arm in robot.arms}
        joints = dict.fromkeys(name for key in near for name in arms.get(key, (key,)))
        names, own = list(self.model.names)[1:], list(robot.joint_names)
        self.near = np.array([names.index(joint) for joint in joints], int)
        q = robot.configuration(near)[[own.index(joint) for joint in joints]]
        self.middle[self.near] = np.clip(q, self.lower[self.near], self.upper[self.near])
        self.half[self.near] = self._reach[self.near]

    def _center(self) -> None:
        """Middle of the ranges; with one end open, as far from the other as a joint is turned."""
        low, high = np.isfinite(self.lower), np.isfinite(self.upper)
        lower = np.where(low, self.lower, np.where(high, self.upper - 2 * UNLIMITED, -UNLIMITED))
        upper = np.where(high, self.upper, np.where(low, self.lower + 2 * UNLIMITED, UNLIMITED))
        self.middle, self._reach = (lower + upper) / 2, (upper - lower) / 2
        self._sampled = self.middle.copy()
        turns = [kind.shortname().startswith("JointModelR") for kind in list(self.model.joints)[1:]]
        self.endless = np.array(turns) & ~low & ~high
        self.half = np.where(low & high, self._reach, np.inf)

    def sample(self, rng: np.random.Generator) -> Array:
        """A random configuration inside the limits."""
        return self._sampled + self._reach * rng.uniform(-1.0, 1.0, len(self.middle))

    def residual(self, q: Array, arms: Sequence[str]) -> tuple[Array, Array]:
        """Stacked r and its Jacobian, shapes (6 N,) and (6 N, n)."""
        model, data = self.model, self._data
        pin.computeJointJacobians(model, data, q)
        r, J = np.zeros(6 * len(arms)), np.zeros((6 * len(arms), len(q)))
        for i, arm in enumerate(arms):
            frame, at = self.frames[arm], 6 * i
            X = pin.updateFramePlacement(model, data, frame)
            turned = X.rotation @ self._RT
            r[at : at + 3] = X.translation - self._p
            r[at + 3 : at + 6] = LENGTH * pin.log3(turned)
            J_i = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            J[at : at + 3] = J_i[:3]
            J[at + 3 : at + 6] = LENGTH * pin.Jlog3(turned).T @ J_i[3:]
        return r, J

    def worth(self, q: Array, columns: Sequence[int]) -> float:
        """How good a start is: its margin, or its distance to the posture to be near."""
        if posed := [i for i in columns if i in self.near]:
            return -float(np.linalg.norm((q - self.middle)[posed]))
        return float(self.margins(q)[list(columns)].min(initial=np.inf))

    def margins(self, q: Array) -> Array:
        """Distance of each joint to its nearer limit, shape (n,) [rad or m]."""
        return np.minimum(q - self.lower, self.upper - q)


@dataclass(frozen=True)
class StartSolution:
    """A start that closes all loops."""

    q: Array  # of the robot's joints, shape (robot.model.nq,) [rad, m]
    passive: Mapping[str, float]  # of the grasps' joints, by name [rad, m]
    # the same as a scenario has it, by arm and passive joint
    start: Mapping[str, float | list[float]]
    margin: float  # least distance of a joint to its limit [rad, m]; infinite without limits
    tries: int  # random configurations it took; none where a given start was closed
    candidates: int  # starts among which this has the largest margin (least of all groups of arms)
    tightest: str = ""  # the joint with the least distance; empty without limits


def solve_start(
    robot: RobotModel,
    grasps: Grasp | Mapping[str, Grasp],
    held: HeldObject,
    *,
    near: Mapping[str, float | Sequence[float]] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    fits: Callable[[Start], bool] = lambda start: True,
) -> StartSolution:
    """Find a configuration inside the limits in which every arm holds the object, at its pose.

    ``near`` is a posture that the start is to be near, by arm or joint; others may be anywhere.
    ``seed`` is of the random configurations; ``progress`` is called after each try. ``fits`` says
    what starts should keep beside; the best that does is taken, or the best.

    GraspError: pose or object_in_hand is missing, or an arm cannot reach: which, how far.
    UnknownNameError: a grasp for an arm that the robot does not have.
    """
    grasp_of = grasp_of_each(robot, grasps)
    missing = ["" if held.pose else "object.pose", _without_object(grasp_of)]
    if missing := list(filter(None, missing)):
        raise GraspError(f"to solve for a start, give {' and '.join(missing)}")
    problem = StartProblem(robot, grasp_of, held, near or {})
    groups = _groups(problem.columns)
    rng = seeded(seed)
    searches = [_Search(problem, arms, rng) for arms in groups]
    failed: list[str] = []
    for i, search in enumerate(searches):
        for done in itertools.chain(search.run(), [TRIES]):
            if progress:
                progress(i * TRIES + done, TRIES * len(groups))
        if not search.kept:
            failed += _cannot_reach(search)
    if failed:
        rounded = max(search.gap for search in searches if not search.kept) < LOOP_CLOSED
        raise GraspError("; ".join([*failed, ROUNDED if rounded else MOVE]))
    ranked = list(_ranked(problem, searches))
    return next((one for one in ranked if fits(one.start)), ranked[0])


def _ranked(problem: StartProblem, searches: Sequence[_Search]) -> Iterator[StartSolution]:
    tries, closed = sum(one.tries for one in searches), min(one.closed for one in searches)
    choices = itertools.product(*(enumerate(search.ranked()) for search in searches))
    q = problem.middle.copy()
    for choice in sorted(choices, key=lambda ones: sum(rank for rank, _ in ones))[:LOOKED_AT]:
        for search, (_, one) in zip(searches, choice, strict=True):
            q[search.columns] = one[search.columns]
        names = list(problem.model.names)[1:]
        yield _solution(problem.robot, names, q, problem.margins(q), tries, closed)


def close_start(
    robot: RobotModel, grasps: Grasp | Mapping[str, Grasp], held: HeldObject, start: Start
) -> StartSolution:
    """Close the loops near a start [rad, m] that nearly closes them, wherever the object then is.

    Raises:
        GraspError: object_in_hand is missing, the start is farther off than counts as closed, the
            loops cannot be closed near it, or only outside the limits.
        UnknownNameError: an arm or a joint that the robot does not have.
    """
    grasp_of = grasp_of_each(robot, grasps)
    if unknown := _without_object(grasp_of):
        raise GraspError(f"to close the loops near a start, give {unknown}")
    own, passive = start_of(robot, start)
    q = robot.configuration(own)
    chain = ClosedChain.attach(robot, q, grasp_of, held, passive_start=passive)
    q = closed_near(chain, chain.q_start)
    if not np.abs(chain.loop_error(q)).max() < EXACT:
        raise GraspError(
            "no start near this one closes the loops exactly: the lengths and angles of the robot "
            "or of object_in_hand are rounded; give more digits"
        )
    margins = np.minimum(q - chain.lower, chain.upper - q)
    if margins.min() < 0.0:
        raise GraspError(
            "the start near this one that closes the loops has "
            f"{chain.joint_names[margins.argmin()]} outside its limits; change the start"
        )
    return _solution(robot, chain.joint_names, q, margins)


def yaml_text(solution: StartSolution) -> str:
    """The start as a scenario file has it, with a comment on how it was found."""
    text = f"{solution.margin:.3g} rad or m inside the limits" if solution.tightest else "no limits"
    if GRIPPERS.search(solution.tightest):
        text += f" (at {solution.tightest}, which seems to be a gripper's: lock it)"
    if not solution.tries:
        remark = f"{text}, the nearest to the given one that closes the loops"
        return start_text(solution.start, remark, FINE_DIGITS)
    return start_text(solution.start, f"{text}, the best of {solution.candidates} found")


def start_text(start: Mapping[str, float | list[float]], remark: str, digits: int = DIGITS) -> str:
    """A start as a scenario file has it, with a comment."""
    lines = [f"start:   # rad, m; {remark}"]
    for name, value in start.items():
        rounded = np.round(np.atleast_1d(np.asarray(value)), digits) + 0.0  # no minus zero
        numbers = [f"{x:.{digits}f}" for x in rounded]
        text = f"[{', '.join(numbers)}]" if isinstance(value, list) else numbers[0]
        lines.append(f"  {name}: {text}")
    return "\n".join([*lines, ""])


def _without_object(grasps: Mapping[str, Grasp]) -> str:
    unknown = [arm for arm, grasp in grasps.items() if grasp.object_in_hand is None]
    return f"object_in_hand in the grasp of {' and '.join(unknown)}" if unknown else ""


def _solution(
    robot: RobotModel, names: Sequence[str], q: Array, slack: Array, tries: int = 0, closed: int = 1
) -> StartSolution:
    """The answer in the robot's own terms, with the margin of each joint to its limits."""
    values = dict(zip(names, q.tolist(), strict=True))
    return StartSolution(
        q=np.array([values[name] for name in robot.joint_names]),
        passive={name: x for name, x in values.items() if name not in robot.joint_names},
        start=by_arm(robot, values),
        margin=float(slack.min(initial=np.inf)),
        tries=tries,
        candidates=closed,
        tightest=str(names[int(slack.argmin())]) if np.isfinite(slack).any() else "",
    )


class _Search:
    """Tries of a group of arms: the joints searched, closed q with their worth, the nearest."""

    def __init__(
        self, problem: StartProblem, arms: Sequence[str], rng: np.random.Generator
    ) -> None:
        self.problem, self.arms, self.rng = problem, tuple(arms), rng
        self.columns = sorted({j for arm in arms for j in problem.columns[arm]})
        self.kept: list[tuple[float, Array]] = []
        self.nearest = problem.middle.copy()
        self.tries = self.closed = 0
        self.gap = np.inf
        self._bounds = problem.lower[self.columns], problem.upper[self.columns]
        self._steps = BoundedSteps(len(self.columns))

    def run(self) -> Iterator[int]:
        """Yields the number of tries made."""
        while self.tries < TRIES and self.closed < ENOUGH:
            q = self.problem.middle.copy()
            if self.tries:
                q[self.columns] = self.problem.sample(self.rng)[self.columns]
            self.tries += 1
            gap = self._close(q)
            if gap < self.gap:
                self.gap, self.nearest = gap, q.copy()
            if gap < CLOSED:
                self.closed += 1
                self._keep(q)
                self._center(q)
                if self._close(q) < CLOSED:
                    self._keep(q)
            yield self.tries

    def _keep(self, q: Array) -> None:
        turns = np.round((q - self.problem.middle) / (2.0 * np.pi))
        q -= np.where(self.problem.endless, 2.0 * np.pi * turns, 0.0)
        self.kept.append((self.problem.worth(q, self.columns), q.copy()))

    def ranked(self) -> list[Array]:
        """Starts that differ, the best first."""
        found: list[Array] = []
        for _, q in sorted(self.kept, key=lambda one: -one[0]):
            if all(np.abs(q - other)[self.columns].max() > APART for other in found[:EACH]):
                found.append(q)
        return found[:EACH]

    def _close(self, q: Array) -> float:
        """Levenberg-Marquardt from q, which is moved; returns the largest part of r at the end."""
        problem, columns, at = self.problem, self.columns, q.copy()

        def residual(x: Array) -> tuple[Array, Array]:
            at[columns] = x
            r, J = problem.residual(at, self.arms)
            return r, J[:, columns]

        x, stop = q[columns], Stop(STEPS, STEP, lambda r: bool(np.abs(r).max() < CLOSED))
        r = self._steps.descend(x, residual, self._bounds, stop)
        q[columns] = x
        return float(np.abs(r).max())

    def _center(self, q: Array) -> None:
        """Gauss-Newton steps towards mid-range that keep the loops nearly closed."""
        problem, columns = self.problem, self.columns
        pull = 1.0 / problem.half[columns] ** 2
        for _ in range(CENTERING_STEPS):
            r, J = problem.residual(q, self.arms)
            J, x = J[:, columns], q[columns]
            slope = CLOSING_WEIGHT * J.T @ r + pull * (q - problem.middle)[columns]
            curvature, damping = CLOSING_WEIGHT * J.T @ J, pull + MIN_DAMPING
            q[columns] = self._steps.step(x, curvature, slope, damping, self._bounds, STEP)
            if np.abs(q[columns] - x).max() < 1e-3:
                break


def _groups(columns: Mapping[str, Sequence[int]]) -> list[tuple[str, ...]]:
    """Arms that share joints, directly or through others."""
    share = [
        [not set(one).isdisjoint(other) for other in columns.values()] for one in columns.values()
    ]
    count, labels = connected_components(np.array(share))
    return [tuple(np.array(list(columns))[labels == k].tolist()) for k in range(count)]


def _cannot_reach(search: _Search) -> list[str]:
    each = [search]
    if len(search.arms) > 1:
        each = [_Search(search.problem, [arm], search.rng) for arm in search.arms]
        for single in each:
            for _ in single.run():
                pass
    if alone := [single for single in each if not single.kept]:
        return [f"arm {s.arms[0]} cannot reach its grasp: {_how_far(s)}" for s in alone]
    return [
        f"arms {' and '.join(search.arms)} reach their grasps each by itself, but not with "
        f"the joints they share: {_how_far(search)}"
    ]


def _how_far(search: _Search) -> str:
    problem, q = search.problem, search.nearest
    r, _ = problem.residual(q, search.arms)
    offsets = []
    for arm, part in zip(search.arms, r.reshape(-1, 6), strict=True):
        gap, angle = 1e3 * np.linalg.norm(part[:3]), np.degrees(np.linalg.norm(part[3:]) / LENGTH)
        of = f"{arm} " if len(search.arms) > 1 else ""
        offsets.append(f"{of}{gap:.1f} mm and {angle:.1f} degrees")
    margins = problem.margins(q)
    names = [problem.model.names[1 + j] for j in search.columns if margins[j] < AT_LIMIT]
    held_back = f", with {', '.join(names)} at the limit" if names else ""
    if fingers := [name for name in names if GRIPPERS.search(name)]:
        held_back += f" (of a gripper, it seems: lock {' and '.join(fingers)})"
    return f"the nearest of {search.tries} tries is off by {' and '.join(offsets)}{held_back}"
