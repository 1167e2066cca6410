"""The formulas of the QP's matrices, arrays in and out.

Letters: n joints, k task rows, m loop rows; w their weights.
"""

from __future__ import annotations

import numpy as np

from coopqp.checked import Array


def normal_equations(J: Array, w: Array, wanted: Array, damping: float, P: Array, q: Array) -> None:
    """Write sum_i w_i (J_i v - wanted_i)^2 + damping |v|^2 as 1/2 v' P v + q' v, halved.

    Args:
        J: task Jacobian, shape (k, n).
        w: weights, shape (k,).
        wanted: J v that is asked for, shape (k,).
        damping: cost of |v|^2.
        P: written, J' W J + damping I, shape (n, n).
        q: written, -J' W wanted, shape (n,).
    """
    weighted = J * w[:, None]
    P[:] = weighted.T.dot(J)
    add_damping(P, damping)
    np.negative(wanted.dot(weighted), out=q)


def add_damping(P: Array, damping: float | Array) -> None:
    """Add to the diagonal of P, shape (n, n); one number for all joints or one each."""
    diagonal = np.einsum("ii->i", P)
    diagonal += damping


def loop_rows(J_loop: Array, e_loop: Array, kappa: float, A: Array, b: Array) -> None:
    """Write J_c v = -kappa e, eq. (14) with the drift correction.

    Args:
        J_loop: shape (m, n).
        e_loop: loop error, shape (m,).
        kappa: gain of the drift correction [1/s].
        A: written, shape (m, n).
        b: written, shape (m,).
    """
    A[:] = J_loop
    np.multiply(e_loop, -kappa, out=b)
