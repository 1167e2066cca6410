"""Every limit with settings of an example, and how tests look at its rows and margins."""

from __future__ import annotations

import numpy as np
from laws import DT

from coopqp import limits
from coopqp.base.qp import Row
from coopqp.base.spec import Array
from coopqp.limit import Limit, LimitRows
from coopqp.limits.obstacles import RoundSize
from coopqp.model.closed_chain import ClosedChain
from coopqp.trace import Trace

TABLE = limits.Workspace(
    name="table", normal=(0, 0, 1), through=(0, 0, -0.02), frames=("RHand", "LHand")
)
SHELF = limits.Obstacles(
    shapes={
        "shelf": limits.Obstacle(
            box=(0.3, 0.1, 0.02), position=(0.2, 0.25, 0.1), rpy_deg=(10.0, 0.0, 0.0)
        ),
        "post": limits.Obstacle(
            cylinder=RoundSize(radius=0.03, length=0.4), position=(0.3, 0.0, 0.0)
        ),
        "ball": limits.Obstacle(sphere=0.04, position=(0.2, -0.25, 0.1)),
    }
)
EXAMPLES: tuple[Limit, ...] = (
    limits.JointPosition(),
    limits.JointVelocity(),
    limits.JointAcceleration(max=60.0),
    limits.ObjectSpeed(linear=0.15, angular=1.0),
    TABLE,
    limits.SelfCollision(),
    limits.FollowingError(),
    SHELF,
)
#: What a limit may be off by after a step: second order in the step for curved things.
TOLERANCE = {
    "table": 1e-6,
    "self_collision": 1e-6,
    "obstacles": 1e-6,
    "object_speed": 1e-6,
    "acceleration": 1e-6,
}


def least(limit: Limit, chain: ClosedChain, done: Trace) -> float:
    """Least margin of a limit over a run."""
    return min(float(m.min()) for m in limit.margins(chain, done.q, done.v, DT).values())


def empty_rows(chain: ClosedChain, limit: Limit) -> LimitRows:
    n, p = chain.n, len(limit.rows(chain))
    return LimitRows(np.full(n, -8.0), np.full(n, 8.0), np.full((p, n), np.nan), np.full(p, np.nan))


def by_name(margins: dict[Row, Array]) -> dict[str, Array]:
    """Margins by the names of their rows, each of which stands once."""
    named = {row.name: margin for row, margin in margins.items()}
    assert len(named) == len(margins)
    return named
