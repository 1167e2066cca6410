"""A point of the object goes to a plane: one row along the plane's normal, paper eq. (35)-(37).

The plane goes through c with unit normal n; it may move, c_dot, and turn about an axis through c,
n_dot = omega x n. With p the point and h(t) the reference height above the plane, which shrinks
from where the point starts to 0:

    e = n'(p - c) - h,   J = n' J_p,   rate = n' c_dot - n_dot' (p - c) + h_dot
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from coopqp.closed_chain import ClosedChain
from coopqp.profile import Profile
from coopqp.spec import Direction, Vector3, one_angle, spec, unit
from coopqp.state import PointOfObject, State
from coopqp.task import Evaluate, Task, TaskRows


@spec
class Turn:
    """A turn of the plane about an axis through its point."""

    axis: Direction
    """In the world; any length."""
    angle: float | None = None
    """How far [rad]."""
    angle_deg: float | None = None
    """How far [degrees]; instead of angle."""
    profile: Profile = Profile()
    """When and how."""

    def __post_init__(self) -> None:
        one_angle("angle", self.angle, self.angle_deg, needed=True)

    @property
    def radians(self) -> float:
        """How far [rad]."""
        return math.radians(self.angle_deg) if self.angle is None else self.angle  # type: ignore[arg-type]


@spec
class PointOnPlane(Task):
    """A point of the object goes to a plane (1 row); five directions stay free."""

    normal: Direction
    """Of the plane at the start, in the world; any length."""
    through: Vector3
    """A point of the plane at the start, in the world [m]."""
    point: Vector3 = (0.0, 0.0, 0.0)
    """The point that goes there, in the object frame [m]."""
    velocity: Vector3 = (0.0, 0.0, 0.0)
    """Of the plane itself, in the world [m/s]."""
    turn: Turn | None = None
    """Turn of the plane during the motion."""
    profile: Profile = Profile()
    """How the point's height above the plane goes to zero."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The height above the plane."""
        return ("normal",)

    @property
    def end(self) -> float:
        """When the point shall be on the plane and the plane has turned [s]."""
        return max(self.profile.end, self.turn.profile.end if self.turn else 0.0)

    def bind(self, start: State) -> Evaluate:
        """The height shrinks from what it is now."""
        c_0, c_dot = np.array(self.through), np.array(self.velocity)
        n_0, axis, angle, turning = unit(self.normal), np.zeros(3), 0.0, Profile()
        if self.turn:
            axis, angle, turning = unit(self.turn.axis), self.turn.radians, self.turn.profile
        tracked, profile = PointOfObject(self.point, start.chain.n), self.profile
        tracked.update(start)
        height = float(n_0 @ (tracked.p - c_0 - c_dot * start.t))

        def evaluate(state: State, rows: TaskRows) -> None:
            turned, turn_rate = turning.at(state.t)
            n = pin.exp3(axis * (angle * turned)).dot(n_0)
            n_dot = np.cross(axis * (angle * turn_rate), n)
            share, speed = profile.at(state.t)
            tracked.update(state)
            above = tracked.p - c_0 - c_dot * state.t
            rows.e[0] = n.dot(above) - height * (1.0 - share)
            rows.rate[0] = n.dot(c_dot) - n_dot.dot(above) - height * speed
            n.dot(tracked.J, rows.J[0])

        return evaluate
