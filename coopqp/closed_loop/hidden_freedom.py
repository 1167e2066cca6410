"""Degrees of freedom of over-constrained loops that rounded numbers hide.

A linkage such as Bennett's moves because its loop rows depend on each other wherever the loops are
closed. Where they are closed to rounding only, the smallest singular value of J_c is about as large
as the rounding, and counts as a constraint: rank(J_c) is too large and l - rank too small.

Found by a walk: rows with a singular value below ``SLACK`` count as none, and the joints move in
the null space of the others. A freedom is hidden where the loops stay closed (``model.hold``) on
the whole walk and fewer rows constrain it than J_c has rank. At a singular pose the walk comes to
poses where all rows constrain, opens the loops by the square of its length, or returns.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from coopqp.base.rank import RANK_TOLERANCE
from coopqp.base.spec import Array
from coopqp.closed_loop.screw import scaled
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import CLOSED_ORIENTATION, CLOSED_POSITION

#: Rows that open by less than this resist no motion [m for a unit of joint motion].
SLACK = 1e-3
#: Steps of the walk, and their size [rad or m].
STEPS, STEP = 6, 0.05
#: Errors below this count as equal [m or rad].
RESOLUTION = 1e-6
#: Newton steps back onto the loops, and a loop error that is rounding alone [m or rad].
NEWTON, EXACT = 20, 1e-10


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
