"""The limits of one problem as bounds and inequality rows on the velocity."""

import itertools
from collections.abc import Sequence

import numpy as np

from coopqp.base.qp import Row
from coopqp.limit import Limit, LimitRows, Tighten
from coopqp.model.state import State
from coopqp.task import evaluate_all


class Bounds:
    """lb <= v <= ub (n,) and G v <= h (p,), as limits have them at the last update; rows of G.

    C = [I; G; -I] has all of them as C v <= [ub; h; -lb]. Limits tighten in the order given;
    constant ones are evaluated at ``start``. ``position_time`` is the time in which a position
    bound may be reached, when that is not dt [s].
    """

    def __init__(
        self, limits: Sequence[Limit], start: State, dt: float, position_time: float | None = None
    ) -> None:
        chain = start.chain
        by_limit = [limit.rows(chain) for limit in limits]
        self.rows: tuple[Row, ...] = tuple(itertools.chain.from_iterable(by_limit))
        n, p = chain.n, len(self.rows)
        self.lb, self.ub, self.h = np.full(n, -np.inf), np.full(n, np.inf), np.full(p, np.inf)
        self.C = np.concatenate([np.eye(n), np.zeros((p, n)), -np.eye(n)])
        self.G = self.C[n : n + p]
        self._each_tick: list[tuple[Tighten, LimitRows]] = []
        self._kept: list[tuple[Tighten, LimitRows]] = []
        ends = itertools.accumulate(map(len, by_limit), initial=0)
        for limit, (first, last) in zip(limits, itertools.pairwise(ends), strict=True):
            block = LimitRows(self.lb, self.ub, self.G[first:last], self.h[first:last])
            tighten = limit.bind(chain, (position_time or dt) if limit.bounds_position else dt)
            if limit.constant:
                tighten(start, block)
            else:
                self._each_tick.append((tighten, block))
                if not limit.sacrificed_first:
                    self._kept.append((tighten, block))
        self._constant = self.lb.copy(), self.ub.copy(), self.G.copy(), self.h.copy()

    def update(self, state: State, *, accelerations: bool = True) -> None:
        """Ask the limits that change, those of accelerations among them or not."""
        self.lb[:], self.ub[:], self.G[:], self.h[:] = self._constant
        evaluate_all(self._each_tick if accelerations else self._kept, state)

    def release(self, state: State) -> bool:
        """Leave out acceleration limits, and ask for no motion; whether there are such limits."""
        self.update(state, accelerations=False)
        np.maximum(self.h, 0.0, out=self.h)
        return len(self._kept) < len(self._each_tick)
