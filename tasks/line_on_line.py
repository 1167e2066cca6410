"""A line of the object goes onto a line in space: two offsets and two angles, four rows.

The object's line goes through the point p along the axis a, the one in space through c along the
unit vector d; that may move, c_dot, and turn about an axis through c, omega. With T = [t_1 t_2] a
basis of the plane normal to d that turns with the line, h(t) the reference offset, which shrinks
from the start to 0, and theta u the angle and way of a from its reference
(``geometry.inverse_alignment``):

    e = [T'(p - c) - h; theta u]

Khalil and Dombre 2004.
"""

from __future__ import annotations

import numpy as np

from coopqp.base.spec import Direction, Positive, Vector3, spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.geometry import Reference, Turn
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.program import Primitive, lean, point
from coopqp.signal import Instant, MovingDirection, MovingPoint
from coopqp.task import Part, Task, pose_parts


@spec
class LineOnLine(Task):
    """A line of the object goes onto a line (4 rows); it may slide along and spin."""

    direction: MovingDirection
    """Of the line at the start, in the world; any length."""
    through: MovingPoint
    """A point of the line at the start, in the world [m]."""
    axis: Direction
    """Of the object's line, in the object frame; any length."""
    point: Vector3 = (0.0, 0.0, 0.0)
    """A point of the object's line, in the object frame [m]."""
    either_way: bool = False
    """Whether the axis may also end against the direction; then it goes the shorter way."""
    velocity: Vector3 = (0.0, 0.0, 0.0)
    """Of the line itself, in the world [m/s]."""
    turn: Turn | None = None
    """Turn of the line during the motion."""
    profile: Profile = Profile()
    """How offset and angle go to zero."""
    tolerance_angle: Positive = 5e-3
    """Angle at the end that still counts as reached [rad]."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The point's offset along two directions normal to the line, and how the axis leans."""
        return ("across_1", "across_2", "lean_1", "lean_2")

    def parts(self, chain: ClosedChain) -> tuple[Part, ...]:
        return pose_parts(2, 2, self.tolerance, self.tolerance_angle)

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        place = self.through, self.direction, self.velocity, self.turn
        line = Reference(*place, start=at, point=self.point, axis=self.axis)
        x, y, z = axis = np.array(self.axis)
        if self.either_way and isinstance(at, State) and line.RT[2] @ at.R_WO @ axis < 0.0:
            x, y, z = -axis
        offset = point(line, self.point, self.profile, (0, 1))
        return offset, lean(line, (x, y, z), self.profile)
