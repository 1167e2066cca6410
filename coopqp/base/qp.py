"""The quadratic program of one tick; every variable and row says what it is.

    minimise  1/2 v' P v + q' v   subject to  A v = b,  G v <= h,  lb <= v <= ub

with the letters of qpsolvers. All constraints lie in one block, lower <= [I; C] v <= upper with
C = [G; A], so that solvers with either convention read it without a copy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal

import numpy as np

Kind = Literal["joint", "share", "loop", "task", "limit", "free", "dynamics", "motor", "hand"]
Side = Literal["lower", "upper"]

DEPENDENT = 1e-12  # singular value of rows that depend on each other, as a share of the largest


@dataclass(frozen=True, kw_only=True)
class Row:
    """One variable, equality, inequality or bound."""

    name: str  #: For people, such as "limit.position[RElbowRoll].upper".
    kind: Kind  #: What it belongs to.
    owner: str = ""  #: Which one of the kind: an arm for a loop, a task's or a limit's name.
    unit: str = ""  #: Of what it bounds or asks for, such as "rad" or "m/s".
    joint: str = ""  #: Whose, where it belongs to one joint.
    side: Side | None = None  #: Which, where there are two.
    label: str = ""  #: What a sentence calls it, such as "RElbowRoll (upper)"; the name if omitted.
    #: Whether it bounds a place: its violation in a QP of velocities, times dt, has the unit given.
    of_place: bool = False
    bodies: tuple[str, ...] = ()  #: The two whose distance it is; none for other rows.
    #: Distance that is kept free between them [m]; rows that differ in it alone are equal.
    kept: float = field(default=0.0, compare=False)

    def __post_init__(self) -> None:
        if not self.label:
            object.__setattr__(self, "label", self.name)

    def __str__(self) -> str:
        return self.name


def names_of(rows: Sequence[Row]) -> tuple[str, ...]:
    """The names of rows, in their order."""
    return tuple(row.name for row in rows)


@lru_cache(maxsize=64)
def joint_rows(joints: tuple[str, ...], units: tuple[str, ...]) -> tuple[Row, ...]:
    """The velocities of joints, the variables of most QPs; units of q, "rad" or "m"."""
    return tuple(
        Row(name=joint, kind="joint", unit=f"{unit}/s", joint=joint)
        for joint, unit in zip(joints, units, strict=True)
    )


@dataclass(frozen=True)
class Rows:
    """What the QP's variables (n), rows of G (p) and rows of A (m) are."""

    variables: tuple[Row, ...]
    inequalities: tuple[Row, ...] = ()
    equalities: tuple[Row, ...] = ()


class QP:
    """A quadratic program in preallocated arrays; G, h, A, b, lb, ub are views of C and bounds.

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

    def orthogonalize(self) -> None:
        """Make A, which is finite, orthonormal by a diagonal P: solvers see which rows depend."""
        root = np.sqrt(self.P.diagonal())
        U, sizes, Vt = np.linalg.svd(self.A / root, full_matrices=False)
        rank = int(np.count_nonzero(sizes > DEPENDENT * sizes.max(initial=0.0)))
        b = U.T.dot(self.b)[:rank] / sizes[:rank]
        self.A[rank:], self.b[rank:] = 0.0, 0.0
        self.A[:rank], self.b[:rank] = Vt[:rank] * root, b
