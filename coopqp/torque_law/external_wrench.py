"""The wrench of the surroundings on the object: observed from joint torques, or measured.

:class:`MomentumObserver` needs joints and torques alone. The generalised momentum p = A v of the
tree changes by motors, gravity, loops and surroundings (De Luca and Mattone 2005):

    p_dot = S' tau + C' v - g + J_c' lambda + J_o' w
    r = K (p - p_0 - integral of (S' tau + C' v - g + r) dt)

so r follows J_c' lambda + J_o' w with the time constant 1/K. With N a basis of the null space of
J_c the loops drop out, N' r = N' J_o' w, solved for w in least squares; what the structure bears
is zero in w. As N moves, a change of J_c' lambda within 1/K would show as a push, so the modelled
lambda of tau and the last w is subtracted before the integration. The estimate is as good as the
model: an object that is lighter than modelled by a fifth of 10 N shows as 2 N.

:class:`HandSensors` uses force sensors in the hands, which measure h: w = M a_o + b - G h, with a_o
from the difference of the object's velocity over a tick, after a first-order low-pass filter. Only
the object's mass has to be known, not the arms'.
"""

import math

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError
from coopqp.base.rank import least_squares
from coopqp.base.spec import Array
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.closed_loop.grasp_matrix import grasp_matrix
from coopqp.closed_loop.hands import WrenchReadings, hands, points
from coopqp.model.state import State


class MomentumObserver:
    """Estimates the external wrench on one chain from torques; its state is in the law's memory.

    ``dynamics``, with the modelled object, must be up to date at each update. InvalidValueError for
    a gain K [1/s] above 1/dt, where it would overshoot.

    Attributes:
        wrench: force and torque on the object at its origin, world axes, as of the last update,
            shape (6,) [N, N m].
        memory_sizes: what to remember; whoever commands torques writes "observer.tau".
        fault: why a measurement cannot be used: none is needed.
    """

    def __init__(
        self, dynamics: ClosedLoopDynamics, *, gain: float = 50.0, dt: float = 0.001
    ) -> None:
        if not 0.0 < gain * dt <= 1.0:
            raise InvalidValueError(
                f"gain: found {gain:g} 1/s, needs more than 0 and at most 1/dt = {1.0 / dt:g} 1/s"
            )
        self._dynamics, self._gain, self._dt = dynamics, gain, dt
        self._model, self._data = dynamics.model, dynamics.model.createData()
        n = dynamics.chain.n
        self.wrench, self.fault = np.zeros(6), ""
        self.memory_sizes = {
            "observer.begun": 1, "observer.integral": n, "observer.known": n,
            "observer.residual": n, "observer.tau": n, "observer.wrench": 6,
        }  # fmt: skip

    def update(self, state: State) -> Array:
        """The wrench at the end of a period with joint torques "observer.tau"; zero at first."""
        dt, dynamics, memory = self._dt, self._dynamics, state.memory
        now, momentum = self._forces(state.q, state.v), dynamics.A.dot(state.v)
        integral, known = memory["observer.integral"], memory["observer.known"]
        r = memory["observer.residual"]
        if memory["observer.begun"][0]:
            tau, felt = memory["observer.tau"], dynamics.J_object.T.dot(memory["observer.wrench"])
            of_loops = dynamics.direct(tau + felt).wrench[dynamics.kept].dot(dynamics.J)
            integral += dt * (tau + of_loops + 0.5 * (known + now) + r)
        else:
            integral[:], memory["observer.begun"][0] = momentum, 1.0
        known[:] = now
        r[:] = self._gain * (momentum - integral)
        N = dynamics.null_space()
        self.wrench[:] = least_squares(N.T @ dynamics.J_object.T, N.T @ r)
        memory["observer.wrench"][:] = self.wrench
        return self.wrench

    def _forces(self, q: Array, v: Array) -> Array:
        """C' v - g."""
        C = pin.computeCoriolisMatrix(self._model, self._data, q, v)
        g = pin.computeGeneralizedGravity(self._model, self._data, q)
        return np.asarray(C.T @ v - g, float)


class HandSensors:
    """Measures the external wrench on one chain by the hands; its state is in the law's memory.

    ``dynamics``, with the modelled object, must be up to date at each update. ``gain`` is the
    inverse of the filter's time constant [1/s].

    Attributes:
        wrench: as of :class:`MomentumObserver`.
        memory_sizes: what to remember.
    """

    def __init__(self, dynamics: ClosedLoopDynamics, *, gain: float, dt: float) -> None:
        chain = dynamics.chain
        self._dynamics, self._dt, self._share = dynamics, dt, 1.0 - math.exp(-gain * dt)
        self._hands, self._readings = hands(chain), WrenchReadings(chain)
        self.wrench = np.zeros(6)
        self.memory_sizes = {"sensors.begun": 1, "sensors.twist": 6, "sensors.wrench": 6}

    @property
    def fault(self) -> str:
        """Why the last measurement cannot be used; empty if it can."""
        return self._readings.fault

    def update(self, state: State) -> Array:
        """The wrench at the end of a period; zero at first, the last where nothing is measured."""
        dynamics, twist = self._dynamics, self._dynamics.J_object.dot(state.v)
        memory = state.memory
        kept = memory["sensors.wrench"]
        found = self._readings.read(state.hand_wrench)
        if memory["sensors.begun"][0] and found is not None:
            M, b = dynamics.object_inertia()
            G = grasp_matrix(points(self._hands, state.p_WO, state.R_WO), state.p_WO)
            a = (twist - memory["sensors.twist"]) / self._dt
            kept += self._share * (M.dot(a) + b - G.dot(found.ravel()) - kept)
        memory["sensors.begun"][0], memory["sensors.twist"][:] = 1.0, twist
        self.wrench[:] = kept
        return self.wrench
