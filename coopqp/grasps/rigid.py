"""A firm grasp: hand and object move as one body."""

from coopqp.base.spec import Array, spec
from coopqp.grasp import Grasp, PassiveJoint


@spec
class Rigid(Grasp):
    """Firm grasp: no motion between hand and object (paper, sections 2 to 5.2)."""

    def passive_joints(self, R_WT: Array) -> tuple[PassiveJoint, ...]:
        return ()
