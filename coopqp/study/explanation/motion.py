"""What slows a run that geometry does not block: speed limits, the loops' budget, too little time.

In ticks in which the tasks were not followed, multipliers tell what held them back:

    minimise |Z' (J' W (wanted - J v) - sum mu_i n_i)|,   mu_i >= 0

with n_i the limits at their bound in that tick, Z the motions that keep the loops closed. Shares
mu_i |Z' n_i| are summed over the ticks, each by |J v - wanted|.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coopqp.study.explanation.asked import Ticks
from coopqp.study.explanation.leg import Leg
from coopqp.study.explanation.room import PLACE_UNITS
from coopqp.study.explanation.shares import Share, shares

#: Most ticks that are looked at, and what a tick is off by to count [m/s, rad/s].
TICKS, BEHIND = 150, 1e-3


def held_up(leg: Leg, ticks: range | None = None) -> tuple[Share, ...]:
    """Which limits held a run up on its way, the largest share first.

    Args:
        leg: of a law that commands velocities.
        ticks: all of them when None.
    """
    look = Ticks(leg)
    behind = _behind(look, ticks or range(len(leg.v)))
    return shares(force for k in behind for force in look.forces(k))


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


def _behind(look: Ticks, ticks: range) -> list[int]:
    """Ticks in which the tasks were not followed, not more than can be looked at."""
    some = ticks[:: max(1, len(ticks) // TICKS)]
    return [k for k in some if np.abs(look.look(k)).max(initial=0.0) > BEHIND]
