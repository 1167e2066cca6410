"""What a limit is: bounds on v, and inequality rows G v <= h, that hold whatever the tasks want."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from coopqp.base.qp import Row, Side
from coopqp.base.spec import Array, spec, type_name
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.marker import Marker
from coopqp.model.state import State
from coopqp.robot import Convex

#: A joint that is beyond a limit of its place by less is inside but for rounding [rad, m].
ROUNDING = 1e-9
#: Depth up to which what crossed a limit in space recovers [m].
SHALLOW = 1e-3


@dataclass(frozen=True)
class LimitRows:
    """Where a limit tightens bounds lb, ub on v (n,), and writes its rows G (p, n), h (p,)."""

    lb: Array
    ub: Array
    G: Array
    h: Array


class Bounded(IntEnum):
    """What bounds on joints are of, from which ``kernel/core/shared.hpp`` is made."""

    VELOCITY = 0  # v
    POSITION = 1  # q after a step
    BRAKING = 2  # q that a joint can still stop before
    LEAD = 3  # q - q_measured


@dataclass(frozen=True, kw_only=True)
class JointBounds:
    """Bounds on each joint's velocity, for the kernel, from bounds of what ``of`` names."""

    of: Bounded
    lower: Array
    upper: Array
    step: Array | None = None  # how much v may change in a tick (BRAKING)
    speed: float = 0.0  # of recovery (POSITION)


@dataclass(frozen=True, kw_only=True)
class TwistBounds:
    """Rows of a limit on the object's twist alone, for the kernel."""

    components: Sequence[int] = ()  # in world axes that are bounded, upper sides, then lower ones
    bounds: Sequence[float] = ()  # their bounds [m/s, rad/s]
    # of the object, which stay on one side of a plane, in the object frame, shape (k, 3) [m]
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    normal: Array = field(default_factory=lambda: np.zeros(3))  # into the side that is allowed
    offset: float = 0.0  # n'p of the points on it [m]
    gain: float = 0.0  # share of the distance that may be used up per second [1/s]

    @property
    def rows(self) -> int:
        return 2 * len(self.components) + len(self.points)


@dataclass(frozen=True, kw_only=True, eq=False)
class DistanceBounds:
    """Rows of a limit that keeps pairs of bodies apart, for the kernel."""

    bodies: Sequence[tuple[int, Convex]]  # each with the id of its joint; 0 is the world
    max_point_speeds: Array  # of each body's points, by each joint at speed 1, (b, n) [m, 1]
    pairs: NDArray[np.int64]  # of bodies, as numbers in ``bodies``, shape (p, 2)
    distance: float  # to keep [m]
    gain: float  # share of what is left that may be used up per second [1/s]
    within: float  # what pairs are farther apart than that may be used up in a tick [m]


Program = JointBounds | TwistBounds | DistanceBounds

Tighten = Callable[[State, LimitRows], None]

Clearance = Callable[[State], Array]
"""Distances left in space at a state, in the order of the limit's rows, shape (k,) [m].

Rows after the first k only help to keep the others.
"""


@spec
class Limit(ABC):
    """A plug-in in ``limits/``: a hard bound on the motion."""

    constant: ClassVar[bool] = False
    """Whether the bounds are the same in every tick, so that they are asked for once."""
    sacrificed_first: ClassVar[bool] = False
    """Whether it may be relaxed before the Baumgarte correction when not everything can hold."""

    uses_measurements: ClassVar[bool] = False
    """Whether it depends on measurements, which geometry alone cannot explain."""

    bounds_position: ClassVar[bool] = False
    """Whether its bounds on v are bounds on q, divided by dt."""

    def rows(self, chain: ClosedChain) -> tuple[Row, ...]:
        """Its inequality rows beside the bounds; CoopqpError if this chain cannot have them."""
        return ()

    @abstractmethod
    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        """Return the function that tightens the bounds each tick of dt [s]."""

    def program(self, chain: ClosedChain, dt: float) -> Program | None:
        """The same as numbers for the kernel; None where it has no such form."""
        return None

    def margins(self, chain: ClosedChain, q: Array, v: Array, dt: float) -> dict[Row, Array]:
        """How far a run stayed away from this limit, for the audit.

        q has shape (T + 1, n) [rad, m], row k + 1 after tick k, and v (T, n) [rad/s, m/s].

        By row, such as "limit.position[RElbowRoll].upper" or one of :meth:`rows`, in the row's
        unit, shape (T,); negative where violated. Infinite sides are left out. For a limit with
        :meth:`clearance`, that after each tick.
        """
        left = self.clearance(chain)
        if left is None:
            return {}
        found = np.array([left(state) for state in states_along(chain, q[1:])])
        return dict(zip(self.rows(chain), found.T, strict=False)) if len(found) else {}

    def audited(self, chain: ClosedChain) -> bool:
        """Whether :meth:`margins` or :meth:`clearance` say how far a run stayed away from it."""
        return type(self).margins is not Limit.margins or self.clearance(chain) is not None

    def clearance(self, chain: ClosedChain) -> Clearance | None:
        """Distance of what a limit in space bounds from it; None for all others.

        Its :meth:`rows` are then velocity dampers: G = -d clearance/dq. Of what is far, both
        may say nothing; rows may look farther where joints are fast.
        """
        return None

    def relaxed(self, by: float) -> Limit | None:
        """The limit relaxed by a distance [m], to verify ``explain``; None where it has none."""
        return None

    def start_faults(self, chain: ClosedChain) -> tuple[str, ...]:
        """What is wrong with a file's start, a sentence each; :meth:`bind` must stand any state."""
        return ()

    def unseen(self, chain: ClosedChain) -> tuple[str, ...]:
        """What of the chain it should bound and cannot, one sentence each, for every verdict."""
        return ()

    def notes(self, chain: ClosedChain) -> tuple[str, ...]:
        """What of the chain it cannot or does not bound, one sentence each."""
        return self.unseen(chain)

    def marks(self, t: float) -> tuple[Marker, ...]:
        """What pictures show of it at t since the beginning of the motion, or of its phase [s]."""
        return ()


