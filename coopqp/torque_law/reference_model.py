"""The motion that each row of the tasks should make, and how far it is from that.

With g the gain of a row's task, a critically damped model of its error e,

    e_m_ddot = -2 g e_m_dot - g^2 e_m,   deviation = e - e_m

An integral of e must come back to zero after a step of the reference, so that e overshoots; an
integral of the deviation sees none of the step, and all of what a heavier object or a push does.

The model has to take over each step of the reference, whenever it comes. So the deviation is what
is kept, by the rates, in which a step does not show (e_dot = J v - rate), and e_m = e - deviation:

    deviation += dt (e_dot - e_m_dot),   e_m_dot += dt e_m_ddot

A step of the reference's *rate*, as ``constant_velocity`` has, counts as a deviation.
"""

from __future__ import annotations

import numpy as np

from coopqp.base.spec import Array
from coopqp.model.state import Memory


def memory_of(k: int) -> dict[str, int]:
    """What a law with a model of k rows remembers: "integral" of the deviation, and e_m_dot."""
    return {"integral": k, "deviation": k, "model_rate": k}


class ReferenceModel:
    """The model of all task rows; what it remembers is in the law's memory.

    Args:
        gains: of the rows, shape (k,) [1/s].
        dt: control period [s].

    Attributes:
        memory_sizes: see :func:`memory_of`.
        e_ddot: e_m_ddot as of the last :meth:`update`, shape (k,).
    """

    def __init__(self, gains: Array, dt: float) -> None:
        self.memory_sizes = memory_of(len(gains))
        self.e_ddot = np.zeros(len(gains))
        self._gains, self._dt = gains, dt

    def update(self, memory: Memory, e: Array) -> None:
        """What the model's error does now, given the error, shape (k,)."""
        g, model_error = self._gains, e - memory["deviation"]
        self.e_ddot[:] = -g * (2.0 * memory["model_rate"] + g * model_error)

    def advance(self, memory: Memory, e_dot: Array, *, integrate: bool) -> None:
        """Carry the memory to the next tick, after :meth:`update`.

        Args:
            memory: written.
            e_dot: of the measured error, shape (k,).
            integrate: False while motors are at their limits: more would not help.
        """
        dt, deviation, model_rate = self._dt, memory["deviation"], memory["model_rate"]
        if integrate:
            integral = memory["integral"]
            integral += dt * deviation
        deviation += dt * (e_dot - model_rate)
        model_rate += dt * self.e_ddot
