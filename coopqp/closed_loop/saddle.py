"""The saddle-point system of a closed chain's dynamics, solved without choosing coordinates."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import lapack

from coopqp.base.rank import least_squares
from coopqp.base.spec import Array

#: Reciprocal condition number below which a system counts as singular.
SINGULAR = 1e-12
#: With all pivots above this share of the norm it is far from that; of a singular system the least
#: one is left by rounding. LAPACK's estimate takes twice as long as all the rest.
PIVOT = 1e-6


class Saddle:
    """A matrix [top right; left corner], factored by LAPACK without leaving preallocated arrays.

    Args:
        n: rows of top. m: rows of left.

    Attributes:
        corner: zero until it is written, shape (m, m), as are the others.
    """

    def __init__(self, n: int, m: int) -> None:
        self._K = np.zeros((n + m, n + m), order="F")
        self._flat = self._K.reshape(-1, order="F")
        self.top, self.right, self.left = self._K[:n, :n], self._K[:n, n:], self._K[n:, :n]
        self.corner = self._K[n:, n:]

    def solve(self, rhs: Array) -> tuple[Array, bool]:
        """Solution, and whether the matrix is singular, so that it is one of least squares."""
        if not len(rhs):  # one arm alone has no wrenches to tell; LAPACK minds
            return rhs, False
        lu, pivots, info = lapack.dgetrf(self._K)
        if info == 0 and self._regular(lu):
            return lapack.dgetrs(lu, pivots, rhs)[0], False
        return least_squares(self._K, rhs), True

    def _regular(self, lu: Array) -> bool:
        # The Frobenius norm stands for the 1-norm: a factor, not a magnitude.
        norm = math.sqrt(self._flat.dot(self._flat))
        if np.abs(lu.diagonal()).min() > PIVOT * norm:
            return True
        return bool(lapack.dgecon(lu, norm)[0] > SINGULAR)
