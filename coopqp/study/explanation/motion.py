"""What slows a run that geometry does not block: speed limits, the loops' budget, too little time.

In ticks in which the tasks were not followed, multipliers tell what held them back:

    minimise |Z' (J' W (wanted - J v) - sum mu_i n_i)|,   mu_i >= 0

with n_i the limits at their bound in that tick, Z the motions that keep the loops closed. Shares
mu_i |Z' n_i| are summed over the ticks, each by |J v - wanted|.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from coopqp.assessment.thresholds import AT_LIMIT
from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.limit import Limit, bound_rows
from coopqp.qp_law.bounds import Bounds
from coopqp.rank import null_space
from coopqp.row import Row
from coopqp.state import State
from coopqp.study.explanation.leg import Leg
from coopqp.study.explanation.room import PLACE_UNITS
from coopqp.study.explanation.shares import Share, forces, shares
from coopqp.task import TaskStack

#: Most ticks that are looked at, and what a tick is off by to count [m/s, rad/s].
TICKS, BEHIND = 150, 1e-3


class Ticks:
    """The ticks of a leg looked at again: limits at their bound, and what the tasks missed.

    Args:
        leg: of a law that commands velocities.

    Attributes:
        state: of the tick looked at last.
        stack: its tasks.
    """

    def __init__(self, leg: Leg) -> None:
        self._leg, problem = leg, leg.problem
        chain, dt = problem.chain, problem.dt
        self.state, self.stack = State(chain), TaskStack(problem.tasks, State(chain))
        self._limits = [
            (Bounds(chain, [k], State(chain), dt), _sides(k, chain)) for k in problem.limits
        ]

    def look(self, k: int) -> Array:
        """Bring all to tick k; what its tasks missed, wanted - J v."""
        state, leg = self.state, self._leg
        state.q[:], state.t = leg.q[k], k * leg.problem.dt
        state.v[:] = leg.v[k - 1] if k else 0.0
        state.inputs = leg.followed(k)
        state.update()
        self.stack.update(state)
        return np.asarray(self.stack.wanted - self.stack.J @ leg.v[k], float)

    def active(self, k: int) -> list[tuple[Row, Array]]:
        """Limits that the velocity of tick k is at, with the motion that breaks them."""
        v, chain = self._leg.v[k], self._leg.problem.chain
        tightest: dict[tuple[int, str], tuple[float, Row]] = {}
        found = []
        for bounds, sides in self._limits:
            bounds.update(self.state)
            for i, (lower, upper) in enumerate(sides):
                _tighter(tightest, (i, "lower"), v[i] - bounds.lb[i], lower)
                _tighter(tightest, (i, "upper"), bounds.ub[i] - v[i], upper)
            left = bounds.h - bounds.G @ v
            found += [(bounds.rows[i], bounds.G[i].copy()) for i in np.flatnonzero(left < AT_LIMIT)]
        for (i, side), (left, row) in tightest.items():
            if left < AT_LIMIT:
                way = np.zeros(chain.n)
                way[i] = -1.0 if side == "lower" else 1.0
                found.append((row, way))
        return found

    def forces(self, k: int) -> Iterator[tuple[Row, float]]:
        """What held tick k back, each limit with its force."""
        missed = self.look(k)
        Z = null_space(self.state.J_loop)
        pull = Z.T @ self.stack.J.T @ (self.stack.weights * missed)
        ways = [(row, Z.T @ way) for row, way in self.active(k)]
        ways = [(row, way) for row, way in ways if np.linalg.norm(way) > 1e-9]
        amounts = forces(pull, [way for _, way in ways])
        size = float(np.linalg.norm(missed))
        total = float(amounts.sum())
        for (row, _), amount in zip(ways, amounts.tolist(), strict=True):
            if total > 0.0:
                yield row, amount / total * size


def held_up(leg: Leg, ticks: range | None = None) -> tuple[Share, ...]:
    """Which limits held a run up on its way, the largest share first.

    Args:
        leg: of a law that commands velocities.
        ticks: all of them when None.
    """
    look, rows, amounts = Ticks(leg), [], []
    for k in _behind(leg, look, ticks or range(len(leg.v))):
        for row, amount in look.forces(k):
            rows.append(row)
            amounts.append(amount)
    return shares(rows, np.array(amounts))


def speed_share(shares: Sequence[Share]) -> float:
    """What limits of speeds and accelerations, and of no place, have of the force."""
    rates = (s for s in shares if not s.row.of_place and s.row.unit not in PLACE_UNITS)
    return sum(share.share for share in rates)


def speed_needed(leg: Leg, k: int, rows: slice) -> float:
    """Least share of the joints' speeds with which some rows could be followed at tick k.

    Infinite where the loops leave no such motion. A linear program: minimise the largest |v|/v_max
    under J_c v = 0 and J v = wanted.
    """
    from scipy.optimize import linprog  # which takes a sixth of a second to come

    look = Ticks(leg)
    look.look(k)
    J, most = look.stack.J[rows], leg.problem.chain.velocity
    known, n = np.isfinite(most), len(most)
    sides = np.vstack([np.eye(n)[known], -np.eye(n)[known]])
    G = np.hstack([sides, -np.tile(most[known], 2)[:, None]])
    loops = look.state.J_loop
    A = np.hstack([np.vstack([loops, J]), np.zeros((len(loops) + len(J), 1))])
    b = np.concatenate([np.zeros(len(loops)), look.stack.wanted[rows]])
    cost = np.concatenate([np.zeros(n), [1.0]])
    found = linprog(cost, A_ub=G, b_ub=np.zeros(len(G)), A_eq=A, b_eq=b, bounds=(None, None))
    return float(found.fun) if found.success else np.inf


def _behind(leg: Leg, look: Ticks, ticks: range) -> list[int]:
    """Ticks in which the tasks were not followed, not more than can be looked at."""
    some = ticks[:: max(1, len(ticks) // TICKS)]
    return [k for k in some if np.abs(look.look(k)).max(initial=0.0) > BEHIND]


def _sides(limit: Limit, chain: ClosedChain) -> list[tuple[Row, Row]]:
    """What its lower and upper bound of each joint are called."""
    lower, upper = (bound_rows(limit, chain, side) for side in ("lower", "upper"))
    return list(zip(lower, upper, strict=True))


def _tighter(
    found: dict[tuple[int, str], tuple[float, Row]], key: tuple[int, str], left: float, row: Row
) -> None:
    if left < found.get(key, (np.inf, row))[0]:
        found[key] = left, row
