"""Wrenches that hands can apply to an object at rest: linear programs, and why they fail in words.

With h the hands' wrenches at their points, at rest, and the arms' own weight g(q),

    G h = s w                          s = 1 carries the object, w balances its weight
    |g + sum_i J_i' h_i| <= effort     motors; equal to 0 at passive joints
    C_i h_i <= 0                       friction of hands that press, with a safety factor

The largest s says whether the object can be held, and the smallest and largest squeeze with s = 1
how hard. The active rows of a program's optimum name what limits it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array
from coopqp.closed_loop.grasp_matrix import grasp_matrix
from coopqp.closed_loop.hands import Hand, hands, into_contacts, points
from coopqp.closed_loop.screw import LENGTH
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State

#: Multipliers below this share of the largest do not hold a program back.
IDLE = 1e-6
#: Loads are computed up to this many times the object's weight.
MAX_LOAD = 100.0
#: What rows of a contact are called.
WORDS = {
    "friction": "friction", "edge": "pad's edge", "least": "least force", "most": "most force",
}  # fmt: skip


#: What may be asked for in vain, the kinds of rows that ask for it, and what it is then.
#: A pad's edge is kept by what is above the least force.
IN_VAIN = (
    ("least", ("least", "pad"), "more than the motors bear"),
    ("most", ("most",), "less than holds it"),
)
#: A mass that is nearer than this to the line between two fingertips is on it [m].
ON_LINE = 1e-9
#: What stands where nothing at all can be carried.
OWN_WEIGHT = "the arms' own weight"


@dataclass(frozen=True)
class Bound:
    """An extreme value and its active constraints.

    Attributes:
        value: the extreme value.
        by: active constraints, such as "motor joint6" or "friction of left".
        h: the wrenches with which it is reached, shape (N, 6) [N, N m].
    """

    value: float
    by: tuple[str, ...]
    h: Array

    @property
    def words(self) -> str:
        """The active constraints in words, such as "motor a and friction of b"."""
        *before, last = self.by or ("nothing",)
        return f"{', '.join(before)} and {last}" if before else last

    @property
    def holds(self) -> str:
        """These with their verb, such as "motor a and friction of b hold it"."""
        return f"{self.words} {'hold' if len(self.by) > 1 else 'holds'} it"


class StaticHold:
    """The linear programs of one pose: q with closed loops, the start if omitted.

    Friction is divided by ``safety``.

    Attributes:
        hands: those that hold.
        points: their contact points, shape (N, 3) [m].
        weight: wrench at the object's origin that carries it, shape (6,).
    """

    def __init__(self, chain: ClosedChain, q: Array | None = None, *, safety: float = 1.0) -> None:
        at = chain.q_start if q is None else q
        self.hands: tuple[Hand, ...] = hands(chain)
        X_WO = chain.object_pose(at)
        self._origin = X_WO.translation.copy()
        self.points = points(self.hands, X_WO.translation, X_WO.rotation)
        body = chain.held.body()
        force = -body.mass * chain.model.gravity.linear
        self.weight = np.concatenate([force, np.cross(X_WO.rotation @ body.lever, force)])
        self._G = grasp_matrix(self.points, self._origin)
        self._names: list[str] = []
        self._rows: list[Array] = []
        self._most: list[float] = []
        self._add_joints(chain, at)
        self._add_contacts(X_WO.rotation, safety)
        # Torques as forces at LENGTH, so that one tolerance serves all variables.
        self._scale = np.tile(np.repeat([1.0, LENGTH], 3), len(self.hands))

    def _add_joints(self, chain: ClosedChain, q: Array) -> None:
        model, N = chain.model, len(self.hands)
        own = np.asarray(pin.computeGeneralizedGravity(model, model.createData(), q), float)
        J = chain.object_jacobians(q)[:N]
        at_origin = [self._G[:, 6 * i : 6 * i + 6] for i in range(N)]
        felt = np.hstack([J_i.T @ G_i for J_i, G_i in zip(J, at_origin, strict=True)])
        self._passive = felt[chain.passive], -own[chain.passive]
        effort = model.effortLimit
        for i, name in enumerate(chain.joint_names):
            if i not in chain.passive and np.isfinite(effort[i]):
                self._bound(f"motor {name}", felt[i], effort[i] - own[i])
                self._bound(f"motor {name}", -felt[i], effort[i] + own[i])

    def _add_contacts(self, R_WO: Array, safety: float) -> None:
        turned = into_contacts(self.hands, R_WO)
        for i, (hand, R) in enumerate(zip(self.hands, turned, strict=True)):
            if not hand.contact:
                continue
            into = np.zeros((6, 6 * len(self.hands)))
            into[:, 6 * i : 6 * i + 6] = np.kron(np.eye(2), R)
            kept = hand.contact.force_rows(safety)
            for row, most, label in zip(kept.rows, kept.most, kept.labels, strict=True):
                what = WORDS[label.partition("[")[0]]
                self._bound(f"{what} of {hand.arm}", row @ into, float(most))

    def _bound(self, name: str, row: Array, most: float) -> None:
        self._names.append(name)
        self._rows.append(row)
        self._most.append(most)

    def load(self) -> Bound:
        """The largest share s of the object's weight that can be carried; below 1 it falls."""
        found = self._load()
        if found is None:
            return Bound(0.0, (OWN_WEIGHT,), np.zeros((len(self.hands), 6)))
        return replace(found, value=max(0.0, found.value))

    def in_the_way(self) -> str:
        """What is infeasible even without the object's weight; empty where nothing is."""
        for kind, rows, why in IN_VAIN:
            names = dict.fromkeys(name for name in self._names if name.startswith(kind))
            if names and self._load(without=rows):
                return f"the {' and '.join(names)} is {why}"
        return ""

    def _load(self, without: tuple[str, ...] = ()) -> Bound | None:
        size = self._G.shape[1]
        G = np.hstack([self._G, -self.weight[:, None]])
        passive = np.hstack([self._passive[0], np.zeros((len(self._passive[1]), 1))])
        return self._solve(
            np.append(np.zeros(size), -1.0),
            np.vstack([G, passive]),
            np.concatenate([np.zeros(6), self._passive[1]]),
            [(0.0, MAX_LOAD)],
            without,
        )

    def extreme(
        self, row: Array, sign: float, equal: tuple[Array, Array] | None = None
    ) -> Bound | None:
        """Largest (sign 1) or smallest (sign -1) row @ h with the object carried.

        ``row``, shape (6 N,), acts on the wrenches at the hands' points in world axes; ``equal``
        are further rows, shape (r, 6 N), and their values, shape (r,). None where the object cannot
        be carried so.
        """
        rows, values = equal or (np.zeros((0, len(row))), np.zeros(0))
        found = self._solve(
            -sign * row,
            np.vstack([self._G, self._passive[0], rows]),
            np.concatenate([self.weight, self._passive[1], values]),
            [],
        )
        return Bound(sign * found.value, found.by, found.h) if found else None

    def _solve(
        self,
        cost: Array,
        A: Array,
        b: Array,
        more: Sequence[tuple[float, float]],
        without: tuple[str, ...] = (),
    ) -> Bound | None:
        from scipy.optimize import linprog  # which takes a quarter of a second to come

        size = self._G.shape[1]
        extra = len(cost) - size
        scale = np.append(self._scale, np.ones(extra))
        kept = [i for i, n in enumerate(self._names) if not n.startswith(without)]
        names, most = [self._names[i] for i in kept], [self._most[i] for i in kept]
        rows = np.array([self._rows[i] for i in kept]).reshape(-1, size)
        G = np.hstack([rows, np.zeros((len(rows), extra))])
        found = linprog(
            cost * scale, A_ub=G * scale, b_ub=most, A_eq=A * scale, b_eq=b,
            bounds=[(None, None)] * size + list(more), method="highs",
        )  # fmt: skip
        if found.status == 3:  # unbounded: nothing holds it back
            return Bound(np.inf, (), np.full((len(self.hands), 6), np.nan))
        if found.status != 0:
            return None
        pull = np.abs(found.ineqlin.marginals)
        felt = pull > IDLE * max(pull.max(initial=0.0), 1e-12)
        by = tuple(dict.fromkeys(n for n, on in zip(names, felt, strict=True) if on))
        h = (found.x * scale)[:size].reshape(-1, 6)
        return Bound(-float(found.fun), by, h)


