"""The quadratic program of one tick; every variable and row says what it is.

    minimise  1/2 v' P v + q' v   subject to  A v = b,  G v <= h,  lb <= v <= ub

with the letters of qpsolvers. All constraints lie in one block, lower <= [I; C] v <= upper with
C = [G; A], so that solvers with either convention read it without a copy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coopqp.row import Row


@dataclass(frozen=True)
class Rows:
    """What the QP's variables and rows are.

    Attributes:
        variables: shape (n,), such as the velocity of RElbowRoll.
        inequalities: rows of G, shape (p,).
        equalities: rows of A, shape (m,), such as "loop[left].rot_y".
    """

    variables: tuple[Row, ...]
    inequalities: tuple[Row, ...] = ()
    equalities: tuple[Row, ...] = ()


class QP:
    """A quadratic program in preallocated arrays; G, h, A, b, lb, ub are views of C and bounds.

    Args:
        rows: fix the sizes: n variables, p inequality rows, m equality rows.

    Attributes:
        P: shape (n, n), symmetric. q: shape (n,).
        C: [G; A], shape (p + m, n).
        lower, upper: of [v; G v; A v], shape (n + p + m,).
    """

    def __init__(self, rows: Rows) -> None:
        n, p, m = len(rows.variables), len(rows.inequalities), len(rows.equalities)
        self.rows = rows
        self.n, self.p, self.m = n, p, m
        self.P, self.q, self.C = np.eye(n), np.zeros(n), np.zeros((p + m, n))
        self.lower, self.upper = np.full(n + p + m, -np.inf), np.full(n + p + m, np.inf)
        self.G, self.A = self.C[:p], self.C[p:]
        self.h, self.b = self.upper[n : n + p], self.upper[n + p :]
        self.lb, self.ub = self.lower[:n], self.upper[:n]
        self._b_lower = self.lower[n + p :]

    def seal(self) -> None:
        """Copy b to the lower side; call it after b has been written."""
        self._b_lower[:] = self.b
