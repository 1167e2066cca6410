"""Mobility of a closed chain at rest: section 3.2 of the paper and what follows from it.

Letters: l joints before the loops close (n in the rest of the code), m rows of J_c, f = l - rank
degrees of freedom, N (l, f) a basis of the null space of J_c, J_o (6, l) the object's twist.

Generic poses are random configurations within the limits at which the object is grasped anew, so
that the loops are closed in each; the start can be less or more mobile than they are.

A linkage such as Bennett's moves because its loop rows depend on each other wherever the loops are
closed. Where they are closed to rounding only, the smallest singular value of J_c is about as large
as the rounding, and counts as a constraint: rank(J_c) is too large and l - rank too small. Such a
:class:`HiddenFreedom` is found by a walk: rows with a singular value below ``SLACK`` count as none,
and the joints move in the null space of the others. It is there where the loops stay closed
(``model.hold``) on the whole walk and fewer rows constrain it than J_c has rank. At a singular pose
the walk comes to poses where all rows constrain, opens the loops by the square of its length, or
returns.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopqp.base.errors import InvalidValueError
from coopqp.base.rank import RANK_TOLERANCE, matrix_rank, null_space
from coopqp.base.spec import Array, seeded
from coopqp.base.wording import counted
from coopqp.closed_loop.constraint_equations import SINGULAR_CONDITION, scheme
from coopqp.closed_loop.screw import LENGTH, MOTION_TOLERANCE, Screw, rank_of, scaled, screw_of
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import CLOSED_ORIENTATION, CLOSED_POSITION

#: All schemes are tried up to this many; beyond it only the asked-for and the best.
MAX_SCHEMES = 5000
#: Motions below this are weak: the joints turn fast, and the object hardly moves.
WEAK = 0.02
#: Rows that open by less than this resist no motion [m for a unit of joint motion].
SLACK = 1e-3
#: Steps of the walk, and their size [rad or m].
STEPS, STEP = 6, 0.05
#: Errors below this count as equal [m or rad].
RESOLUTION = 1e-6
#: Newton steps back onto the loops, and a loop error that is rounding alone [m or rad].
NEWTON, EXACT = 20, 1e-10


@dataclass(frozen=True)
class Scheme:
    """A choice of independent actuated joints; ``_start`` is of the start."""

    joints: tuple[str, ...]
    condition: float  # of the block to be inverted, the median over generic poses
    condition_start: float
    admissible: bool  # whether it is regular at any of these
    admissible_start: bool


@dataclass(frozen=True)
class TaskMobility:
    """A task's rows, and how far they can be chosen freely at the start."""

    name: str
    rows: int
    rank: int  # how many of them can
    weakest: float  # their smallest singular value [m or rad for a unit of joint motion]


@dataclass(frozen=True)
class Mobility:
    """The mobility report; see the module for the letters. ``_start`` is of the start."""

    joints: tuple[str, ...]  # names of the l joints, passive ones included
    passive: tuple[str, ...]
    rank: int  # of J_c at generic poses, the most common
    rank_start: int
    ranks: tuple[int, ...]  # every one that occurred at the generic poses
    freedom: int  # l - rank
    freedom_start: int
    dropped: tuple[str, ...]  # loop rows that follow from others
    object_freedom: int  # independent object motions
    object_freedom_start: int
    motor_freedom: int  # those that the actuated joints decide
    motor_freedom_start: int
    impossible: tuple[Screw, ...]  # object motions that the grasp forbids at the start
    uncontrolled: tuple[Screw, ...]  # object motions that no motor decides, at the start
    tasks: tuple[TaskMobility, ...]  # each task by itself
    tasks_rows: int  # tasks_rows, tasks_rank, tasks_weakest: of all tasks together
    tasks_rank: int
    tasks_weakest: float
    schemes_total: int  # number of choices of f among the actuated joints
    schemes: tuple[Scheme, ...]  # those that were tried, best first
    schemes_complete: bool  # whether these are all
    requested: Scheme | None  # that the user asked about
    hidden: HiddenFreedom | None = None  # the freedom that rounded values hide, if they hide one

    @property
    def inadmissible(self) -> int:
        """Schemes that are singular at every generic pose."""
        return sum(not s.admissible for s in self.schemes)

    @property
    def inadmissible_start(self) -> int:
        """Schemes that are singular at the start."""
        return sum(not s.admissible_start for s in self.schemes)

    @property
    def lost_at_start(self) -> tuple[Scheme, ...]:
        """Schemes that are fine at generic poses and singular at the start."""
        return tuple(s for s in self.schemes if s.admissible and not s.admissible_start)

    def verdict(self) -> str:
        """The report in a few sentences."""
        return " ".join(_sentences(self))


