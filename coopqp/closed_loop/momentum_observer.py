"""The wrench of the surroundings on the object, from joints and torques alone.

The generalised momentum p = A v of the tree changes by what motors, gravity, loops and surroundings
do (De Luca and Mattone 2005):

    p_dot = S' tau + C' v - g + J_c' lambda + J_o' w
    r = K (p - p_0 - integral of (S' tau + C' v - g + r) dt)

so that r follows J_c' lambda + J_o' w with the time constant 1/K. With N a basis of the null space
of J_c the loops drop out, N' r = N' J_o' w, and w follows in least squares. Where the object has
fewer than six motions the rest of w is the structure's and is told as zero.

What it tells is as good as the model: an object that is lighter by a fifth of 10 N shows as 2 N.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.errors import InvalidValueError
from coopqp.rank import least_squares


class MomentumObserver:
    """Follows a chain from a state on.

    Args:
        chain: arms and modelled object.
        q: configuration at the beginning, shape (n,).
        v: velocity there, shape (n,).
        gain: K [1/s].
        dt: time between updates [s]; at most 1/K.

    Attributes:
        wrench: force and torque on the object at its origin, world axes, as of the last
            update, shape (6,) [N, N m].

    Raises:
        InvalidValueError: gain times dt is above one, where it would overshoot.
    """

    def __init__(
        self, chain: ClosedChain, q: Array, v: Array, *, gain: float = 50.0, dt: float = 0.001
    ) -> None:
        if not 0.0 < gain * dt <= 1.0:
            raise InvalidValueError(
                f"gain: found {gain:g} 1/s, needs more than 0 and at most 1/dt = {1.0 / dt:g} 1/s"
            )
        self._dynamics = ClosedLoopDynamics(chain)
        self._model, self._data = self._dynamics.model, self._dynamics.model.createData()
        self._gain, self._dt = gain, dt
        self.wrench = np.zeros(6)
        self._r = np.zeros(chain.n)
        self._known = self._forces(q, v)
        self._integral = self._momentum(q, v)

    def update(self, q: Array, v: Array, tau: Array) -> Array:
        """The wrench after a period in which the motors' torques were constant.

        Args:
            q: configuration at its end, shape (n,).
            v: velocity at its end, shape (n,).
            tau: torques of all joints during it, shape (n,) [N m].

        Returns:
            ``wrench``.
        """
        dt, known = self._dt, self._forces(q, v)
        self._integral += dt * (tau + 0.5 * (self._known + known) + self._r)
        self._known = known
        self._r = self._gain * (self._momentum(q, v) - self._integral)
        self._dynamics.update(q, v)
        N = self._dynamics.null_space()
        self.wrench[:] = least_squares(N.T @ self._dynamics.J_object.T, N.T @ self._r)
        return self.wrench

    def _momentum(self, q: Array, v: Array) -> Array:
        return np.asarray(pin.crba(self._model, self._data, q) @ v, float)

    def _forces(self, q: Array, v: Array) -> Array:
        """C' v - g."""
        C = pin.computeCoriolisMatrix(self._model, self._data, q, v)
        g = pin.computeGeneralizedGravity(self._model, self._data, q)
        return np.asarray(C.T @ v - g, float)
