"""A reference that follows a value that jumps, within bounds on its speed, acceleration and jerk.

Each step plans the quickest way from where the reference is, with its speed and acceleration, to
the value (Berscheid and Kroeger, Jerk-limited real-time trajectory generation with arbitrary target
states, 2021) and goes one dt along it. A rotation is followed in the rotation vector from where the
reference is, phi = log(R_value R'), anew in each step.

Bounds hold for lengths of vectors: each of k axes gets its k^-1/2. Each joint has its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pinocchio as pin
from ruckig import ControlInterface, InputParameter, OutputParameter, Ruckig, RuckigError

from coopqp.base.spec import Array, Positive, spec
from coopqp.signal import Kind, Trajectory, matrix, quaternion_of, shortest_way

#: Within these there is always a way; they are those of arms, and wider [SI].
VELOCITIES, ACCELERATIONS, JERKS = (1e-3, 100.0), (1e-3, 1e4), (1e-3, 1e6)
#: Time to full speed, and to full acceleration: less is no bound, more is never there [s].
RAMPS = (1e-3, 1e3)
#: Share of the jerk with which a plan is found where rounding has spoiled the first one.
GENTLER = 0.999
ROUNDING = 1e-9


@spec
class MotionLimits:
    """How fast a reference may go."""

    velocity: Positive = 0.25
    """Of a point [m/s], of each joint [rad/s, m/s]; of velocities their own size."""
    acceleration: Positive = 1.0
    """[m/s2, rad/s2]"""
    jerk: Positive = 10.0
    """[m/s3, rad/s3]; of velocities the second rate of change."""
    angular_velocity: Positive = 1.0
    """Of a rotation or a direction [rad/s]."""
    angular_acceleration: Positive = 4.0
    """[rad/s2]"""
    angular_jerk: Positive = 40.0
    """[rad/s3]"""

    def __post_init__(self) -> None:
        for key, unit in (("", "m"), ("angular_", "rad")):
            of = [getattr(self, f"{key}{name}") for name in ("velocity", "acceleration", "jerk")]
            names = [f"{key}velocity", f"{key}acceleration", f"{key}jerk"]
            units = [f"{unit}/s", f"{unit}/s2", f"{unit}/s3"]
            for name, x, bounds, one in zip(
                names, of, (VELOCITIES, ACCELERATIONS, JERKS), units, strict=True
            ):
                _within(name, x, bounds, one)
            for k in (1, 2):
                bounds = of[k - 1] / RAMPS[1], of[k - 1] / RAMPS[0]
                before = f", beside {names[k - 1]} {of[k - 1]:g} {units[k - 1]}"
                _within(names[k], of[k], bounds, units[k], before)


def _within(name: str, x: float, bounds: tuple[float, float], unit: str, before: str = "") -> None:
    """Refuse a bound with which there may be no way; a little beyond is rounding."""
    low, high = bounds
    if not low * (1.0 - ROUNDING) <= x <= high * (1.0 + ROUNDING):
        raise ValueError(f"{name}: found {x:g}, needs {low:g} to {high:g} {unit}{before}")


def _bounds(kind: Kind, pace: MotionLimits) -> Iterator[Array]:
    """Bounds on velocity, acceleration and jerk of each axis."""
    along = np.array([pace.velocity, pace.acceleration, pace.jerk])
    about = np.array([pace.angular_velocity, pace.angular_acceleration, pace.angular_jerk])
    turns = [name.startswith("rot") for name in kind.columns] if kind.velocity else []
    for i in range(kind.numbers):
        turning = kind.velocity and turns[i]
        alike = turns.count(turning) if kind.velocity else kind.numbers
        share = 1.0 if kind.each else math.sqrt(alike)
        yield (about if turning else along) / share
    for _ in range(3 * kind.turns):
        yield about / math.sqrt(3.0)


class TrajectoryFilter(Trajectory):
    """A reference that follows its target by :meth:`step` of dt [s]; at rest at ``value`` first."""

    moves = True

    def __init__(self, kind: Kind, pace: MotionLimits, dt: float, value: Array) -> None:
        super().__init__(kind, value)
        count = kind.rates
        self.acceleration = np.zeros(count)
        bounds = np.array(list(_bounds(kind, pace))).T
        self._fastest, _, self._jerk = bounds
        self._planner, self._out = Ruckig(count, dt), OutputParameter(count)
        self._plan, self._brake = _plan(kind, bounds), _plan(kind, bounds, brakes=True)

    def step(self, target: Array | None) -> bool:
        """Go on for dt to a target (None: brake); False, and standing still, without a way."""
        plan = self._brake if target is None else self._plan
        k = self.kind.numbers
        plan.current_acceleration = self.acceleration
        if self.kind.velocity:
            plan.current_position = np.zeros(k)
            plan.current_velocity = self.value
            wanted = np.zeros(k) if target is None else target  # cut to its bounds
            plan.target_velocity = wanted / np.max(np.abs(wanted) / self._fastest, initial=1.0)
            plan.current_acceleration = self.rate
        else:
            plan.current_position = np.concatenate([self.value[:k], np.zeros(len(self.rate) - k)])
            plan.current_velocity = self.rate
            if target is not None:
                plan.target_position = np.concatenate([target[:k], self._turn_to(target[k:])])
        if not self._planned(plan):
            self.rate[:] = self.acceleration[:] = 0.0
            return False
        self._go()
        return True

    def _planned(self, plan: InputParameter) -> bool:
        """Whether there is a plan; rounding can spoil one, and hardly ever the next beside it."""
        for share in (1.0, GENTLER):
            plan.max_jerk = share * self._jerk
            try:
                self._planner.update(plan, self._out)
            except (RuckigError, ValueError):  # of values that are out of all proportion
                continue
            return True
        return False

    def _turn_to(self, quaternion: Array) -> Array:
        """The rotation vector from here to there, shape (3,) or (0,)."""
        if not self.kind.turns:
            return quaternion
        R = self.R
        if self.kind.axis:
            return shortest_way(R[:, 2], matrix(quaternion)[:, 2])
        return np.array(pin.log3(matrix(quaternion).dot(R.T)))

    def _go(self) -> None:
        out, k = self._out, self.kind.numbers
        if self.kind.velocity:
            self.value[:], self.rate[:] = out.new_velocity, out.new_acceleration
            return
        position, self.acceleration[:] = np.array(out.new_position), out.new_acceleration
        self.value[:k] = position[:k]
        self.rate[:] = out.new_velocity
        if self.kind.turns:
            way = position[k:]
            # The left Jacobian; pinocchio's Jexp3 is the right one, of the opposite way.
            self.rate[k:] = pin.Jexp3(-way).dot(self.rate[k:])
            turned = quaternion_of(pin.exp3(way).dot(self.R))
            self.value[k:] = turned / np.linalg.norm(turned)


def _plan(kind: Kind, bounds: Array, *, brakes: bool = False) -> InputParameter:
    plan = InputParameter(kind.rates)
    velocities = brakes or kind.velocity
    plan.control_interface = ControlInterface.Velocity if velocities else ControlInterface.Position
    plan.target_velocity = plan.target_acceleration = [0.0] * kind.rates
    plan.max_velocity, plan.max_acceleration, plan.max_jerk = bounds
    return plan
