"""Every number that decides what is said of a run, with its unit and its reason.

``docs/assessment.md`` prints this table.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from coopqp.base.spec import Array
from coopqp.limit import ROUNDING
from coopqp.model.grasp_configuration import CLOSED_ORIENTATION, CLOSED_POSITION
from coopqp.solver import Budget


class Threshold(float):
    """A number that knows its unit and why it is so large."""

    unit: str
    reason: str

    def __new__(cls, value: float, unit: str, reason: str) -> Threshold:
        made = super().__new__(cls, value)
        made.unit, made.reason = unit, reason
        return made


BEYOND = Threshold(
    1e-4, "rad, m", "More breaks a limit of place: servos resolve ten times as much."
)
BEYOND_SPEED = Threshold(
    1e-3, "m/s", "More breaks the object's limit of speed: sensors see no less."
)
BEYOND_ACCELERATION = Threshold(0.1, "rad/s2, m/s2", "More breaks one: rounding of v, over dt.")
TOO_FAST = Threshold(1e-3, "share", "A joint is too fast beyond (1 + this) times its speed limit.")
OUTSIDE = Threshold(ROUNDING, "rad, m", "A joint is outside its limits beyond rounding.")
AT_LIMIT = Threshold(1e-4, "row's unit", "A smaller margin is none; walls are neared ever slower.")
HELD_UP = Threshold(0.25, "of ticks", "A limit of speed met in more of the ticks holds a run up.")
AT_REST = Threshold(1e-3, "rad/s, m/s", "Slower joints are at rest: 0.06 degrees in a second.")
OSCILLATES = Threshold(1e-4, "m; 2 rad", "A narrower one is none: arms repeat to 0.1 mm, 0.2 mrad.")
LOOP_CLOSED = Threshold(CLOSED_POSITION, "m", "Hands farther apart pull: 10 kN/m make 1 N of it.")
LOOP_CLOSED_ANGLE = Threshold(CLOSED_ORIENTATION, "rad", "The same, on a lever of 0.1 m.")
TORN = Threshold(Budget().loop_position, "m", "Farther apart no object is held.")
TORN_ANGLE = Threshold(Budget().loop_orientation, "rad", "The same: `budget.loop_orientation`.")
SETTLED = Threshold(0.2, "s", "A force keeps its tolerance so long: an oscillation only passes it.")
SINGULAR = Threshold(
    0.02, "share", "With less of its manipulability at the start a task is singular."
)
SATURATED = Threshold(0.01, "of ticks", "A motor at its limit in less of them is only passing.")
AT_EFFORT = Threshold(0.999, "share", "From this share of its torque on a motor is at its limit.")
SPEED_UP = Threshold(
    0.2, "s", "Rest to full speed: the loop for robots limits accelerations by it."
)
ACCELERATION_UNLIMITED = Threshold(10.0, "rad/s2, m/s2", "Of joints without a speed limit.")
SLIPPED = Threshold(1e-3, "m", "An object that moves along a hand by less creeps, as simulated.")
FRICTION_LEFT = Threshold(5e-3, "share", "Less friction to spare is none.")
ON_EDGE = Threshold(1e-3, "share", "With less of a pad beside the pressure it stands on its edge.")
MODEL_OFF = Threshold(1e-3, "m", "Hands are so far from the model that the verdict says it.")
MODEL_OFF_ANGLE = Threshold(5e-3, "rad", "The same.")
CALIBRATE = Threshold(5e-3, "m", "Hands so far from the model ask for `coopqp calibrate`.")
CALIBRATE_ANGLE = Threshold(20e-3, "rad", "The same.")
RESOLUTION = Threshold(0.01, "share", "Figures of less than this of their threshold are left out.")

#: All of them, by name.
TABLE: Mapping[str, Threshold] = {
    name.lower(): value for name, value in dict(globals()).items() if isinstance(value, Threshold)
}
_BEYOND = {
    "rad": BEYOND, "m": BEYOND, "m/s": BEYOND_SPEED, "rad/s": BEYOND_SPEED,
    "rad/s2": BEYOND_ACCELERATION, "m/s2": BEYOND_ACCELERATION,
}  # fmt: skip


def within(error: float, tolerance: float) -> bool:
    """Whether an error counts as reached; one that is no number does not."""
    return bool(error <= tolerance)


def resolved(value: float, threshold: float) -> bool:
    """Whether a figure is worth telling beside its threshold; what is no number is."""
    return not value <= RESOLUTION * threshold


def matters(by: float, unit: str) -> bool:
    """Whether a limit is broken by more than is negligible [unit]; what is no number is broken."""
    return not by <= _BEYOND.get(unit, ROUNDING)


def closed(position: float, orientation: float) -> bool:
    """Whether arms that carry one object so far apart [m], [rad] close a loop; NaN does not."""
    return bool(position <= LOOP_CLOSED and orientation <= LOOP_CLOSED_ANGLE)


def torn(position: float, orientation: float) -> bool:
    """Whether hands are too far apart for one object; as :func:`closed`."""
    return not (position <= TORN and orientation <= TORN_ANGLE)


def at_effort(tau: Array, effort: Array) -> NDArray[np.bool_]:
    """Which motors are at their limits: torques, shape (T, n), and these, (n,) [N m, N]."""
    limited = np.isfinite(effort) & (effort > 0.0)
    return np.asarray((np.abs(tau) >= AT_EFFORT * effort) & limited)


def rests(v: Array) -> bool:
    """Whether joints with velocities v [rad/s, m/s] are at rest."""
    return bool(np.abs(v).max(initial=0.0) <= AT_REST)
