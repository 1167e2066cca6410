"""The object goes to a pose: six rows.

The reference goes straight and turns about one axis, phi = log(R_goal R_start'):

    p_r = p_start + s (p_goal - p_start),   R_r = exp(s phi) R_start

With R_e = R R_r' and Jl the left Jacobian of SO(3),

    e = [p - p_r; log R_e],   J = [J_v; Jl^-1 J_omega],   rate = [p_r_dot; Jl^-1 R_e s_dot phi]
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from coopqp.closed_chain import ClosedChain
from coopqp.grasp import pose_matrix
from coopqp.profile import Profile
from coopqp.spec import Pose as PoseValue
from coopqp.spec import Positive, spec
from coopqp.state import State
from coopqp.task import Evaluate, Part, Task, TaskRows


@spec
class Pose(Task):
    """The object goes to a pose (6 rows); needs six degrees of freedom of the object."""

    goal: PoseValue
    """Of the object, in the world."""
    profile: Profile = Profile()
    """How the reference moves from the start to the goal."""
    tolerance_angle: Positive = 5e-3
    """Orientation error at the end that still counts as reached [rad]."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """Translation along and rotation about the world axes."""
        return ("x", "y", "z", "rot_x", "rot_y", "rot_z")

    def parts(self, chain: ClosedChain) -> tuple[Part, ...]:
        """Position and orientation."""
        return (
            Part("position", 3, "m", self.tolerance),
            Part("orientation", 3, "rad", self.tolerance_angle),
        )

    @property
    def end(self) -> float:
        """When the reference arrives [s]."""
        return self.profile.end

    def bind(self, start: State) -> Evaluate:
        """The reference sets out from where the object is now."""
        goal, profile = pose_matrix(self.goal), self.profile
        p_start, R_start = start.p_WO.copy(), start.R_WO.copy()
        way = goal.translation - p_start
        phi = pin.log3(goal.rotation @ R_start.T)

        def evaluate(state: State, rows: TaskRows) -> None:
            share, speed = profile.at(state.t)
            R_e = state.R_WO.dot((pin.exp3(share * phi).dot(R_start)).T)
            # pinocchio's Jlog3 takes body velocities; R_e' turns world ones into them.
            Jl_inv = pin.Jlog3(R_e).dot(R_e.T)
            np.subtract(state.p_WO, p_start + share * way, rows.e[:3])
            rows.e[3:] = pin.log3(R_e)
            rows.J[:3] = state.J_task[:3]
            Jl_inv.dot(state.J_task[3:], rows.J[3:])
            rows.rate[:3] = speed * way
            rows.rate[3:] = Jl_inv.dot(R_e.dot(speed * phi))

        return evaluate