@dataclass(frozen=True)
class _Pose:
    """Jacobians at one closed pose: loop rows and object twist."""

    J_c: Array
    J_o: Array
    N: Array


def mobility(
    chain: ClosedChain,
    *,
    task_rows: Sequence[tuple[str, Array]] = (),
    requested: Sequence[str] | None = None,
    samples: int = 24,
    seed: int = 0,
) -> Mobility:
    """Analyse the mobility of arms that hold an object.

    Args:
        chain: the closed chain, at its start.
        task_rows: name and Jacobian (k, n) of each task at the start.
        requested: an actuation scheme to report on.
        samples: number of generic poses.
        seed: of the generic poses.

    UnknownNameError, InvalidValueError: ``requested`` is no scheme of this chain.
    InvalidValueError: a task's rows do not fit the joints, no sample, or a negative seed.
    """
    for name, J in task_rows:
        if np.shape(J)[1:] != (chain.n,):
            raise InvalidValueError(
                f"task '{name}': found rows of shape {np.shape(J)}, needs (k, {chain.n})"
            )
    if samples < 1:
        raise InvalidValueError(f"samples: found {samples}, needs at least 1")
    rng = seeded(seed)
    poses = _generic_poses(chain, chain.sample(rng, samples))
    start = _pose(chain, chain.q_start)
    active = [i for i in range(chain.n) if i not in chain.passive]
    ranks = [matrix_rank(pose.J_c) for pose in poses]
    rank = max(set(ranks), key=ranks.count)
    regular = [pose for pose, r in zip(poses, ranks, strict=True) if r == rank]
    total = math.comb(len(active), chain.n - rank)
    schemes = _schemes(chain, active, regular, start, chain.n - rank)
    choice = scheme(chain, requested) if requested is not None else None
    tasks = [_of_task(name, J, start) for name, J in task_rows]
    together = _of_task("", np.vstack([np.zeros((0, chain.n)), *(J for _, J in task_rows)]), start)
    return Mobility(
        joints=chain.joint_names,
        passive=tuple(chain.joint_names[i] for i in chain.passive),
        rank=rank,
        rank_start=matrix_rank(start.J_c),
        ranks=tuple(sorted(set(ranks))),
        freedom=chain.n - rank,
        freedom_start=start.N.shape[1],
        dropped=chain.loops.dropped,
        object_freedom=max(rank_of(scaled(pose.J_o @ pose.N)) for pose in regular),
        object_freedom_start=rank_of(scaled(start.J_o @ start.N)),
        motor_freedom=max(_motor_rank(pose, active) for pose in regular),
        motor_freedom_start=_motor_rank(start, active),
        impossible=_screws(start.J_o @ start.N, chain, across=True),
        uncontrolled=_screws(_free_motions(start, active), chain),
        tasks=tuple(tasks),
        tasks_rows=together.rows,
        tasks_rank=together.rank,
        tasks_weakest=together.weakest,
        schemes_total=total,
        schemes=schemes,
        schemes_complete=total <= MAX_SCHEMES,
        requested=_rate(chain, [choice], regular, start)[0] if choice else None,
        hidden=hidden_freedom(chain),
    )


def manipulability(chain: ClosedChain, q: Array, task_rows: Array) -> float:
    """Yoshikawa's sqrt(det(M M')), M = J N, of task rows J (k, n) at q with closed loops."""
    values = np.linalg.svd(task_rows @ _pose(chain, q).N, compute_uv=False)
    return float(np.prod(values)) if len(values) == len(task_rows) else 0.0


