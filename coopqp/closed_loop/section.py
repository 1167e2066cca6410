"""What two hands do to each other, in words that people use: squeeze, shear, twist and bend.

With c the middle between two hands at p_1, p_2 and e the direction from hand 1 to hand 2, what the
cut through the middle transmits is the section wrench (Uchiyama and Dauchez 1988)

    s = (h_1 at c - h_2 at c) / 2

    squeeze   s_f . e      [N]      > 0 presses the object
    shear     s_f across e [N]      the hands slide past each other
    twist     s_m . e      [N m]    they turn against each other about e
    bend      s_m across e [N m]    they tilt against each other

It is what the relative twist V_1 - V_2 works on: the hands' power is w . (V_1 + V_2)/2 +
s . (V_1 - V_2). With equal shares it is Walker's internal wrench. With h_1 + h_2 = 0 at c,

    m_1 + m_2 = (p_2 - p_1) x s_f,   (m_1 - m_2)/2 = s_m

The two directions across e are up, the world's z less its part along e, and e x up. Where e is
within some degrees of the vertical, the world's x stands for up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coopqp.base.errors import GraspError
from coopqp.base.spec import Array
from coopqp.closed_loop.grasp_matrix import grasp_matrix

#: The rows of a section wrench, and their units.
COMPONENTS = ("squeeze", "shear_up", "shear_side", "twist", "bend_up", "bend_side")
UNITS = ("N", "N", "N", "N m", "N m", "N m")
#: Hands that are nearer to each other have no direction between them [m].
NEAREST = 1e-3
#: Where "up" has less than this of it across e, x stands for it.
STEEP = 0.1


@dataclass(frozen=True)
class Section:
    """The cut through the middle between two hands.

    Attributes:
        middle: c, shape (3,) [m].
        axes: rows e, up and e x up, shape (3, 3).
        length: between the hands [m].
        rows: from (h_1; h_2), each at its hand, to the components, shape (6, 12).
    """

    middle: Array
    axes: Array
    length: float
    rows: Array

    def of(self, h: Array) -> Array:
        """The components of what two hands do.

        Args:
            h: wrenches of both hands at their points, shape (2, 6) or (12,) [N, N m].
        """
        return np.asarray(self.rows @ np.ravel(h), float)


def section(p_1: Array, p_2: Array) -> Section:
    """The section between two hands.

    Args:
        p_1: the first hand's point in the world, shape (3,) [m].
        p_2: the other's.

    Raises:
        GraspError: the hands are in one place.
    """
    way = np.asarray(p_2, float) - p_1
    length = float(np.linalg.norm(way))
    if not length > NEAREST:
        raise GraspError(
            f"two hands are {1e3 * length:.2g} mm apart: there is no direction between them"
        )
    axes, middle = across(way / length), np.asarray(p_1 + 0.5 * way, float)
    turned = np.kron(np.eye(2), axes)
    at_middle = grasp_matrix([p_1, p_2], middle)
    rows = np.asarray(0.5 * turned @ np.hstack([at_middle[:, :6], -at_middle[:, 6:]]), float)
    return Section(middle, axes, length, rows)


def across(e: Array) -> Array:
    """Rows e, up and e x up of a unit direction, shape (3, 3)."""
    up = np.array([0.0, 0.0, 1.0]) - e[2] * e
    if np.linalg.norm(up) < STEEP:
        up = np.array([1.0, 0.0, 0.0]) - e[0] * e
    up /= np.linalg.norm(up)
    return np.array([e, up, np.cross(e, up)])
