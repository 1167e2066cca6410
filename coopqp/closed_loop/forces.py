"""Forces between the hands before anything moves, in words and numbers.

Which internal wrenches motors command (:mod:`coopqp.closed_loop.transmission`), and how hard the
hands can squeeze the object at rest while they carry it. With h the hands' wrenches at their
points, at rest, and the arms' own weight g(q), linear programs find

    G h = s w                          s = 1 carries the object, w balances its weight
    |g + sum_i J_i' h_i| <= effort     motors; equal to 0 at passive joints
    C_i h_i <= 0                       friction of hands that press, with a safety factor

The largest s says whether the object can be held, and the smallest and largest squeeze with s = 1
how hard. The active rows of a program's optimum name what limits it.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.closed_loop.grasp_matrix import grasp_matrix, squeeze_rows
from coopqp.closed_loop.hands import Hand, hands, into_contacts, points
from coopqp.closed_loop.screw import LENGTH
from coopqp.closed_loop.transmission import COMMANDED, FATES, Transmission, transmission
from coopqp.grasp import SAFETY
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
#: A contact that is farther from the object's face is worth a word [m].
OFF_FACE = 1e-3


@dataclass(frozen=True)
class Bound:
    """An extreme value and its active constraints."""

    value: float
    by: tuple[str, ...]  # active constraints, such as "motor joint6" or "friction of left"
    h: Array  # the wrenches with which it is reached, shape (N, 6) [N, N m]

    @property
    def active(self) -> str:
        """The active constraints in words, such as "motor a and friction of b"."""
        *before, last = self.by or ("nothing",)
        return f"{', '.join(before)} and {last}" if before else last

    @property
    def holds(self) -> str:
        """These with their verb, such as "motor a and friction of b hold it"."""
        return f"{self.active} {'hold' if len(self.by) > 1 else 'holds'} it"


class StaticHold:
    """The linear programs of one pose: q with closed loops, the start if omitted.

    Friction is divided by ``safety``. ``hands`` are those that hold, ``points`` their contact
    points, shape (N, 3) [m], ``weight`` is the wrench at the object's origin that carries it, shape
    (6,).
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
        self._rows: list[tuple[str, Array, float]] = []  # name, row and upper bound
        self._add_joints(chain, at)
        self._add_contacts(X_WO.rotation, safety)
        # Torques as forces at LENGTH, so that one tolerance serves all variables.
        self._scale = np.tile(np.repeat([1.0, LENGTH], 3), len(self.hands))

    def _add_joints(self, chain: ClosedChain, q: Array) -> None:
        model, N = chain.model, len(self.hands)
        own = np.asarray(pin.computeGeneralizedGravity(model, model.createData(), q), float)
        J = chain.object_jacobians(q)[:N]
        at_origin = [self._G[:, 6 * i : 6 * i + 6] for i in range(N)]
        torque = np.hstack([J_i.T @ G_i for J_i, G_i in zip(J, at_origin, strict=True)])
        self._passive = torque[chain.passive], -own[chain.passive]
        effort = model.effortLimit
        for i, name in enumerate(chain.joint_names):
            if i not in chain.passive and np.isfinite(effort[i]):
                self._rows.append((f"motor {name}", torque[i], effort[i] - own[i]))
                self._rows.append((f"motor {name}", -torque[i], effort[i] + own[i]))

    def _add_contacts(self, R_WO: Array, safety: float) -> None:
        turned = into_contacts(self.hands, R_WO)
        for i, (hand, R) in enumerate(zip(self.hands, turned, strict=True)):
            if not hand.contact:
                continue
            into = np.zeros((6, 6 * len(self.hands)))
            into[:, 6 * i : 6 * i + 6] = np.kron(np.eye(2), R)
            kept = hand.contact.force_rows(safety)
            for row, upper, label in zip(kept.rows, kept.upper, kept.labels, strict=True):
                what = WORDS[label.partition("[")[0]]
                self._rows.append((f"{what} of {hand.arm}", row @ into, float(upper)))

    def load(self) -> Bound:
        """The largest share s of the object's weight that can be carried; below 1 it falls."""
        found = self._load()
        if found is None:
            return Bound(0.0, (OWN_WEIGHT,), np.zeros((len(self.hands), 6)))
        return replace(found, value=max(0.0, found.value))

    def infeasible(self) -> str:
        """What is infeasible even without the object's weight; empty where nothing is."""
        for kind, rows, why in IN_VAIN:
            names = dict.fromkeys(name for name, *_ in self._rows if name.startswith(kind))
            if names and self._load(without=rows):
                return f"the {' and '.join(names)} is {why}"
        return ""

    def _load(self, without: tuple[str, ...] = ()) -> Bound | None:
        cost = np.append(np.zeros(self._G.shape[1]), -1.0)
        return self._solve(cost, (0.0, MAX_LOAD), without=without)

    def extreme(
        self, row: Array, sign: float, equal: tuple[Array, Array] | None = None
    ) -> Bound | None:
        """Largest (sign 1) or smallest (sign -1) row @ h with the object carried.

        ``row``, shape (6 N,), acts on the wrenches at the hands' points in world axes; ``equal``
        are further rows, shape (r, 6 N), and their values, shape (r,). None where the object cannot
        be carried so.
        """
        found = self._solve(np.append(-sign * row, 0.0), (1.0, 1.0), equal)
        return replace(found, value=sign * found.value) if found else None

    def _solve(
        self,
        cost: Array,
        share: tuple[float, float],
        equal: tuple[Array, Array] | None = None,
        without: tuple[str, ...] = (),
    ) -> Bound | None:
        """The least cost of h and s, the share of the weight that is carried, within its ends."""
        from scipy.optimize import linprog  # which takes a quarter of a second to come

        size, scale = self._G.shape[1], np.append(self._scale, 1.0)
        more, values = equal or (np.zeros((0, size)), np.zeros(0))
        A = np.pad(np.vstack([self._G, self._passive[0], more]), ((0, 0), (0, 1)))
        A[:6, -1] = -self.weight
        b = np.concatenate([np.zeros(6), self._passive[1], values])
        kept = [row for row in self._rows if not row[0].startswith(without)]
        G = np.pad(np.reshape([row for _, row, _ in kept], (-1, size)), ((0, 0), (0, 1)))
        upper = [upper for *_, upper in kept]
        found = linprog(
            cost * scale, A_ub=G * scale, b_ub=upper, A_eq=A * scale, b_eq=b,
            bounds=[(None, None)] * size + [share], method="highs",
        )  # fmt: skip
        if found.status == 3:  # unbounded: nothing holds it back
            return Bound(np.inf, (), np.full((len(self.hands), 6), np.nan))
        if found.status != 0:
            return None
        pull = np.abs(found.ineqlin.marginals)
        active = pull > IDLE * max(pull.max(initial=0.0), 1e-12)
        by = tuple(dict.fromkeys(row[0] for row, on in zip(kept, active, strict=True) if on))
        h = (found.x * scale)[:size].reshape(-1, 6)
        return Bound(-float(found.fun), by, h)


