"""A grasp that holds by pressing with a flat pad: friction bears the rest, and nothing pulls."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field

from coopqp.base.spec import Array, Direction, NonNegative, Positive, Vector3, spec
from coopqp.grasp import REACH, Contact, Grasp, PassiveJoint
from coopqp.grasps._pad import Pad
from coopqp.grasps._placed import check_range, placed


@spec
class SurfaceContact(Grasp):
    """Flat pad: holds by pressing; friction bears what goes along it, and nothing pulls."""

    position: Vector3 = (0.0, 0.0, 0.0)
    """The pad's middle, in the hand [m]."""
    normal: Direction = (0.0, 0.0, 1.0)
    """Where it presses, in the hand; any length."""
    along: Direction | None = None
    """Direction of the first half-length, in the hand; across the normal if omitted."""
    half_lengths: tuple[Positive, Positive] = (0.03, 0.03)
    """Of the pad [m]."""
    friction: Positive = 0.5
    """Coefficient between pad and object."""
    least: NonNegative = 1.0
    """Normal force with which it is to press at least; what tilts it counts on the rest [N]."""
    most: Positive | None = None
    """Normal force that the object, or the hand, stands [N]; any if omitted."""
    torsion: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    """Share of the corners' yaw that it bears: 1 hard and level, about 0.5 soft."""
    reach: Annotated[float, Field(gt=0.0, le=1.0)] = REACH
    """Share of the half-lengths that controllers count on, so that pressure keeps off the edge."""

    def __post_init__(self) -> None:
        check_range(self.least, self.most)
        placed(self.position, self.normal, self.along)

    def passive_joints(self, R_WT: Array) -> tuple[PassiveJoint, ...]:
        """None: while it holds, hand and object move as one body."""
        return ()

    @property
    def contact(self) -> Contact:
        placement = placed(self.position, self.normal, self.along)
        return Pad(
            placement=placement,
            friction=self.friction,
            half_lengths=self.half_lengths,
            reach=self.reach,
            least=self.least,
            most=math.inf if self.most is None else self.most,
            torsion=self.torsion,
        )
