"""The object turns to an orientation: three rows; its place stays free.

The reference turns about one axis, R_r = exp(s phi) R_start with phi = log(R_goal R_start'). With
R_e = R R_r' and Jl the left Jacobian of SO(3),

    e = log R_e,   J = Jl^-1(e) J_omega,   rate = Jl^-1(e) R_e s_dot phi
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from coopqp.checked import Array, Pose, Positive, Vector3, one_angle, spec
from coopqp.closed_chain import ClosedChain
from coopqp.geometry import RotationError
from coopqp.grasp import pose_matrix
from coopqp.mark import Mark, PoseMark
from coopqp.profile import Profile
from coopqp.program import Primitive, rotation
from coopqp.state import State
from coopqp.task import Evaluate, Task, TaskRows


@spec
class Orientation(Task):
    """The object turns to an orientation (3 rows); it may be anywhere."""

    unit: ClassVar[str] = "rad"

    rpy: Vector3 | None = None
    """Roll, pitch, yaw of the object at the end, about fixed x, y, z of the world [rad]."""
    rpy_deg: Vector3 | None = None
    """Roll, pitch, yaw [degrees]; instead of rpy."""
    profile: Profile = Profile()
    """How the reference turns from the start to the goal."""
    tolerance: Positive = 5e-3
    """Angle at the end that still counts as reached [rad]."""

    def __post_init__(self) -> None:
        one_angle("rpy", self.rpy, self.rpy_deg, needed=True)

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """Rotation about the world axes."""
        return ("rot_x", "rot_y", "rot_z")

    @property
    def end(self) -> float:
        """When the reference arrives [s]."""
        return self.profile.end

    def bind(self, start: State) -> Evaluate:
        """The reference sets out from how the object is turned now."""
        error, world = RotationError(self._goal(), self.profile, start.R_WO), np.eye(3)

        def evaluate(state: State, rows: TaskRows) -> None:
            out = rows.e, rows.J, rows.rate
            error.fill(state.t, state.R_WO, world, state.J_task[3:], out)

        return evaluate

    def program(self, start: State) -> tuple[Primitive, ...]:
        """As primitives."""
        return (rotation(self._goal(), self.profile, start.R_WO),)

    def marks(self, t: float) -> tuple[Mark, ...]:
        """The orientation, wherever the object is."""
        return (PoseMark(rotation=self._goal()),)

    def _goal(self) -> Array:
        R: Array = pose_matrix(Pose(rpy=self.rpy, rpy_deg=self.rpy_deg)).rotation
        return R
