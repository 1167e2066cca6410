"""A grasp that holds by pressing with a fingertip: it bears forces and no torques."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from coopqp.base.spec import Array, spec
from coopqp.grasp import NO_CONTACT, Contact, PassiveJoint, ball
from coopqp.grasps._families import Pressing

#: The ball's hinges are singular where the second has turned by a quarter [rad].
CONE = 1.4


@dataclass(frozen=True, kw_only=True)
class Fingertip(Contact):
    """A point that presses, with so many edges of the pyramid inside Coulomb's cone."""

    edges: int = 8

    def rows(self, friction: float) -> Array:
        """A row a face; between two edges, of which one is along x, cos(pi / edges) is left."""
        step = 2.0 * math.pi / self.edges
        faces = step * (np.arange(self.edges) + 0.5)
        rows = np.zeros((self.edges, 6))
        rows[:, 0], rows[:, 1] = np.cos(faces), np.sin(faces)
        rows[:, 2] = -friction * math.cos(0.5 * step)
        return rows

    def friction_needed(self, wrench: ArrayLike) -> float:
        w = np.asarray(wrench, float)
        return math.hypot(w[0], w[1]) / float(w[2]) if w[2] > NO_CONTACT else math.inf

    def edge_use(self, wrench: ArrayLike) -> float:
        return math.nan


@spec
class PointContact(Pressing):
    """Fingertip: holds by pressing at a point; the object turns freely about it."""

    edges: Annotated[int, Field(ge=4, le=32)] = 8
    """Of the pyramid that stands for the cone; at worst it loses 1 - cos(pi / edges), 8 %."""

    def passive_joints(self, R_WT: Array) -> tuple[PassiveJoint, ...]:
        return ball(self.position, CONE)

    @property
    def contact(self) -> Contact:
        return Fingertip(**self.pressed(), edges=self.edges)