def _pose(chain: ClosedChain, q: Array) -> _Pose:
    J_arms = chain.object_jacobians(q)
    J_c = (J_arms[1 : chain.holding] - J_arms[0]).reshape(-1, chain.n)
    J_o = np.tensordot(chain.alpha, J_arms, axes=1)
    return _Pose(J_c, J_o, null_space(J_c))


def _generic_poses(chain: ClosedChain, sampled: Array) -> list[_Pose]:
    """Poses grasped anew; of a closed walk where its ranks are lower: paradoxical linkages."""
    poses = [_pose(chain, q) for q in sampled]
    if max(matrix_rank(pose.J_c) for pose in poses) <= chain.loops.rank:
        return poses
    return [_pose(chain, q) for q in chain.closed_walk(len(sampled))] or poses


def _of_task(name: str, J: Array, start: _Pose) -> TaskMobility:
    values = np.linalg.svd(J @ start.N, compute_uv=False)
    possible = values[values > MOTION_TOLERANCE]
    return TaskMobility(name, len(J), len(possible), float(possible.min(initial=np.inf)))


def _free_motions(pose: _Pose, active: Sequence[int]) -> Array:
    """Object twists that happen with every motor locked, shape (6, .)."""
    locked = null_space(pose.N[list(active)]) if pose.N.size else np.zeros((0, 0))
    return pose.J_o @ pose.N @ locked


def _motor_rank(pose: _Pose, active: Sequence[int]) -> int:
    """Object motions less those that are free with the motors locked."""
    return rank_of(scaled(pose.J_o @ pose.N)) - rank_of(scaled(_free_motions(pose, active)))


def _screws(motions: Array, chain: ClosedChain, *, across: bool = False) -> tuple[Screw, ...]:
    """A basis of object motions, shape (6, .), or of the twists that are orthogonal to them."""
    U, values, _ = np.linalg.svd(scaled(motions))
    rank = int(np.sum(values > MOTION_TOLERANCE))
    basis = U[:, rank:].copy() if across else U[:, :rank].copy()
    basis[3:] /= LENGTH
    return tuple(screw_of(column, chain.start_position) for column in basis.T)


def _schemes(
    chain: ClosedChain, active: Sequence[int], poses: Sequence[_Pose], start: _Pose, freedom: int
) -> tuple[Scheme, ...]:
    """All schemes, or those that are best at some pose, best first."""
    if math.comb(len(active), freedom) <= MAX_SCHEMES:
        choices = list(itertools.combinations(active, freedom))
    else:
        choices = list({_best_choice(pose, active, freedom) for pose in [start, *poses]})
    rated = _rate(chain, choices, poses, start)
    return tuple(sorted(rated, key=lambda s: (s.condition, s.condition_start)))


def _best_choice(pose: _Pose, active: Sequence[int], freedom: int) -> tuple[int, ...]:
    """The joints that pivoting finds best conditioned at a pose."""
    import scipy.linalg

    _, _, order = scipy.linalg.qr(pose.N[list(active)].T, mode="economic", pivoting=True)
    return tuple(sorted(active[i] for i in order[:freedom]))


def _rate(
    chain: ClosedChain, choices: Sequence[Sequence[int]], poses: Sequence[_Pose], start: _Pose
) -> list[Scheme]:
    """Condition of the block that each choice leaves to be inverted."""
    if not choices:
        return []
    others = np.array([[i for i in range(chain.n) if i not in c] for c in choices], np.intp)
    by_pose = np.array([_conditions(pose, others) for pose in poses])
    at_start = _conditions(start, others)
    middle, best = np.median(by_pose, axis=0), by_pose.min(axis=0)
    return [
        Scheme(
            joints=tuple(chain.joint_names[j] for j in choice),
            condition=float(middle[i]),
            condition_start=float(at_start[i]),
            admissible=bool(best[i] < SINGULAR_CONDITION),
            admissible_start=bool(at_start[i] < SINGULAR_CONDITION),
        )
        for i, choice in enumerate(choices)
    ]


