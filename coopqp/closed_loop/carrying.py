"""Why hands that press cannot carry an object at rest, in words."""

from __future__ import annotations

import numpy as np

from coopqp.closed_loop.hands import Hand
from coopqp.closed_loop.holding import OWN_WEIGHT, Bound, StaticHold
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State

#: A mass that is nearer than this to the line between two fingertips is on it [m].
ON_LINE = 1e-9


def cannot_carry(chain: ClosedChain, hold: StaticHold, load: Bound) -> str:
    """Why the hands do not carry the object.

    Args:
        chain: at whose start that is.
        hold: its programs.
        load: what they carry, less than the weight.
    """
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
    """Of two fingertips or a fingertip and a pad: one whose cone the line between does not meet."""
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
    """Where neither motors nor contacts are at their limits."""
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