def cannot_carry(chain: ClosedChain, hold: StaticHold, load: Bound) -> str:
    """Why the hands do not carry the object at the chain's start, given ``hold.load()`` below 1."""
    if tilted := _tilted(chain, hold):
        return tilted
    if not load.by:
        return _nothing(chain, hold)
    if load.by == (OWN_WEIGHT,) and (unheard := hold.in_the_way()):
        return unheard
    return (
        f"the hands carry {100.0 * load.value:.0f} % of its weight; {load.holds} back; make the "
        "object lighter, friction or pads larger, the motors stronger, or press from other sides"
    )


def _tilted(chain: ClosedChain, hold: StaticHold) -> str:
    """For two hands: which fingertip's friction cone does not contain the line between them."""
    if len(hold.hands) != 2:
        return ""
    e = hold.points[1] - hold.points[0]
    e /= np.linalg.norm(e)
    R_WO = State(chain).R_WO
    for hand, way in zip(hold.hands, (e, -e), strict=True):
        if not _is_tip(hand):
            continue
        assert hand.contact
        off = np.degrees(np.arccos(np.clip((R_WO @ hand.X_OC.rotation)[:, 2] @ way, -1.0, 1.0)))
        allowed = np.degrees(np.arctan(hand.contact.friction))
        if off > allowed:
            return (
                f"the fingertip of {hand.arm} points {off:.0f} degrees away from the other hand, "
                f"and friction of {hand.contact.friction:g} allows {allowed:.0f}; give another "
                "start: 'start: solve' leaves open how a fingertip is turned"
            )
    return ""


def _nothing(chain: ClosedChain, hold: StaticHold) -> str:
    """The reason where neither motors nor contacts are at their limits."""
    if len(hold.hands) == 2 and all(_is_tip(hand) for hand in hold.hands):
        a, b = hold.points
        mass = chain.object_pose(chain.q_start).act(np.array(chain.held.body().lever))
        off = float(np.linalg.norm(np.cross(b - a, mass - a)) / np.linalg.norm(b - a))
        beside = f", {1e3 * off:.2g} mm beside its mass" if off > ON_LINE else ""
        return (
            f"nothing holds a turn about the line between the two fingertips{beside}; give one "
            "hand a pad"
        )
    return "hinges and fingertips let go what would carry it; use a pad or a firm grasp"


def _is_tip(hand: Hand) -> bool:
    """Whether it presses at a point."""
    return hand.contact is not None and not any(hand.contact.half_lengths)
