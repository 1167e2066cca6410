"""A grasp that lets the object turn every way about one point of the hand.

The ball is three hinges about x, y, z of the hand, one after the other, so that each has one
coordinate. It is singular where the second has turned by a quarter; limits keep it off.
"""

import math

from coopqp.base.spec import Array, Positive, Vector3, spec
from coopqp.grasp import Grasp, PassiveJoint, ball


@spec
class Spherical(Grasp):
    """Ball: the object turns every way about a point of the hand."""

    point: Vector3 = (0.0, 0.0, 0.0)
    """The centre, in the hand [m]."""
    cone: Positive = 1.4
    """Each of the three angles goes this far both ways [rad]; below a quarter turn."""

    def __post_init__(self) -> None:
        if self.cone >= math.pi / 2:
            raise ValueError(f"needs a cone below a quarter turn, found {self.cone} rad")

    def passive_joints(self, R_WT: Array) -> tuple[PassiveJoint, ...]:
        return ball(self.point, self.cone)
