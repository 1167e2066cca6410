"""The object moves at a velocity, as from a joystick: a row for each component that is given.

    e = 0,   J = the rows of J_O given,   rate = s(t) times the velocity commanded

J_O is the Jacobian of a point of the object, (v; omega), in the world's or the object's own axes.
The share s grows from 0 to 1 with the profile. A signal's values are velocities here. No position
is kept, so the gain is without effect; reports show J v - rate.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from coopqp.base.spec import Positive, Vector3, spec
from coopqp.model.closed_chain import AXES, ClosedChain
from coopqp.model.marker import Marker, TrackedMarker
from coopqp.model.profile import Profile
from coopqp.model.state import PointOfObject, State
from coopqp.program import Kind, Primitive
from coopqp.signal import Instant, Reads, Signal, Trajectory, of_twist
from coopqp.task import Evaluate, Part, Task, TaskRows

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

    def bind(self, start: State) -> Evaluate:
        names = self.rows(start.chain)
        chosen = np.array([AXES.index(name) for name in names])
        order = np.array([self._given.index(name) for name in names])
        tracked, profile = PointOfObject(self.point, start.chain.n), self.profile
        commanded = self._trajectory(start)
        turned, J = self.axes == "object", np.zeros((6, start.chain.n))

        def evaluate(state: State, rows: TaskRows) -> None:
            share, _ = profile.at(state.t)
            tracked.update(state)
            if turned:
                state.R_WO.T.dot(tracked.J, J[:3])
                state.R_WO.T.dot(state.J_task[3:], J[3:])
            else:
                J[:3], J[3:] = tracked.J, state.J_task[3:]
            np.take(J, chosen, axis=0, out=rows.J, mode="clip")
            commanded.update(state)
            np.multiply(commanded.value[order], share, rows.rate)

        return evaluate

    def program(self, start: State) -> tuple[Primitive, ...] | None:
        """As primitives; None where a signal commands it."""
        if isinstance(self.velocity, Signal):
            return None
        rows = tuple(AXES.index(name) for name in self.rows(start.chain))
        velocity = [self.velocity.get(axis, 0.0) for axis in AXES]  # type: ignore[call-overload]
        return (
            Primitive(
                kind=Kind.TWIST, rows=rows, point=self.point, profile=self.profile,
                velocity=velocity, planar=self.axes == "object",
            ),
        )  # fmt: skip

    def marks(self, at: Instant) -> tuple[Marker, ...]:
        return (TrackedMarker(point=self.point),)

    @property
    def _given(self) -> tuple[str, ...]:
        if isinstance(self.velocity, Signal):
            return self.components or AXES
        return tuple(self.velocity)

    def _trajectory(self, start: Instant) -> Trajectory:
        kind = of_twist(self._given)
        if isinstance(self.velocity, Signal):
            return self.velocity.bind(kind, start, kind.zero)
        return Trajectory(kind, np.array(list(self.velocity.values())))
