"""The object moves at a velocity, as from a joystick: a row for each component that is given.

    e = 0,   J = the rows of J_O given,   rate = s(t) times the velocity commanded

J_O is the Jacobian of a point of the object, (v; omega), in the world's or the object's own axes.
The share s grows from 0 to 1 with the profile. A signal's values are velocities here. No position
is kept, so the gain is without effect; reports show J v - rate.
"""

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from coopqp.base.spec import Positive, Vector3, spec
from coopqp.model.closed_chain import AXES, ClosedChain
from coopqp.model.profile import Profile
from coopqp.program import Kind, Primitive
from coopqp.signal import Instant, Reads, Signal, Trajectory, of_twist
from coopqp.task import Part, Task

Axis = Literal["x", "y", "z", "rot_x", "rot_y", "rot_z"]
Components = Annotated[dict[Axis, float], Field(min_length=1)]


@spec
class Twist(Task):
    """The object moves at a velocity (a row for each component given); for teleoperation."""

    unit: ClassVar[str] = "m/s"
    asks_velocity: ClassVar[bool] = True

    velocity: Annotated[Components | Signal, Reads(Components, mapping=True)]
    """Of some of x, y, z, rot_x, rot_y, rot_z [m/s, rad/s]; zero holds still, left out is free."""
    components: Annotated[tuple[Axis, ...], Field(min_length=1)] | None = None
    """Which of them a signal commands, in its order; all six if omitted."""
    point: Vector3 = (0.0, 0.0, 0.0)
    """The point whose velocity x, y and z are, in the object frame [m]."""
    axes: Literal["world", "object"] = "world"
    """Along whose axes."""
    profile: Profile = Profile(duration=0.2)
    """How the velocity grows from zero to what is commanded."""
    tolerance_angle: Positive = 5e-3
    """Error of the angular velocity at the end that still counts as reached [rad/s]."""

    def __post_init__(self) -> None:
        if self.components is None:
            return
        if not isinstance(self.velocity, Signal):
            raise ValueError("components: velocity names them itself; omit it")
        if len(set(self.components)) < len(self.components):
            raise ValueError("components: needs each of them once")

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return tuple(axis for axis in AXES if axis in self._given)

    def parts(self, chain: ClosedChain) -> tuple[Part, ...]:
        given = self._given
        turns = sum(axis.startswith("rot") for axis in given)
        parts = (
            Part("velocity", len(given) - turns, "m/s", self.tolerance),
            Part("angular velocity", turns, "rad/s", self.tolerance_angle),
        )
        return tuple(part for part in parts if part.rows)

    @property
    def _given(self) -> tuple[str, ...]:
        if isinstance(self.velocity, Signal):
            return self.components or AXES
        return tuple(self.velocity)

    def geometry(self, at: Instant) -> tuple[Primitive, ...]:
        given = self._given
        kind, names = of_twist(given), [axis for axis in AXES if axis in given]
        if isinstance(self.velocity, Signal):
            goal = self.velocity.bind(kind, at, kind.zero)
        else:
            goal = Trajectory(kind, np.array(list(self.velocity.values())))
        return (
            Primitive(
                kind=Kind.TWIST, rows=tuple(map(AXES.index, names)), point=self.point, goal=goal,
                order=tuple(map(given.index, names)), profile=self.profile,
                planar=self.axes == "object",
            ),
        )  # fmt: skip
