"""What holds back, by force: multipliers of the limits where the arms rest.

Where e' W e is least under closed loops and limits, with n_i the joint motion that breaks limit i,

    J' W e + J_c' lambda + sum mu_i n_i = 0,   mu_i >= 0

After projecting on Z = null(J_c) the mu_i are a non-negative least squares problem. The share of
limit i is mu_i |Z' n_i|.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coopqp.checked import Array
from coopqp.row import Row

#: A limit with a smaller share is idle, and never named.
IDLE = 0.01


@dataclass(frozen=True)
class Share:
    """How much of the force a limit has.

    Attributes:
        row: of the limit.
        share: of all limits' forces, 0 to 1.
    """

    row: Row
    share: float


def forces(pull: Array, ways: Sequence[Array]) -> Array:
    """mu_i |n_i| that hold a pull back, shape (len(ways),).

    Args:
        pull: where the tasks want to go, -Z' J' W e, shape (f,).
        ways: n_i within the loops, Z' n_i, each of shape (f,).
    """
    if not ways:
        return np.zeros(0)
    from scipy.optimize import nnls  # which takes a sixth of a second to come

    columns = np.column_stack(ways)
    mu, _ = nnls(columns, pull)
    return np.asarray(mu * np.linalg.norm(columns, axis=0), float)


def shares(rows: Sequence[Row], amounts: Array) -> tuple[Share, ...]:
    """The largest first; corners of one plane, and sides of one thing, count together.

    Args:
        rows: of the limits; more than once where several ticks are summed.
        amounts: of their forces.
    """
    by_thing: dict[str, float] = {}
    leader: dict[str, tuple[float, Row]] = {}
    for row, amount in zip(rows, amounts, strict=True):
        thing = thing_of(row)
        by_thing[thing] = by_thing.get(thing, 0.0) + float(amount)
        if amount > leader.get(thing, (-1.0, row))[0]:
            leader[thing] = float(amount), row
    total = sum(by_thing.values())
    if total <= 0.0:
        return ()
    found = [Share(leader[thing][1], amount / total) for thing, amount in by_thing.items()]
    named = [share for share in found if share.share >= IDLE]
    return tuple(sorted(named, key=lambda share: -share.share))


def thing_of(row: Row) -> str:
    """What a row is a side or a corner of: a joint's own row, or the limit it belongs to."""
    return row.name if row.joint or row.side else row.owner
