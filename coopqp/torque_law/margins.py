"""Reference models and stability margins of torque and velocity laws.

With g the gain of a row's task, a critically damped reference model of its error e,

    e_m_ddot = -2 g e_m_dot - g^2 e_m,   deviation = e - e_m

An integral of e must return to zero after a step of the reference, so that e overshoots; an
integral of the deviation is unaffected by the step, and sees all effects of payload or pushes.
The model has to take over each step of the reference, so the deviation is what is kept, by the
rates, in which a step does not show (e_dot = J v - rate), and e_m = e - deviation:

    deviation += dt (e_dot - e_m_dot),   e_m_dot += dt e_m_ddot

A step of the reference's *rate*, as ``constant_velocity`` has, counts as a deviation.

Margins come from the law's own steps against a linear plant with delay: e_ddot = a for each row of
a torque law, a held for dt; e_dot = u for a velocity law. A command arrives some ticks late. Both
together are one linear map from tick to tick, and a pole z of it oscillates and decays as
exp(s dt) = z, with the damping ratio -Re s / |s|. Settings are refused where, with one tick of
delay, some pole is damped less than 0.215: there each oscillation has half the amplitude of the one
before (quarter-amplitude damping, Ziegler and Nichols 1942).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.model.state import Memory

#: Least damping ratio of a pole: half the amplitude each time, ln 2 / hypot(ln 2, pi).
MIN_DAMPING = math.log(2.0) / math.hypot(math.log(2.0), math.pi)
#: Ticks that a command is late where settings are judged; a robot's bus has no less.
DELAY = 1
#: Poles slower than this in a tick are what nothing moves: rows without an integral [-].
STILL = 1e-4


def memory_of(k: int) -> dict[str, int]:
    """Memory of a law with k rows: "integral" of the deviation, the deviation, and e_m_dot."""
    return {"integral": k, "deviation": k, "model_rate": k}


class ReferenceModel:
    """The model of all task rows with gains of shape (k,) [1/s]; its state is in the law's memory.

    ``e_ddot`` is e_m_ddot as of the last :meth:`update`, shape (k,).
    """

    def __init__(self, gains: Array, dt: float) -> None:
        self.memory_sizes = memory_of(len(gains))
        self.e_ddot = np.zeros(len(gains))
        self._gains, self._dt = gains, dt

    def update(self, memory: Memory, e: Array) -> None:
        """Compute the model's acceleration, given the error, shape (k,)."""
        g, model_error = self._gains, e - memory["deviation"]
        self.e_ddot[:] = -g * (2.0 * memory["model_rate"] + g * model_error)

    def advance(self, memory: Memory, e_dot: Array, *, integrate: bool) -> None:
        """To the next tick; without integration while motors are at their limits (anti-windup)."""
        dt, deviation, model_rate = self._dt, memory["deviation"], memory["model_rate"]
        if integrate:
            memory["integral"][:] += dt * deviation
        deviation += dt * (e_dot - model_rate)
        model_rate += dt * self.e_ddot


def _damping(
    decide: Callable[[Array, Array], Array], memory: Array, k: int, dt: float, delay: int,
    *, torques: bool,
) -> float:  # fmt: skip
    """Smallest damping ratio of the poles of a law's loop, negative where it is unstable.

    The state of its linear step from tick to tick is e and e_dot of k rows, the law's memory, which
    ``decide(e, e_dot)`` writes, and the commands that are late.
    """
    own = 2 * k + len(memory)

    def step(x: Array) -> Array:
        e, e_dot, memory[:] = x[:k], x[k : 2 * k], x[2 * k : own]
        late = np.concatenate([x[own:], decide(e, e_dot)])
        u = late[:k]
        moved = e + dt * e_dot + 0.5 * dt**2 * u if torques else e + dt * u
        rate = e_dot + dt * u if torques else u
        return np.concatenate([moved, rate, memory, late[k:]])

    matrix = np.column_stack([step(unit) for unit in np.eye(own + delay * k)])
    z = np.linalg.eigvals(matrix).astype(complex)
    s = np.log(z[np.abs(z) > STILL])  # what is gone in a tick does not oscillate
    s = s[np.abs(s) > STILL]
    return float((-s.real / np.abs(s)).min(initial=1.0))


