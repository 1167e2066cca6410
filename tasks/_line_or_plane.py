"""What tasks share that bring the object to a line or a plane in space."""

from typing import ClassVar

from coopqp.base.spec import Positive, Vector3, spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.geometry import Reference, Turn
from coopqp.model.profile import Profile
from coopqp.signal import Instant, MovingDirection, MovingPoint
from coopqp.task import Part, Task, pose_parts


@spec
class ToLineOrPlane(Task):
    """A point of the object goes to a line or a plane, which may move."""

    through: MovingPoint
    """A point of the line or plane at the start, in the world [m]."""
    point: Vector3 = (0.0, 0.0, 0.0)
    """The point that goes there, of the object's own line or plane if it has one, in the object
    frame [m]."""
    velocity: Vector3 = (0.0, 0.0, 0.0)
    """Of the line or plane itself, in the world [m/s]."""
    turn: Turn | None = None
    """Turn of the line or plane during the motion."""
    profile: Profile = Profile()
    """How the errors go to zero."""

    def reference(
        self, direction: MovingDirection, at: Instant, axis: Vector3 | None = None
    ) -> Reference:
        """The line or plane with its direction or normal, setting out at an instant."""
        place = self.through, direction, self.velocity, self.turn
        return Reference(*place, start=at, point=self.point, axis=axis)


@spec
class OntoLineOrPlane(ToLineOrPlane):
    """A line or plane of the object, or all of it, goes onto one in space."""

    angles: ClassVar[int]
    """How many of the rows, the last ones, are angles."""

    tolerance_angle: Positive = 5e-3
    """Angle at the end that still counts as reached [rad]."""

    def parts(self, chain: ClosedChain) -> tuple[Part, ...]:
        moves = len(self.rows(chain)) - self.angles
        return pose_parts(moves, self.angles, self.tolerance, self.tolerance_angle)
