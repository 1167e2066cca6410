"""Rank, null space and independent rows of a matrix, all by one tolerance.

A singular value counts as zero below ``RANK_TOLERANCE`` of the largest. What is regular here and
what is redundant is then the same for the loops, the mobility report, the dynamics and the QP.
"""

import numpy as np
import scipy.linalg
from scipy.linalg import lapack

from coopqp.base.spec import Array

#: Singular values below this share of the largest count as zero.
RANK_TOLERANCE = 1e-8

_TINY = 1e-300  # a matrix of zeros has rank zero, whatever the share


def matrix_rank(matrix: Array, tolerance: float = RANK_TOLERANCE) -> int:
    """How many rows of a matrix are independent."""
    if not matrix.size:
        return 0
    values = np.linalg.svd(matrix, compute_uv=False)
    return int(np.count_nonzero(values > tolerance * values[0]))


def null_space(matrix: Array) -> Array:
    """Orthonormal basis of the null space of a matrix (m, n), shape (n, n - rank).

    By pivoted QR of the transpose, several times as fast as a singular value decomposition.
    """
    if not len(matrix):
        return np.identity(matrix.shape[1])
    if not np.isfinite(matrix).all():
        raise np.linalg.LinAlgError("null_space: the matrix has NaN or infinite values")
    n, (reflectors, _, tau, _, _) = matrix.shape[1], lapack.dgeqp3(matrix.T)
    rank = _rank(reflectors.diagonal())
    last = np.eye(n, n - rank, -rank, order="F")
    basis, _, _ = lapack.dormqr("L", "N", reflectors[:, : len(tau)], tau, last, 64 * n)
    return np.asarray(basis)


def directions(rows: Array) -> tuple[Array, Array]:
    """Singular values, those that are none as zeros, and orthonormal directions that have them.

    The rows are finite.
    """
    k, n = rows.shape
    values = np.zeros(n)
    if not rows.size:
        return values, np.identity(n)
    _, values[: min(k, n)], Vt, _ = lapack.dgesdd(rows)
    return values, Vt


def independent_rows(matrix: Array, max_rows: int | None = None) -> list[int]:
    """Indices of a largest set of independent rows, in their own order, by pivoted QR."""
    if not matrix.size:
        return []
    _, R, order = scipy.linalg.qr(matrix.T, mode="economic", pivoting=True)
    rank = _rank(np.diag(R))
    return sorted(int(i) for i in order[: rank if max_rows is None else min(rank, max_rows)])


def _rank(diagonal: Array) -> int:
    """Of a pivoted QR, whose diagonal falls in size."""
    sizes = np.abs(diagonal)
    return int(np.count_nonzero(sizes > RANK_TOLERANCE * max(sizes[0], _TINY)))


def least_squares(matrix: Array, wanted: Array) -> Array:
    """The least-norm x with matrix x nearest to ``wanted`` (m,) or (m, r); NaN if not finite."""
    if not (np.isfinite(matrix).all() and np.isfinite(wanted).all()):
        return np.full((matrix.shape[1], *wanted.shape[1:]), np.nan)
    return np.asarray(np.linalg.lstsq(matrix, wanted, rcond=RANK_TOLERANCE)[0], float)