def _conditions(pose: _Pose, others: NDArray[np.intp]) -> Array:
    """Condition numbers of J_c's columns for each set of dependent joints; inf when deficient."""
    if not others.shape[1]:
        return np.ones(len(others))  # every joint is free, nothing is inverted
    blocks = np.moveaxis(pose.J_c[:, others], 1, 0)
    values = np.linalg.svd(blocks, compute_uv=False)[:, : others.shape[1]]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(values[:, -1] > 0.0, values[:, 0] / values[:, -1], np.inf)


def _sentences(m: Mobility) -> Iterator[str]:
    yield (
        f"{len(m.joints)} joints and loop rows of rank {m.rank} leave {_degrees(m.freedom)}; the "
        f"object can move in {m.object_freedom} of 6 directions."
    )
    if m.hidden:
        words = m.hidden.describe()
        yield f"{words[0].upper()}{words[1:]}."
    if m.freedom > m.object_freedom:
        more = m.freedom - m.object_freedom
        moves = "moves" if more == 1 else "move"
        yield f"{_degrees(more)} {moves} the joints and not the object."
    if (m.rank, m.object_freedom) != (m.rank_start, m.object_freedom_start):
        yield (
            f"The start is singular: rank {m.rank_start} there, "
            f"{counted(m.object_freedom_start, 'direction')}."
        )
    for where, motors, all_motions in (
        ("", m.motor_freedom, m.object_freedom),
        ("At the start ", m.motor_freedom_start, m.object_freedom_start),
    ):
        if motors < all_motions:
            yield (
                f"{where or 'T'}{'t' if where else ''}he motors decide only {motors} of them: the "
                f"object can move by itself in {all_motions - motors}."
            )
    if m.tasks_rows:
        yield _about_tasks(m)
    if m.requested:
        yield _about_scheme(m.requested)


def _degrees(count: int) -> str:
    return f"{counted(count, 'degree')} of freedom"


def _about_tasks(m: Mobility) -> str:
    names = ", ".join(f"'{task.name}' ({task.rows})" for task in m.tasks)
    rows = counted(m.tasks_rows, "row")
    text = f"The tasks {names} ask {rows}, of which only {m.tasks_rank} can be met."
    if m.tasks_rank == m.tasks_rows:
        left = _degrees(m.freedom_start - m.tasks_rows)
        text = f"The tasks {names} can all be met: {rows}, {left} left."
    if m.tasks_weakest < WEAK:
        text += (
            f" One direction is weak: a unit of joint motion brings about {m.tasks_weakest:.2g} "
            "(m or rad) of it, so a goal far that way is hardly reached."
        )
    return text


def _about_scheme(s: Scheme) -> str:
    names = ", ".join(s.joints)
    if not s.admissible:
        return f"Actuating {names} is inadmissible: it is singular at every pose."
    if not s.admissible_start:
        return (
            f"Actuating {names} is admissible at generic poses (condition {s.condition:.0f}) but "
            "singular at the start."
        )
    return (
        f"Actuating {names} is admissible (condition {s.condition:.0f}, "
        f"{s.condition_start:.0f} at the start)."
    )


@dataclass(frozen=True)
class HiddenFreedom:
    """A motion that the loop rows forbid and the loops allow."""

    start: tuple[float, float]  # loop error at the start [m, rad]
    walk: tuple[float, float]  # largest loop error on the walk [m, rad]
    rank: int  # of the loop rows, by the tolerance of all coopqp
    resisting: int  # rows that constrain the walk
    joint: str  # the joint that moves most on it
    way: float  # how far that joint goes [rad or m]
    unit: str  # of ``way``
    taken: tuple[str, ...]  # arms whose grasp has no object_in_hand, so that the start decides it
    placed: bool  # whether the object's pose is given

    @property
    def of_the_start(self) -> bool:
        """Whether the start alone hides it: closed loops have the freedom."""
        return not self.taken and max(self.walk) < 10.0 * EXACT

    def describe(self) -> str:
        """The fault and its remedy in words."""
        closes = f"the start closes the loops only to {_sizes(*self.start)}"
        if self.taken:
            closes = "the hands hold the object where a rounded start puts them"
        hidden = self.rank - self.resisting
        freedoms = "a freedom" if hidden == 1 else f"{hidden} freedoms"
        return (
            f"{closes}, which may hide {freedoms}: the loop rows have rank {self.rank}, but "
            f"{self.joint} can move by {self.way:.2g} {self.unit} with the loops open by at most "
            f"{_sizes(*self.walk)}; {self._remedy()}"
        )

    def _remedy(self) -> str:
        if self.of_the_start:
            without = " with object.pose left out" if self.placed else ""
            return f"paste the start that `coopqp solve-start` prints{without}"
        if self.taken:
            arms = " and ".join(self.taken)
            return (
                f"give object_in_hand in the grasp of {arms} with all its digits, and then paste "
                "the start that `coopqp solve-start` prints"
            )
        return (
            "solve-start cannot help, since no start closes them better on this way: give the "
            "lengths and angles of the robot and of object_in_hand with more digits"
        )


