"""Internal forces of three hands as pushes along the edges between them.

The virtual linkage of Williams and Khatib 1993: a telescope along each edge of the triangle of
hands. E (9, 3) has a column an edge, the unit vector e_ij at hand i and its opposite at hand j, so
that t > 0 presses hands i and j towards each other. Forces f = (f_1; f_2; f_3) split into

    f = W_f^+ F + E t,   t = E^+ f

with W_f the grasp matrix of forces alone: its null space is the range of E. Torques that the hands
bear, all nine, count as internal. On one line E has rank 2 and the split does not exist.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coopqp.base.errors import GraspError
from coopqp.base.spec import Array

#: The edges, by hands.
EDGES = ((0, 1), (0, 2), (1, 2))
#: Three hands are on one line where the triangle is flatter than this, as height over length.
FLAT = 1e-3


@dataclass(frozen=True)
class VirtualLinkage:
    """The edges between three hands.

    Attributes:
        E: forces at the hands for pushes along the edges, shape (9, 3).
        rows: from (f_1; f_2; f_3) to the pushes t [N], shape (3, 9).
    """

    E: Array
    rows: Array


def virtual_linkage(points: Array) -> VirtualLinkage:
    """The linkage of three hands.

    Args:
        points: of the hands in the world, shape (3, 3) [m].

    Raises:
        GraspError: the hands are on one line, or not three.
    """
    p = np.asarray(points, float)
    if p.shape != (3, 3):
        raise GraspError(f"the virtual linkage is of 3 hands; found {len(p)}")
    if (flat := flatness(p)) < FLAT:
        raise GraspError(
            f"three hands are on one line (height {flat:.1g} of the length between them): pushes "
            "along their edges are not independent; move one hand off the line, or ask for the "
            "internal wrench of a pair of two arms"
        )
    E = np.zeros((9, 3))
    for k, (i, j) in enumerate(EDGES):
        e = (p[j] - p[i]) / np.linalg.norm(p[j] - p[i])
        E[3 * i : 3 * i + 3, k], E[3 * j : 3 * j + 3, k] = e, -e
    return VirtualLinkage(E, np.asarray(np.linalg.pinv(E), float))


def flatness(points: Array) -> float:
    """Height of a triangle over its longest side; zero on one line."""
    p = np.asarray(points, float)
    longest = max(float(np.linalg.norm(p[j] - p[i])) for i, j in EDGES)
    area = float(np.linalg.norm(np.cross(p[1] - p[0], p[2] - p[0])))
    return area / longest**2 if longest else 0.0
