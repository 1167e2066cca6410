"""Forces between the hands before anything moves, in words and numbers.

Which internal wrenches motors command (:mod:`coopqp.closed_loop.transmission`), and how hard the
hands can squeeze the object at rest while they carry it (:mod:`coopqp.closed_loop.holding`).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.closed_loop.grasp_matrix import EDGES, FLAT, flatness, section, virtual_linkage
from coopqp.closed_loop.hands import Hand, hands
from coopqp.closed_loop.holding import Bound, StaticHold, cannot_carry
from coopqp.closed_loop.transmission import (
    COMMANDED,
    LET_GO,
    MIXED,
    STRUCTURE,
    Transmission,
    transmission,
)
from coopqp.grasp import SAFETY
from coopqp.model.closed_chain import ClosedChain

#: Classes of components of a section wrench, in the order of the report.
FATES = {
    COMMANDED: "the motors command",
    MIXED: "only together with others they command",
    STRUCTURE: "the structure bears, unseen by any motor,",
    LET_GO: "a passive joint does not transmit",
}


@dataclass(frozen=True)
class Squeeze:
    """Range of the squeeze of two arms at rest; None where the object cannot be carried."""

    arms: tuple[str, str]
    least: Bound | None
    most: Bound | None

    @property
    def words(self) -> str:
        """Such as "42 to 226 N (least by friction of left; most by motor joint6)"."""
        if self.least is None or self.most is None:
            return "none: the object cannot be carried"
        least, most = self.least, self.most
        match bool(np.isfinite(least.value)), bool(np.isfinite(most.value)):
            case True, True:
                ends = f"{least.value:.3g} to {most.value:.3g} N"
                return f"{ends} (least by {least.words}; most by {most.words})"
            case True, False:
                return f"from {least.value:.3g} N (by {least.words}), unlimited above"
            case False, True:
                return f"up to {most.value:.3g} N (by {most.words}), unlimited below"
        return "unlimited"


@dataclass(frozen=True)
class Forces:
    """The report.

    Attributes:
        transmission: which internal wrenches motors command.
        load: the largest multiple of the object's weight that can be held at rest.
        squeezes: by pair; along the edges between three hands; none for more.
        safety: by which friction is divided.
        contacts: names of the arms that hold by pressing.
        why_not: why less than the weight can be held; empty where it can.
    """

    transmission: Transmission
    load: Bound
    squeezes: tuple[Squeeze, ...]
    safety: float
    contacts: tuple[str, ...]
    why_not: str = ""

    def sentences(self) -> Iterator[str]:
        """The report in sentences."""
        found = self.transmission
        yield f"Of {found.dimensions} internal wrenches {found.all.words}."
        for pair in found.pairs if len(found.arms) == 2 else ():
            for fate, words in FATES.items():
                names = [name for name, said in pair.components.items() if said == fate]
                if names and fate != COMMANDED:
                    yield f"{words[0].upper()}{words[1:]} {', '.join(names)}."
        for squeeze in self.squeezes:
            yield f"Squeeze of {' and '.join(squeeze.arms)} at rest: {squeeze.words}."
        if self.contacts:
            yield self._carried()

    def _carried(self) -> str:
        share = self.load.value
        if share < 1.0:
            return f"The hands cannot hold the object at safety {self.safety:g}: {self.why_not}."
        return (
            f"At rest and safety {self.safety:g} they could carry {share:.3g} times its weight; "
            f"then {self.load.words} are at their limits."
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


def squeeze_rows(points: Array) -> dict[tuple[int, int], Array]:
    """Rows, shape (6 N,), from the hands' wrenches to the squeeze of each pair, by pair.

    The section's of two hands, the virtual linkage's of three; none where that does not exist.
    """
    if len(points) == 2:
        return {(0, 1): section(points[0], points[1]).rows[0]}
    if len(points) != 3 or flatness(points) < FLAT:
        return {}
    rows = np.zeros((3, 3, 6))
    rows[:, :, :3] = virtual_linkage(points).reshape(3, 3, 3)
    return dict(zip(EDGES, rows.reshape(3, 18), strict=True))


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
        yield (
            "",
            f"cannot hold the object at rest: {cannot_carry(chain, hold, load)}",
        )


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


#: A contact that is farther from the object's face is worth a word [m].
OFF_FACE = 1e-3


def overhang(hand: Hand, half: Array) -> tuple[float, float]:
    """How far a contact is outside its face, and its pad beyond the face's edges [m].

    ``half`` are half the object's edges, shape (3,) [m].
    """
    assert hand.contact
    R, p = hand.X_OC.rotation, hand.X_OC.translation
    axis = int(np.abs(R[:, 2]).argmax())
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=2))) * hand.contact.half_lengths
    places = p + corners @ R[:, :2].T
    beyond = np.delete(np.abs(places) - half, axis, axis=1)
    outside = -np.sign(R[axis, 2]) * p[axis] - half[axis]
    return float(outside), max(0.0, float(beyond.max()))
