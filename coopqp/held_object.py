"""The object that all arms hold."""

from __future__ import annotations

from typing import Annotated

import numpy as np
import pinocchio as pin
from pydantic import BeforeValidator

from coopqp.checked import Lengths3, NonNegative, Pose, Vector3, numbers, spec
from coopqp.inertia import check_inertia, inertia_matrix

Six = Annotated[
    tuple[float, float, float, float, float, float], BeforeValidator(lambda v: numbers(v, 6))
]


@spec
class HeldObject:
    """The object that all arms hold: its size, mass and pose at the start."""

    size: Lengths3 = (0.08, 0.16, 0.08)
    """Edges of the box drawn for it, along its axes [m]."""
    mass: NonNegative = 0.2
    """[kg]"""
    com: Vector3 = (0.0, 0.0, 0.0)
    """Centre of mass in the object frame [m]."""
    inertia: Six | None = None
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
