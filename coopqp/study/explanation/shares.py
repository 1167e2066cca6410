"""What holds back, by force: multipliers of the limits where the arms rest.

Where e' W e is least under closed loops and limits, with n_i the joint motion that breaks limit i,

    J' W e + J_c' lambda + sum mu_i n_i = 0,   mu_i >= 0

After projecting on Z = null(J_c) the mu_i are a non-negative least squares problem. The share of
limit i is mu_i |Z' n_i|.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from coopqp.base.qp import Row
from coopqp.base.spec import Array

#: A limit with a smaller share is idle, and never named.
IDLE = 0.01


@dataclass(frozen=True)
class Share:
    """The row of a limit, with its share of all limits' forces, 0 to 1."""

    row: Row
    share: float


def forces(pull: Array, Z: Array, ways: Sequence[tuple[Row, Array]]) -> list[tuple[Row, float]]:
    """mu_i |Z' n_i| of the limits that hold a pull back.

    Args:
        pull: where the tasks want to go, -Z' J' W e, shape (f,).
        Z: the motions that keep the loops closed, shape (n, f).
        ways: limits, each with the joint motion n_i that breaks it, shape (n,).
    """
    from scipy.optimize import nnls  # which takes a sixth of a second to come

    within = [(row, Z.T @ way) for row, way in ways]
    within = [(row, way) for row, way in within if np.linalg.norm(way) > 1e-9]
    if not within:
        return []
    columns = np.column_stack([way for _, way in within])
    amounts = nnls(columns, pull)[0] * np.linalg.norm(columns, axis=0)
    return [(row, float(amount)) for (row, _), amount in zip(within, amounts, strict=True)]


def shares(found: Iterable[tuple[Row, float]]) -> tuple[Share, ...]:
    """Of the limits' forces the largest first; a row may come more than once.

    Corners of one plane, and sides of one thing, count together.
    """
    by_thing: dict[str, float] = {}
    leader: dict[str, tuple[float, Row]] = {}
    for row, amount in found:
        thing = thing_of(row)
        by_thing[thing] = by_thing.get(thing, 0.0) + amount
        if amount > leader.get(thing, (-1.0, row))[0]:
            leader[thing] = amount, row
    total = max(sum(by_thing.values()), 1e-300)
    named = [Share(leader[thing][1], amount / total) for thing, amount in by_thing.items()]
    large = [share for share in named if share.share >= IDLE]
    return tuple(sorted(large, key=lambda share: -share.share))


def thing_of(row: Row) -> str:
    """What a row is a side or a corner of: a joint's own row, or the limit it belongs to."""
    return row.name if row.joint or row.side else row.owner