def damp(
    margin: Array, gain: Array, deep: NDArray[np.bool_], h: Array, shallow: float = SHALLOW
) -> None:
    """Velocity damper, d_dot >= -gain d, written to the right side of rows -d_dot <= h [m/s].

    A distance d [m] that is a little negative, by the curvature of the path in a tick, recovers.
    Below -shallow [m] it was there from the start: it may not decrease, but recovery could leave no
    motion at all, so there h = 0. All have shape (p,); ``deep`` is scratch, gain in 1/s.
    """
    np.multiply(margin, gain, h)
    np.less(margin, -shallow, deep)
    np.copyto(h, 0.0, where=deep)


def states_along(chain: ClosedChain, q: Iterable[Array]) -> Iterator[State]:
    """The state at each row of q; one object that is reused."""
    state = State(chain)
    for row in q:
        state.q[:] = row
        state.update()
        yield state


def place_row(owner: str, what: str, label: str) -> Row:
    """The row "limit.OWNER" and what of it, which bounds a distance [m]."""
    name = f"limit.{owner}{what}"
    return Row(name=name, kind="limit", owner=owner, unit="m", label=label, of_place=True)


@lru_cache(maxsize=1024)  # margins of a run that goes on are asked for ten times a second
def _joint_row(kind: str, name: str, unit: str, side: Side, per: str) -> Row:
    """The row "limit.KIND[JOINT].upper" of one side; ``per`` divides the joint's unit, "/s"."""
    of = "" if kind == "position" else f"{kind.replace('_', ' ')} of "
    return Row(
        name=f"limit.{kind}[{name}].{side}",
        kind="limit",
        owner=kind,
        unit=f"{unit}{per}",
        joint=name,
        side=side,
        label=f"{of}{name} ({side})",
        of_place=not per,
    )


def joint_margins(
    kind: str, chain: ClosedChain, below: Array, above: Array, per: str = ""
) -> dict[Row, Array]:
    """Finite margins of all joints, from distances to both limits, shape (T, n) each."""
    sides: tuple[tuple[Side, Array], ...] = (("lower", below), ("upper", above))
    return {
        _joint_row(kind, *joint, side, per): margin[:, i]
        for i, joint in enumerate(zip(chain.joint_names, chain.joint_units, strict=True))
        for side, margin in sides
        if np.isfinite(margin[:, i]).all()
    }


def bound_rows(limit: Limit, chain: ClosedChain, side: Side) -> tuple[Row, ...]:
    """What a limit's bounds on v are called, joint by joint, in units of a velocity or a place."""
    kind = type_name(type(limit)).removeprefix("joint_")
    per = "" if limit.bounds_position else "/s"
    joints = zip(chain.joint_names, chain.joint_units, strict=True)
    return tuple(_joint_row(kind, *joint, side, per) for joint in joints)


def movers(chain: ClosedChain, joints: Sequence[int]) -> Array:
    """1 where a joint (n) moves the body that a joint id (0: the base) carries, else 0."""
    return np.asarray(chain.once(_movers)[np.array(joints, int)])


def _movers(chain: ClosedChain) -> Array:
    """Of every joint id, shape (joints, n)."""
    model = chain.model
    moved = np.zeros((model.njoints, chain.n))
    for row, supports in zip(moved, model.supports, strict=True):
        row[[model.idx_vs[i] for i in supports if i]] = 1.0
    return moved


def opening(chain: ClosedChain, dt: float) -> Array:
    """How far a step v dt opens each closed loop at most, per metre of reach and v^2, shape (L, n).

    Of two arms with k joints each, dt^2 / 2 (k_i sum_i v_j^2 + k_0 sum_0 v_j^2).
    """
    return np.asarray(0.5 * dt**2 * chain.once(_joints_squared))


def _joints_squared(chain: ClosedChain) -> Array:
    joints = [chain.model.frames[frame].parentJoint for frame in chain.frames[: chain.holding]]
    moved = movers(chain, joints)
    per_arm = moved * moved.sum(axis=1, keepdims=True)
    return np.asarray(per_arm[1:] + per_arm[0])
