"""The object that all arms hold."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array, Lengths3, NonNegative, Pose, Vector3, Vector6, spec


def inertia_matrix(six: Sequence[float]) -> Array:
    """Symmetric matrix from ixx ixy ixz iyy iyz izz, shape (3, 3) [kg m2]."""
    xx, xy, xz, yy, yz, zz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def check_inertia(matrix: Array, what: str) -> None:
    """InvalidValueError: a principal moment is negative or exceeds the sum of the other two."""
    moments = np.linalg.eigvalsh(matrix)
    slack = 1e-9 * max(float(moments[-1]), 1e-12)
    if moments[0] < -slack or moments[2] > moments[0] + moments[1] + slack:
        raise InvalidValueError(
            f"{what}: principal moments {moments} kg m2 are impossible; each must be positive "
            "and at most the sum of the other two"
        )


@spec
class HeldObject:
    """The object that all arms hold: its size, mass and pose at the start."""

    size: Lengths3 = (0.08, 0.16, 0.08)
    """Edges of the box drawn for it, along its axes [m]."""
    mass: NonNegative = 0.2
    """[kg]"""
    com: Vector3 = (0.0, 0.0, 0.0)
    """Centre of mass in the object frame [m]."""
    inertia: Vector6 | None = None
    """ixx ixy ixz iyy iyz izz about the centre of mass [kg m2]; that of a solid box if omitted."""
    pose: Pose | None = None
    """Pose in the world at the start; midway between the hands, unturned, if omitted."""

    def __post_init__(self) -> None:
        if self.inertia is not None:
            check_inertia(inertia_matrix(self.inertia), "inertia")

    def body(self) -> pin.Inertia:
        """Mass properties in the object frame."""
        com = np.array(self.com)
        if self.inertia is None:
            return pin.Inertia(self.mass, com, pin.Inertia.FromBox(self.mass, *self.size).inertia)
        return pin.Inertia(self.mass, com, inertia_matrix(self.inertia))
