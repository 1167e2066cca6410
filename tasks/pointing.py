"""An axis of the object points along a direction in space: two rows.

The direction d may turn. The reference direction goes from where the axis a points at the start to
d on the shortest way. With theta the angle between them and u the way the axis leans, in a basis
normal to the reference that turns with it (``geometry.inverse_alignment``),

    e = theta u,   |e| = theta
"""

from typing import ClassVar

from coopqp.base.spec import Direction, Positive, spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.geometry import Reference, Turn
from coopqp.model.profile import Profile
from coopqp.program import Primitive, lean
from coopqp.signal import Instant, MovingDirection
from coopqp.task import Task


@spec
class Pointing(Task):
    """An axis of the object points along a direction (2 rows); it may spin and go anywhere."""

    unit: ClassVar[str] = "rad"

    direction: MovingDirection
    """At the start, in the world; any length."""
    axis: Direction
    """The axis that points there, in the object frame; any length."""
    turn: Turn | None = None
    """Turn of the direction during the motion."""
    profile: Profile = Profile()
    """How the axis turns from the start to the direction."""
    tolerance: Positive = 5e-3
    """Angle at the end that still counts as reached [rad]."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """How far the axis leans two ways normal to the direction."""
        return ("lean_1", "lean_2")

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        reference = Reference(direction=self.direction, turn=self.turn, start=at, axis=self.axis)
        return (lean(reference, self.axis, self.profile),)
