"""Internal force control of arms that take positions or velocities, by admittance.

With e the direction from one hand to the other, the hands approach each other along it at

    v = g (F_wanted - F),   |v| <= most_speed

where F is the measured squeeze. The force is proportional to the relative displacement, so this
integrates the force error: none remains at rest, whatever the stiffness. It enters through the
loop correction, J_c v = -kappa (e_c - o): along e the loop offset o is the commanded relative
displacement, o' = v, and in all other directions it is the estimated model bias
(``model.loop_observer``), which leaves e out, since it would cancel the squeeze.

With a series stiffness k between the hands, 1/k = 1/k_hand1 + 1/k_hand2 + 1/k_servos, and commands
that are d ticks late, F' = k v is stable where

    g k dt < 2 sin(pi / (2 (2 d + 1)))      2, 1, 0.618, 0.445 for d = 0, 1, 2, 3

and oscillates already below that. The default gain, with the servos' lag T, is

    g = c / (k_max (T + (d + 1) dt + 1/kappa - dt)),   c = 0.2

It does not overshoot at the stated stiffness nor below, where it is only slower; hands up to nine
times as stiff are still stable.

Where the measured forces need more than the share ``NEAR_SLIP`` of the hands' friction, F_wanted
grows until they need ``ENOUGH``, up to the contacts' ``most``, and stays so.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array, NonNegative, Positive, spec
from coopqp.base.wording import counted
from coopqp.closed_loop.hands import WrenchReadings, WrenchStack, friction_needed, hands, points
from coopqp.controller import ControlProblem
from coopqp.model.state import State
from coopqp.solver import Status
from coopqp.task import Task

#: Share c of the gain with which hands as stiff as stated close in on the wanted force in one lag.
CAUTION = 0.2
#: Names in the memory of a law: where e was in the last tick, shape (3,); by how much the wanted
#: force has grown, shape (1,) [N].
ALONG, GROWN = "squeezes along", "squeezes more by"
#: Share of the friction from which the wanted force grows, to which, and in which time [s]; at most
#: so many times itself where the contacts have no ``most``.
NEAR_SLIP, ENOUGH, GROWING, MOST_GROWN = 0.9, 0.8, 0.1, 3.0
#: Hands that are this near to most_way, as a share of it, stand there.
ROUNDING = 1e-6


@spec
class Admittance:
    """Settings of internal force control for arms that take positions, by measured forces."""

    stiffness: Positive
    """Of both hands and their servos in series, at most [N/m]; what yields least counts."""
    lag: NonNegative = 0.0
    """Time by which the servos follow late, T [s]."""
    delay: Annotated[int, Field(ge=0, le=1000)] = 1
    """Ticks between a measured force and the motion that answers it."""
    gain: Positive | None = None
    """Closing speed for a missing newton, g [m/(s N)]; from the stiffness if omitted."""
    most_speed: Positive = 0.05
    """How fast the hands may approach each other, or part, for it [m/s]."""
    most_way: Positive = 0.1
    """Largest commanded displacement towards each other beyond the model [m]."""

    def gain_of(self, dt: float, kappa: float) -> float:
        """The gain [m/(s N)], given or by default, from dt [s] and the loop correction's kappa."""
        if self.gain is not None:
            return self.gain
        return CAUTION / (self.stiffness * (self.lag + self.delay * dt + 1.0 / kappa))


def stability_limit(delay: int) -> float:
    """Smallest g k dt at which F[n+1] = F[n] + g k dt (F_wanted - F[n - delay]) oscillates."""
    return 2.0 * math.sin(math.pi / (2.0 * (2 * delay + 1)))