def cannot_carry(chain: ClosedChain, hold: StaticHold, load: Bound) -> str:
    """Why the hands do not carry the object at the chain's start, given ``hold.load()`` below 1."""
    if tilted := _tilted(chain, hold):
        return tilted
    if not load.by:
        return _nothing(chain, hold)
    if load.by == (OWN_WEIGHT,) and (vain := hold.infeasible()):
        return vain
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
    return hand.contact is not None and not any(hand.contact.half_lengths)


@dataclass(frozen=True)
class Squeeze:
    """Range of the squeeze of two arms at rest; None where the object cannot be carried."""

    arms: tuple[str, str]
    lower: Bound | None
    upper: Bound | None

    @property
    def summary(self) -> str:
        """Such as "42 to 226 N (least by friction of left; most by motor joint6)"."""
        lower, upper = self.lower, self.upper
        if lower is None or upper is None:
            return "none: the object cannot be carried"
        match bool(np.isfinite(lower.value)), bool(np.isfinite(upper.value)):
            case True, True:
                ends = f"{lower.value:.3g} to {upper.value:.3g} N"
                if sorted(lower.by) == sorted(upper.by):
                    return f"{ends} (both by {lower.active})"
                return f"{ends} (least by {lower.active}; most by {upper.active})"
            case True, False:
                return f"from {lower.value:.3g} N (by {lower.active}), unlimited above"
            case False, True:
                return f"up to {upper.value:.3g} N (by {upper.active}), unlimited below"
        return "unlimited"