@dataclass(frozen=True)
class TorqueLoop:
    """All rows of a torque law: e_ddot = forward e_m_ddot - W (kp w + ki int w + kd w_dot)."""

    gains: Array  # of the reference model [1/s], and kp, ki, kd, shape (k,)
    kp: Array
    ki: Array
    kd: Array
    W: Array  # acceleration by a wrench, shape (k, k) [1/kg, ...]
    dt: float  # control period [s]
    forward: float = 1.0  # 1 where the model's acceleration is fed forward, 0 where not

    def damping(self, delay: int = DELAY) -> float:
        model = ReferenceModel(self.gains, self.dt)
        memory = Memory(model.memory_sizes)

        def decide(e: Array, e_dot: Array) -> Array:
            model.update(memory, e)
            u = self.kp * memory["deviation"] + self.ki * memory["integral"]
            u += self.kd * (e_dot - memory["model_rate"])
            model.advance(memory, e_dot, integrate=True)
            return np.asarray(self.forward * model.e_ddot - self.W @ u, float)

        return _damping(decide, memory.numbers, len(self.gains), self.dt, delay, torques=True)


@dataclass(frozen=True)
class VelocityLoop:
    """All rows of a velocity law with a reference model of first order, e_m_dot = -kp e_m.

    kp, ki, kd have shape (k,) [1/s, 1/s2, 1], and dt is the control period [s].
    """

    kp: Array
    ki: Array
    kd: Array
    dt: float

    def decide(self, memory: Memory, e: Array, e_dot: Array) -> Array:
        """The wanted J v - rate, shape (k,), with e_dot of the last period."""
        deviation, integral = memory["deviation"], memory["integral"]
        model_rate = memory["model_rate"]
        w_dot = e_dot - model_rate
        deviation += self.dt * w_dot
        integral += self.dt * deviation
        model_rate[:] = -self.kp * (e - deviation)
        return model_rate - self.kp * deviation - self.ki * integral - self.kd * w_dot

    def damping(self, delay: int = DELAY) -> float:
        k = len(self.kp)
        memory = Memory(memory_of(k))
        decide = partial(self.decide, memory)
        return _damping(decide, memory.numbers, k, self.dt, delay, torques=False)


def spring_damping(C: Array, R: Array, dt: float, delay: int | None) -> float:
    """Smallest damping ratio of e_ddot = -C e - R e_dot, decided tick by tick.

    C [1/s2] and R [1/s] have shape (k, k). With a delay of None it is that of continuous time.
    """
    k, nothing = len(C), np.zeros_like(C)
    if delay is None:
        s = np.linalg.eigvals(np.block([[nothing, np.eye(k)], [-C, -R]])).astype(complex)
        return float((-s.real / np.maximum(np.abs(s), STILL)).min(initial=1.0))

    def decide(e: Array, e_dot: Array) -> Array:
        return np.asarray(-C @ e - R @ e_dot, float)

    return _damping(decide, np.zeros(0), k, dt, delay, torques=True)


def row_loop(gain: float, integral: float, dt: float) -> TorqueLoop:
    """One row under the torque QP, which decides accelerations, so that W = 1."""
    g = np.array([gain])
    return TorqueLoop(g, g**2, integral * g**3, 2.0 * g, np.eye(1), dt)


def damped(loop: TorqueLoop | VelocityLoop) -> bool:
    """Whether it is damped enough with one tick of delay."""
    return loop.damping() >= MIN_DAMPING


def largest(good: Callable[[float], bool], upper: float) -> float:
    """Largest good number below ``upper``, which is not, to two digits; 0 below a hundredth."""
    low, high = 0.0, upper
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if good(middle) else (low, middle)
    if low <= 1e-2 * upper:
        return 0.0
    digit = 10.0 ** (math.floor(math.log10(low)) - 1)
    return math.floor(low / digit) * digit


def require_damped_models(problem: ControlProblem, controller: str) -> None:
    """Refuse tasks whose reference decays faster than torque control can follow at this rate."""
    dt = problem.dt
    for task in problem.tasks:
        if task.impedance is None and not damped(row_loop(task.gain, 0.0, dt)):
            max_gain = largest(lambda gain: damped(row_loop(gain, 0.0, dt)), task.gain)
            raise InvalidValueError(
                f"task {task.name}: found gain {task.gain:g} 1/s, {controller} needs at most "
                f"{max_gain:g} 1/s at dt {1e3 * dt:g} ms; more oscillates when commands are a tick "
                "late, so lower it, or dt"
            )