def hidden_freedom(chain: ClosedChain) -> HiddenFreedom | None:
    """The freedom that rounded values hide at a chain's start; None where there is none."""
    if not chain.loops.rank or _resisting(chain, chain.q_start) >= chain.loops.rank:
        return None
    poses = list(_walk(chain))
    errors = np.array([chain.loop_error_sizes(q) for q in poses])
    resisting = max(_resisting(chain, q) for q in poses)
    position, orientation = errors.max(axis=0).tolist()
    closed = position <= CLOSED_POSITION and orientation <= CLOSED_ORIENTATION
    moved = float(np.linalg.norm(poses[-1] - poses[0])) > 0.5 * STEPS * STEP
    if resisting >= chain.loops.rank or not (closed and moved):
        return None
    way = np.ptp(poses, axis=0)
    joint = int(way.argmax())
    return HiddenFreedom(
        start=chain.loop_error_sizes(chain.q_start),
        walk=(position, orientation),
        rank=chain.loops.rank,
        resisting=resisting,
        joint=chain.joint_names[joint],
        way=float(way[joint]),
        unit=chain.joint_units[joint],
        taken=tuple(a for a in chain.hold.holders if chain.grasps[a].object_in_hand is None),
        placed=chain.held.pose is not None,
    )


def closed_near(chain: ClosedChain, q: Array) -> Array:
    """The configuration near q, shape (n,), that closes the loops best, by Newton's method."""
    for _ in range(NEWTON):
        error = scaled(chain.loop_error(q)[:, None])[:, 0]
        U, values, Vt = np.linalg.svd(scaled(chain.loop_jacobian(q)), full_matrices=False)
        firm = values > SLACK
        step = Vt[firm].T @ ((U[:, firm].T @ error) / values[firm])
        q = q - step
        if np.linalg.norm(step) < 1e-14:
            break
    return q


def _walk(chain: ClosedChain) -> Iterator[Array]:
    """The pose near the start that closes the loops best, and the further steps of the walk."""
    q = closed_near(chain, chain.q_start)
    _, values, Vt = np.linalg.svd(scaled(chain.loop_jacobian(chain.q_start)))
    resisted = np.append(values, np.zeros(chain.n))[: chain.n]
    slack = Vt[(resisted <= SLACK) & (resisted > RANK_TOLERANCE * values[0])]
    ahead = slack.T @ np.random.default_rng(0).normal(size=len(slack))
    yield q
    for _ in range(STEPS):
        _, values, Vt = np.linalg.svd(scaled(chain.loop_jacobian(q)))
        free = Vt[np.sum(values > SLACK) :]
        ahead = free.T @ (free @ ahead)
        ahead /= max(float(np.linalg.norm(ahead)), RANK_TOLERANCE)
        q = closed_near(chain, q + STEP * ahead)
        yield q


def _resisting(chain: ClosedChain, q: Array) -> int:
    values = np.linalg.svd(scaled(chain.loop_jacobian(q)), compute_uv=False)
    return int(np.sum(values > SLACK))


def _sizes(*errors: float) -> str:
    """Of position and orientation, at least ``RESOLUTION``."""
    mm, mrad = (f"{1e3 * x:.2g}" if x >= RESOLUTION else f"{1e3 * RESOLUTION:g}" for x in errors)
    return f"{mm} mm and {mrad} mrad"