@dataclass(frozen=True)
class Forces:
    """The report."""

    transmission: Transmission  # which internal wrenches motors command
    load: Bound  # the largest multiple of the object's weight that can be held at rest
    squeezes: tuple[Squeeze, ...]  # by pair; along the edges between three hands; none for more
    safety: float  # by which friction is divided
    contacts: tuple[str, ...]  # names of the arms that hold by pressing
    why_not: str = ""  # why less than the weight can be held; empty where it can

    def sentences(self) -> Iterator[str]:
        found = self.transmission
        yield f"Of {found.dimensions} internal wrenches {found.all.summary}."
        for pair in found.pairs if len(found.arms) == 2 else ():
            for fate, words in FATES.items():
                names = [name for name, own in pair.components.items() if own == fate]
                if names and fate != COMMANDED:
                    yield f"{words[0].upper()}{words[1:]} {', '.join(names)}."
        for squeeze in self.squeezes:
            yield f"Squeeze of {' and '.join(squeeze.arms)} at rest: {squeeze.summary}."
        if self.contacts and self.load.value < 1.0:
            yield f"The hands cannot hold the object at safety {self.safety:g}: {self.why_not}."
        elif self.contacts:
            yield (
                f"At rest and safety {self.safety:g} they could carry {self.load.value:.3g} times "
                f"its weight; then {self.load.active} are at their limits."
            )


def forces(chain: ClosedChain, *, safety: float = SAFETY) -> Forces:
    """Analyse a chain of at least two arms at its start, with friction divided by ``safety``."""
    hold = StaticHold(chain, safety=safety)
    names = tuple(hand.arm for hand in hold.hands)
    squeezes = [
        Squeeze((names[i], names[j]), hold.extreme(row, -1.0), hold.extreme(row, 1.0))
        for (i, j), row in squeeze_rows(hold.points).items()
    ]
    pressing = tuple(hand.arm for hand in hold.hands if hand.contact)
    found = transmission(chain, chain.q_start)
    load = hold.load()
    why_not = cannot_carry(chain, hold, load) if load.value < 1.0 else ""
    return Forces(found, load, tuple(squeezes), safety, pressing, why_not)


def squeezes(points: Array, wrenches: Array) -> list[float]:
    """How hard each pair of two or three hands presses the object; empty for other counts [N].

    ``points`` of the robot's hands, shape (N, 3) [m], are zero where a hand does not hold;
    ``wrenches``, shape (N, 6), are each at its point in world axes.
    """
    held = (points != 0.0).any(axis=1)
    if held.sum() not in (2, 3):
        return []
    try:
        rows = squeeze_rows(points[held])
    except CoopqpError:  # hands in one place have no direction between them
        return []
    return [float(row @ wrenches[held].ravel()) for row in rows.values()]


def contact_faults(chain: ClosedChain) -> Iterator[tuple[str, str]]:
    """Hands that cannot hold by pressing: the arm, empty for all, and what is wrong."""
    pressing = [hand for hand in hands(chain) if hand.contact]
    away = [hand for hand in pressing if hand.X_OC.rotation[:, 2] @ hand.X_OC.translation >= 0.0]
    for hand in away:
        yield hand.arm, "the contact's normal points away from the object; turn it round"
    if away or not pressing:
        return
    if chain.holding == 1:
        yield pressing[0].arm, "one hand alone holds nothing by pressing; use another grasp"
        return
    hold = StaticHold(chain)
    load = hold.load()
    if load.value < 1.0:
        yield ("", f"cannot hold the object at rest: {cannot_carry(chain, hold, load)}")


def contact_notes(chain: ClosedChain) -> Iterator[str]:
    """Pads that are larger than the face that they press on, or not on it."""
    half = 0.5 * np.array(chain.held.size)
    for hand in hands(chain):
        if not hand.contact:
            continue
        face, beyond = overhang(hand, half)
        if beyond > 1e-6:
            yield (
                f"the pad of {hand.arm} reaches {1e3 * beyond:.1f} mm beyond the face of the "
                "object that it presses on, where nothing bears; its cone counts on all of it"
            )
        if abs(face) > OFF_FACE:
            yield (
                f"the contact of {hand.arm} is {1e3 * abs(face):.1f} mm "
                f"{'outside' if face > 0.0 else 'inside'} the object's face"
            )


def overhang(hand: Hand, half_size: Array) -> tuple[float, float]:
    """How far a contact is outside its object's face, and its pad beyond the face's edges [m]."""
    assert hand.contact
    R, p = hand.X_OC.rotation, hand.X_OC.translation
    axis = int(np.abs(R[:, 2]).argmax())
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=2))) * hand.contact.half_lengths
    places = p + corners @ R[:, :2].T
    beyond = np.delete(np.abs(places) - half_size, axis, axis=1)
    outside = -np.sign(R[axis, 2]) * p[axis] - half_size[axis]
    return float(outside), max(0.0, float(beyond.max()))
