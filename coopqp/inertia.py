"""Inertia matrices from six numbers, and whether a body can have them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coopqp.checked import Array
from coopqp.errors import InvalidValueError


def inertia_matrix(six: Sequence[float]) -> Array:
    """Symmetric matrix from ixx ixy ixz iyy iyz izz, shape (3, 3) [kg m2]."""
    xx, xy, xz, yy, yz, zz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def check_inertia(matrix: Array, what: str) -> None:
    """Refuse an inertia no body can have: a negative or too large principal moment.

    Raises:
        InvalidValueError: a principal moment is negative or exceeds the sum of the other two.
    """
    moments = np.linalg.eigvalsh(matrix)
    slack = 1e-9 * max(float(moments[-1]), 1e-12)
    if moments[0] < -slack or moments[2] > moments[0] + moments[1] + slack:
        raise InvalidValueError(
            f"{what}: principal moments {moments} kg m2 are impossible; each must be positive "
            "and at most the sum of the other two"
        )
