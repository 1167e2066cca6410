"""The object moves at a velocity, as from a joystick: a row for each component that is given.

    e = 0,   J = the rows of J_O given,   rate = s(t) times the velocity commanded

J_O is the Jacobian of a point of the object, (v; omega), in the world's or the object's own axes.
The share s grows from 0 to 1 with the profile, so that the object sets off without a jerk. There is
no position to come back to, so e is zero and the gain without effect; reports show J v - rate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field
from pydantic.json_schema import SkipJsonSchema

from coopqp.checked import Positive, Vector3, spec
from coopqp.closed_chain import AXES, ClosedChain
from coopqp.mark import Mark, TrackedMark
from coopqp.profile import Profile
from coopqp.program import Kind, Primitive
from coopqp.state import PointOfObject, State
from coopqp.task import Evaluate, Part, Task, TaskRows

Axis = Literal["x", "y", "z", "rot_x", "rot_y", "rot_z"]
Command = Callable[[float], Sequence[float]]


@spec
class Twist(Task):
    """The object moves at a velocity (a row for each component given); for teleoperation."""

    unit: ClassVar[str] = "m/s"
    asks_velocity: ClassVar[bool] = True

    velocity: Annotated[dict[Axis, float], Field(min_length=1)]
    """Of some of x, y, z, rot_x, rot_y, rot_z [m/s, rad/s]; zero holds still, left out is free."""
    point: Vector3 = (0.0, 0.0, 0.0)
    """The point whose velocity x, y and z are, in the object frame [m]."""
    axes: Literal["world", "object"] = "world"
    """Along whose axes."""
    profile: Profile = Profile(duration=0.2)
    """How the velocity grows from zero to what is commanded."""
    command: SkipJsonSchema[Command | None] = None
    """In Python: time [s] to the components of ``velocity``, in their order here, instead of it."""
    tolerance_angle: Positive = 5e-3
    """Error of the angular velocity at the end that still counts as reached [rad/s]."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The components given, translation first."""
        return tuple(axis for axis in AXES if axis in self.velocity)

    def parts(self, chain: ClosedChain) -> tuple[Part, ...]:
        """Translation and rotation, as far as given."""
        turns = sum(axis.startswith("rot") for axis in self.velocity)
        parts = (
            Part("velocity", len(self.velocity) - turns, "m/s", self.tolerance),
            Part("angular velocity", turns, "rad/s", self.tolerance_angle),
        )
        return tuple(part for part in parts if part.rows)

    @property
    def end(self) -> float:
        """When the velocity is what is commanded [s]."""
        return self.profile.end

    def bind(self, start: State) -> Evaluate:
        """The velocity grows from zero."""
        names = self.rows(start.chain)
        chosen = np.array([AXES.index(name) for name in names])
        constant = np.array([self.velocity[name] for name in names])  # type: ignore[index]
        order = [list(self.velocity).index(name) for name in names]  # type: ignore[arg-type]
        tracked, profile, command = (
            PointOfObject(self.point, start.chain.n),
            self.profile,
            self.command,
        )
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
            wanted = constant if command is None else np.asarray(command(state.t))[order]
            np.multiply(wanted, share, rows.rate)

        return evaluate

    def program(self, start: State) -> tuple[Primitive, ...] | None:
        """As primitives; None where a function commands it."""
        if self.command is not None:
            return None
        rows = tuple(AXES.index(name) for name in self.rows(start.chain))
        velocity = [self.velocity.get(axis, 0.0) for axis in AXES]  # type: ignore[call-overload]
        return (
            Primitive(
                kind=Kind.TWIST, rows=rows, point=self.point, profile=self.profile,
                velocity=velocity, planar=self.axes == "object",
            ),
        )  # fmt: skip

    def marks(self, t: float) -> tuple[Mark, ...]:
        """The point that moves."""
        return (TrackedMark(point=self.point),)
