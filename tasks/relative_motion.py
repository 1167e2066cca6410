"""One arm carries its object frame to a pose relative to that of the first arm: six rows.

For arms whose loop is open, such as two hands about to meet, or a screwdriver and a screw. 0 is the
first arm, i the other, X_0i = (x, Q) the pose of i's object frame in 0's, at the identity where the
hands hold the object together:

    x = R_0'(p_i - p_0),   x_r = x_start + s (x_goal - x_start)
    Q = R_0' R_i,          Q_r = exp(s phi) Q_start,   Q_e = Q Q_r'

    e = [x - x_r; log Q_e]
    J = [R_0'(J_v,rel + [p_i - p_0]x J_omega,0); Jl^-1 R_0' J_omega,rel]
    rate = [x_r_dot; Jl^-1 Q_e s_dot phi]

J_rel = J_i - J_0 are the relative rows of eq. (29), Jl is the left Jacobian of SO(3) at log Q_e. A
loop that is closed contradicts every goal but the identity. Relative variables after Chiacchio,
Chiaverini and Siciliano 1996.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from coopqp.base.errors import UnknownNameError
from coopqp.base.spec import Pose, Positive, spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.geometry import Approach, Reference, RotationError
from coopqp.model.marker import Marker, RelativeMarker
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.program import Kind, Primitive
from coopqp.signal import POSE, Instant, MovingPose, quaternion_of, trajectory_of
from coopqp.task import Evaluate, Part, Task, TaskRows, pose_parts


@spec
class RelativeMotion(Task):
    """An arm's object frame goes to a pose relative to the first arm's (6 rows); loop open."""

    goal: MovingPose = Pose()
    """Of the arm's object frame in the first arm's; together as grasped if omitted."""
    arm: str | None = None
    """Which arm; the second if omitted."""
    profile: Profile = Profile()
    """How the reference moves from the start to the goal."""
    tolerance_angle: Positive = 5e-3
    """Orientation error at the end that still counts as reached [rad]."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """Translation along and rotation about the axes of the first arm's object frame."""
        return ("x", "y", "z", "rot_x", "rot_y", "rot_z")

    def parts(self, chain: ClosedChain) -> tuple[Part, ...]:
        return pose_parts(3, 3, self.tolerance, self.tolerance_angle)

    def bind(self, start: State) -> Evaluate:
        """The reference sets out from the relative pose now; no such arm: UnknownNameError."""
        chain, seen = start.chain, _Seen(start.chain, self._loop(start.chain))
        at, R_0, Q, gap = seen.at, seen.R_0, seen.Q, seen.gap
        first = np.linalg.inv(chain.mixing)[3:6]  # J_0 = J_task - sum alpha_i J_rel,i
        J_gap, J_omega_0 = np.zeros((3, chain.n)), np.zeros((3, chain.n))
        seen.update(start)
        here = np.concatenate([R_0.T @ gap, quaternion_of(Q)])
        goal = trajectory_of(self.goal, POSE, start, here)
        goal.update(start)
        p_goal, p_goal_dot = goal.value[:3], goal.rate[:3]
        rotation = RotationError(goal, self.profile, Q)
        approach = Approach(self.profile, R_0.T @ gap - p_goal)

        def evaluate(state: State, rows: TaskRows) -> None:
            seen.update(state)
            goal.update(state)
            e, J, rate, J_rel = rows.e, rows.J, rows.rate, state.J_rel[at : at + 6]
            R_0.T.dot(gap, e[:3])
            e[:3] -= p_goal
            first.dot(state.J_ext, J_omega_0)
            pin.skew(gap).dot(J_omega_0, J_gap)
            np.add(J_gap, J_rel[:3], J_gap)
            R_0.T.dot(J_gap, J[:3])
            rate[:3] = p_goal_dot
            approach.shift(state.t, e[:3], rate[:3])
            rotation.fill(state.t, Q, R_0.T, J_rel[3:], (e[3:], J[3:], rate[3:]))

        return evaluate

    def program(self, start: State) -> tuple[Primitive, ...] | None:
        """As a primitive; None where a signal is the goal."""
        goal, loop = trajectory_of(self.goal, POSE, start), self._loop(start.chain)
        if goal.moves:
            return None
        seen = _Seen(start.chain, loop)
        seen.update(start)
        x, y, z = goal.value[:3].tolist()
        return (
            Primitive(
                kind=Kind.RELATIVE, rows=tuple(range(6)), reference=Reference((x, y, z)),
                profile=self.profile, e_start=(seen.R_0.T @ seen.gap - goal.value[:3]).tolist(),
                phi=np.asarray(pin.log3(goal.R @ seen.Q.T)).tolist(), Q_start=seen.Q,
                numbers=(np.array([float(loop)]),),
            ),
        )  # fmt: skip

    def marks(self, at: Instant) -> tuple[Marker, ...]:
        goal = trajectory_of(self.goal, POSE, at)
        goal.update(at)
        return (RelativeMarker(rotation=goal.R, position=goal.value[:3]),)

    def _loop(self, chain: ClosedChain) -> int:
        others = [arm.name for arm in chain.arms[1:]]
        if self.arm is None:
            return 0
        if self.arm not in others:
            raise UnknownNameError("arm", self.arm, others, "relative_motion.arm: ").at("arm")
        return others.index(self.arm)


class _Seen:
    """R_0, Q = R_0' R_i, shapes (3, 3), and gap = p_i - p_0 in the world, shape (3,) [m]."""

    def __init__(self, chain: ClosedChain, loop: int) -> None:
        self.at, self._alpha = 6 * loop, chain.alpha[1:]
        self.R_0, self.Q, self.gap = np.eye(3), np.eye(3), np.zeros(3)

    def update(self, state: State) -> None:
        errors, at, R_0 = state.loop_error.reshape(-1, 6), self.at, self.R_0
        pin.exp3(-self._alpha.dot(errors[:, 3:])).dot(state.R_WO, R_0)
        self.gap[:] = state.loop_error[at : at + 3]
        turned = pin.exp3(state.loop_error[at + 3 : at + 6])  # R_i R_0'
        R_0.T.dot(turned.dot(R_0), self.Q)
