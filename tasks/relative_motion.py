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

import numpy as np

from coopqp.base.errors import require_known, under
from coopqp.base.spec import Pose, Positive, spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.geometry import PlaceOf, Reference
from coopqp.model.marker import Marker, RelativeMarker
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.program import Kind, Primitive, RelativePose
from coopqp.signal import POSE, Instant, MovingPose, quaternion_of, trajectory_of
from coopqp.task import Part, Task, pose_parts


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

    def program(self, start: State) -> tuple[Primitive, ...]:
        """The reference sets out from the relative pose now; no such arm: UnknownNameError."""
        loop = self._loop(start.chain)
        here = RelativePose(start.chain, loop)
        here.update(start)
        value = np.concatenate([here.R_0.T @ here.gap, quaternion_of(here.Q)])
        goal = trajectory_of(self.goal, POSE, start, value)
        return (
            Primitive(
                kind=Kind.RELATIVE, rows=tuple(range(6)), reference=Reference(PlaceOf(goal)),
                profile=self.profile, goal=goal, loop=loop,
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
        with under("arm"):
            require_known("arm", [self.arm], others, "relative_motion.arm: ")
        return others.index(self.arm)
