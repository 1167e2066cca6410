"""A line of the object goes onto a line in space: two offsets and two angles, four rows.

The object's line goes through the point p along the axis a, the one in space through c along the
unit vector d; that may move, c_dot, and turn about an axis through c, omega. With T = [t_1 t_2] a
basis of the plane normal to d that turns with the line, h(t) the reference offset, which shrinks
from the start to 0, and theta u the angle and way of a from its reference
(``geometry.inverse_alignment``):

    e = [T'(p - c) - h; theta u]

Khalil and Dombre 2004.
"""

from typing import ClassVar

import numpy as np

from coopqp.base.spec import Direction, spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.program import Primitive, lean, point
from coopqp.signal import Instant, MovingDirection
from coopqp.tasks._line_or_plane import OntoLineOrPlane


@spec
class LineOnLine(OntoLineOrPlane):
    """A line of the object goes onto a line (4 rows); it may slide along and spin."""

    angles: ClassVar[int] = 2

    direction: MovingDirection
    """Of the line at the start, in the world; any length."""
    axis: Direction
    """Of the object's line, in the object frame; any length."""
    either_way: bool = False
    """Whether the axis may also end against the direction; then it goes the shorter way."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The point's offset along two directions normal to the line, and how the axis leans."""
        return ("across_1", "across_2", "lean_1", "lean_2")

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        line = self.reference(self.direction, at, self.axis)
        x, y, z = axis = np.array(self.axis)
        if self.either_way and isinstance(at, State) and line.RT[2] @ at.R_WO @ axis < 0.0:
            x, y, z = -axis
        offset = point(line, self.point, self.profile, (0, 1))
        return offset, lean(line, (x, y, z), self.profile)
