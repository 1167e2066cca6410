"""What hands that press come to while the torques of a tick are held and the arms move on.

The torque QP decides on wrenches at a tick's beginning. By its end gravity and inertia are those of
the next pose, and the wrenches h of the hands have become h + d, by little of what the arms weigh,
which can be much of what a light object needs. Cones keep both, twice for what changes d:

    C h <= most,   C (h + 2 d) <= most

d is what became of the last answer: in the dynamics of this instant, with the torques of the tick
before, the least change of its accelerations and wrenches. A motion that goes on makes it again.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from coopqp.base.qp import QP
from coopqp.base.rank import least_squares
from coopqp.base.spec import Array
from coopqp.closed_loop.dynamics import ClosedLoopDynamics, Saddle
from coopqp.model.state import State
from coopqp.torque_law.hand_wrenches import HandWrenches
from coopqp.torque_law.program import Layout

#: Changes that cones keep: that of a tick, and as much again, because no two ticks are the same.
AHEAD = 2.0


class HeldTorques:
    """Of one problem.

    Memory: the "answer", with wrenches in the contacts' axes, zero for none, and "back", with which
    acceleration it closes open loops.

    Args:
        hands: their cones.
        layout: of the QP.
        dynamics: of the chain.
    """

    def __init__(self, hands: HandWrenches, layout: Layout, dynamics: ClosedLoopDynamics) -> None:
        self._hands, self._layout, self._dynamics = hands, layout, dynamics
        self._loops = slice(layout.common - layout.m, layout.common)
        square = layout.common == layout.n + hands.size
        self._saddle = Saddle(layout.n, hands.size) if square else None
        sizes = {"answer": layout.h.stop, "back": layout.m}
        self.memory_sizes: Mapping[str, int] = sizes if hands.pressing else {}

    def foresee(self, state: State, qp: QP) -> None:
        """Keep cones at the end of the tick as well.

        Args:
            state: of this tick.
            qp: with the dynamics of this instant; its cones are written, as are ``hands.most``.
        """
        hands, layout = self._hands, self._layout
        if not hands.pressing:
            return
        answer = state.memory["answer"].copy()
        hands.most[:] = hands.stated
        if answer.any():
            answer[layout.h] = _turned(answer[layout.h], hands.turned.transpose(0, 2, 1))
            A, b = qp.A[: layout.common, : layout.h.stop], qp.b[: layout.common].copy()
            # What is seen of the loops since then is no part of what the arms' motion does.
            b[self._loops] = -self._dynamics.drift - state.memory["back"]
            change = self._least(A, b - A @ answer)
            hands.most -= AHEAD * hands.in_cone * np.maximum(hands.cones @ change, 0.0)
        qp.h[layout.cones] = hands.most

    def _least(self, A: Array, right: Array) -> Array:
        """The wrenches of the least change with that effect; as a rule it is the only one."""
        layout, n, saddle = self._layout, self._layout.n, self._saddle
        if saddle is None:
            return least_squares(np.hstack([A[:, layout.a], A[:, layout.h]]), right)[n:]
        saddle.top[:], saddle.right[:] = A[:n, layout.a], A[:n, layout.h]
        saddle.left[:], saddle.corner[:] = A[n:, layout.a], A[n:, layout.h]
        return np.asarray(saddle.solve(right)[0][n:])

    def remember(self, state: State, qp: QP, x: Array | None) -> None:
        """Take an answer for what is held from now on; None where other torques are."""
        if not self._hands.pressing:
            return
        answer, h = state.memory["answer"], self._layout.h
        answer[:] = 0.0 if x is None else x[: h.stop]
        answer[h] = _turned(answer[h], self._hands.turned)
        state.memory["back"][:] = -self._dynamics.drift - qp.b[self._loops]


def _turned(h: Array, R: Array) -> Array:
    """Wrenches of hands in other axes, shape (6 N,)."""
    return np.asarray(h.reshape(-1, 2, 3) @ R.transpose(0, 2, 1)).ravel()