class InternalForceControl:
    """Moves the offset of a loop so that two hands squeeze with the wanted force.

    Attributes:
        along: direction among all loops in which the loop offset is the squeeze's, shape (6 L,).
        gain: g [m/(s N)]. wanted: F_wanted of the last update; NaN before [N].
        note: details of the last tick's status.

    InvalidValueError: the tasks ask for more than one squeeze between two hands, kappa is 0, or the
    gain is unstable with the stated stiffness.
    """

    def __init__(self, problem: ControlProblem, settings: Admittance) -> None:
        _check_tasks(problem.wrenches)
        chain, dt = problem.chain, problem.dt
        if chain.holding != 2:
            raise InvalidValueError(
                f"admittance: needs two hands that hold the object, found {chain.holding}"
            )
        if not problem.kappa > 0.0:
            raise InvalidValueError(
                "admittance: the squeeze enters through the loop correction, and kappa is 0; "
                f"leave kappa out, or give up to 1/dt = {1.0 / dt:g} 1/s"
            )
        self.gain, self._settings, self._dt = settings.gain_of(dt, problem.kappa), settings, dt
        limit = stability_limit(settings.delay)
        if not self.gain * settings.stiffness * dt < limit:
            raise InvalidValueError(
                f"admittance.gain: found {self.gain:g} m/(s N), which is unstable with "
                f"{settings.stiffness:g} N/m and {counted(settings.delay, 'tick')} of delay; needs "
                f"less than {limit / (settings.stiffness * dt):.3g}, or leave it out"
            )
        self._hands = hands(chain)
        self._readings, self.note, self.wanted = WrenchReadings(chain), "", math.nan
        self._wrenches = WrenchStack(problem.wrenches, State(chain))
        self.along = np.zeros(6 * (len(chain.arms) - 1))
        self.memory_sizes: Mapping[str, int] = {ALONG: 3, GROWN: 1}
        self._presses = any(hand.contact for hand in self._hands)

    def update(self, state: State) -> Status | None:
        """Move the loop offset by how far the hands are to approach each other; the fault, if any.

        ``state`` has up-to-date kinematics; its offset and memory are written. Either the force
        was not measured, so the hands stay as they are, or the hands are at ``most_way`` and the
        force error exceeds the task's tolerance.
        """
        p = points(self._hands, state.p_WO, state.R_WO)
        e = (p[1] - p[0]) / np.linalg.norm(p[1] - p[0])
        before, offset = state.memory[ALONG], state.loop_offset[:3]
        self.along[:3] = e
        error = self._force_error(state)
        if state.corrected < 1.0:
            return self._status(error, -float(e.dot(offset)))
        if before.any():  # the squeeze turns with the object
            offset += before.dot(offset) * (e - before)
        before[:] = e
        if not math.isfinite(error):
            return self._status(error, 0.0)
        max_speed, way = self._settings.most_speed, -e.dot(offset)
        target = way + self._dt * min(max(self.gain * error, -max_speed), max_speed)
        bound = max(self._settings.most_way, abs(way))
        offset -= (min(max(target, -bound), bound) - way) * e
        state.update_drift()
        return self._status(error, -float(e.dot(offset)))

    def _status(self, error: float, way: float) -> Status | None:
        """Status and note of a tick from the force error [N] and the displacement [m]."""
        self.note, max_way = self._readings.fault, self._settings.most_way
        if not math.isfinite(error):
            return Status.FORCE_NOT_MEASURED
        at_bound = abs(way) >= max_way * (1.0 - ROUNDING) and error * way > 0.0
        if not at_bound or abs(error) <= self._wrenches.tasks[0].tolerance:
            return None
        where, by = ("closer", "little") if way > 0.0 else ("farther apart", "much")
        self.note = (
            f"stands at most_way, {1e3 * max_way:g} mm {where} than the model says, with "
            f"{abs(error):.3g} N too {by}; is the force sensor alive? Else raise "
            "admittance.most_way"
        )
        return Status.SQUEEZE_GIVEN_UP

    def _force_error(self, state: State) -> float:
        """F_wanted - F [N]; NaN where the force is not known."""
        self._wrenches.update(state)
        measured = self._readings.read(state.hand_wrench)
        if measured is None:
            return math.nan
        missing, grown = -float(self._wrenches.error(measured)[0]), state.memory[GROWN]
        wanted = float(self._wrenches.wanted[0])
        if self._presses:
            needed = self._needed(state, measured, wanted, wanted - missing)
            share = min(1.0, self._dt / GROWING)
            grown[0] += share * max(0.0, needed - wanted - float(grown[0]))
        self.wanted = wanted + float(grown[0])
        return missing + float(grown[0])

    def _needed(self, state: State, measured: Array, wanted: float, pressed: float) -> float:
        """The force with which friction suffices, at most the contacts' [N]; zero if it does."""
        use, upper = 0.0, math.inf
        for _, contact, need in friction_needed(self._hands, measured, state.R_WO):
            use, upper = max(use, need / contact.friction), min(upper, contact.max_force)
        if not NEAR_SLIP < use < math.inf:
            return 0.0
        return min(pressed * use / ENOUGH, MOST_GROWN * wanted if upper == math.inf else upper)


def internal_force_control(
    problem: ControlProblem, settings: Admittance | None
) -> InternalForceControl | None:
    """The internal force control of a problem; None where no task asks for a force.

    InvalidValueError: a force is asked for without a stated stiffness; as the control itself.
    """
    if not problem.wrenches:
        return None
    if settings is None:
        raise InvalidValueError(unstated(problem.wrenches[0].name))
    return InternalForceControl(problem, settings)


def unstated(task: str) -> str:
    """The message where a task asks for a force and no stiffness is stated."""
    return (
        f"'{task}' asks arms that take velocities for a force; state how stiff hands and servos "
        "are together at most [N/m], such as qp: {admittance: {stiffness: 10000}}, or leave the "
        "task out"
    )


def _check_tasks(tasks: Sequence[Task]) -> None:
    if len(tasks) != 1:
        names = ", ".join(f"'{task.name}'" for task in tasks)
        raise InvalidValueError(f"admittance: controls one squeeze, and {names} ask for forces")
    (task,) = tasks
    if getattr(task, "components", ()) != ("squeeze",):
        raise InvalidValueError(
            f"admittance: '{task.name}' asks for more than a squeeze; leave the other components "
            "out, or use torque_qp"
        )
    if task.mode == "hard":
        raise InvalidValueError(
            f"admittance: '{task.name}' is hard, but the squeeze converges over time; leave "
            "mode out"
        )
