"""The model's own loop error (bias), observed slowly and never corrected.

Lengths, encoders and grasps are a little off. So where the real loops are closed the model's are
open by some b, a loop-closure offset that changes slowly. With e_c = e(q) at the commanded
configuration, e_m at the measured one, and compliance between them, the internal force is
proportional to e_c - e_m: it vanishes where the *command* carries the model's error. Hence

    J_c v = -kappa (e_c - gap),     gap' = (e_m - e_c) / time

Correcting e_m, or all of e_c, to zero would integrate b without end, until the motors saturate. The
observer is stable for every delay while the compliance of the grasp is part of the whole (small
gain); ``time`` exceeds the 0.1 s of the resonances of servos and grasps, and no more, since the
internal force of a motion grows with it.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from coopqp.base.spec import Array, real
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.signal import ENDLESS

#: Time constant, at least so long and at least so many ticks [s].
TIME, TICKS = 0.15, 10
#: A gap beyond this is no model's error any more [m], [rad]. Encoders that are 5 mrad off put the
#: hands of three UR arms 11 mm and 22 mrad apart; what is cut off here is pulled at.
MOST_POSITION, MOST_ORIENTATION = 30e-3, 100e-3


class LoopObserver:
    """Estimates ``State.gap``."""

    def __init__(self, chain: ClosedChain, dt: float) -> None:
        self._chain, self._share = chain, dt / max(TIME, TICKS * dt)

    @cached_property
    def _measured(self) -> State:
        """Where the sensors say that the joints are; most laws never ask."""
        return State(self._chain)

    def begin(self, state: State) -> None:
        """Take the whole loop error at q for the model's, so that arms do not press at first."""
        self._measured.q[:] = state.q  # made now, not in a tick
        state.update()
        state.gap[:] = state.loop_error
        _bound(state.gap)
        state.update()

    def update(self, state: State, along: Array | None = None) -> bool:
        """Follow the measured q, but along the unit vector ``along``; False where not finite."""
        if state.q_measured is None:
            return True
        measured = self._measured
        try:
            found = real(state.q_measured)
        except ValueError:
            return False
        if found.shape != measured.q.shape or not math.hypot(*found.tolist()) < ENDLESS:
            return False  # a sensor that says nothing teaches nothing
        if state.corrected < 1.0:
            return True
        measured.q[:] = found
        measured.update_poses()
        learnt = self._share * (measured.loop_error - state.loop_error)
        if along is None:
            state.gap += learnt
            _bound(state.gap)
        else:
            pressed = along.dot(state.gap) * along
            state.gap += learnt - along.dot(learnt) * along - pressed
            _bound(state.gap)
            state.gap += pressed
        state.update_drift()
        return True


def _bound(gap: Array) -> None:
    """Cut each loop's position and rotation to the largest error that a model can have."""
    for loop in gap.reshape(-1, 6):
        for part, most in ((loop[:3], MOST_POSITION), (loop[3:], MOST_ORIENTATION)):
            size = float(np.linalg.norm(part))
            if size > most:
                part *= most / size
