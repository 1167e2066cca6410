"""Cones at a tick's end: wrenches change while the torques of a tick are held and the arms move on.

The torque QP decides wrenches h at a tick's beginning. By its end gravity and inertia are those of
the next pose, and h has become h + d: little compared with the arms' weight, but possibly much for
a light object. Cones hold for both, with twice the change:

    C h <= most,   C (h + 2 d) <= most

d is observed on the last answer: in the dynamics of this instant, with the torques of the tick
before, the least change of its accelerations and wrenches. A steady motion repeats it.
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
    """Predicts the change of wrenches for the cones of one problem.

    Memory: the "answer", with wrenches in contact axes, zero for none, and "back", the acceleration
    by which it closes open loops.
    """

    def __init__(self, hands: HandWrenches, layout: Layout, dynamics: ClosedLoopDynamics) -> None:
        self._hands, self._layout, self._dynamics = hands, layout, dynamics
        self._loops = slice(layout.common - layout.m, layout.common)
        square = layout.common == layout.n + hands.size
        self._saddle = Saddle(layout.n, hands.size) if square else None
        sizes = {"answer": layout.h.stop, "back": layout.m}
        self.memory_sizes: Mapping[str, int] = sizes if hands.pressing else {}

    def foresee(self, state: State, qp: QP) -> None:
        """Tighten ``hands.most`` and the QP's cones, whose dynamics are those of this instant."""
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
        """The wrenches of the smallest change with that effect; normally it is unique."""
        layout, n, saddle = self._layout, self._layout.n, self._saddle
        if saddle is None:
            return least_squares(np.hstack([A[:, layout.a], A[:, layout.h]]), right)[n:]
        saddle.top[:], saddle.right[:] = A[:n, layout.a], A[:n, layout.h]
        saddle.left[:], saddle.corner[:] = A[n:, layout.a], A[n:, layout.h]
        return np.asarray(saddle.solve(right)[0][n:])

    def remember(self, state: State, qp: QP, x: Array | None) -> None:
        """Keep an answer for the next tick; None where other torques are commanded."""
        if not self._hands.pressing:
            return
        answer, h = state.memory["answer"], self._layout.h
        answer[:] = 0.0 if x is None else x[: h.stop]
        answer[h] = _turned(answer[h], self._hands.turned)
        state.memory["back"][:] = -self._dynamics.drift - qp.b[self._loops]


def _turned(h: Array, R: Array) -> Array:
    """Wrenches of hands in other axes, shape (6 N,)."""
    return np.asarray(h.reshape(-1, 2, 3) @ R.transpose(0, 2, 1)).ravel()
