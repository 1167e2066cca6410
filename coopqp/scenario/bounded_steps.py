"""Least squares inside bounds: Levenberg-Marquardt whose steps are QPs.

With r(x) the residual, J its Jacobian and mu the damping, a step d solves

    minimise    |r + J d|^2 + mu |d|^2
    subject to  lower <= x + d <= upper,   |d_i| <= max_step,   G d <= h

and is taken when |r|^2 falls; mu grows when it does not and shrinks when it does.
scipy's trf has no rows G, and closes fewer starts of redundant arms in more time.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from coopqp.base.qp import QP, Row, Rows
from coopqp.base.spec import Array
from coopqp.solver import Solution
from coopqp.solvers import Daqp

#: Damping mu at first, at least and at most, in units of J'J.
DAMPING, MIN_DAMPING, MAX_DAMPING = 1e-3, 1e-11, 1e3

#: The search has ended when a step changes |r|^2 by less than this share.
STUCK = 1e-6

Residual = Callable[[Array], tuple[Array, Array]]
"""From x to r and J, shapes (k,) and (k, n)."""

Inequalities = Callable[[Array], tuple[Array, Array]]
"""From x to G and h of G d <= h, shapes (p, n) and (p,); h >= 0, so that d = 0 is allowed."""


@dataclass(frozen=True)
class Stop:
    """When a search ends: after so many steps, with a residual small enough, or stuck."""

    steps: int
    max_step: float  # of a variable
    enough: Callable[[Array], bool]  # whether the residual is
    stuck: float = STUCK  # least share of change of |r|^2


class BoundedSteps:
    """Steps in n variables with p inequalities."""

    def __init__(self, n: int, p: int = 0) -> None:
        variables = tuple(Row(name=f"x[{i}]", kind="joint") for i in range(n))
        inequalities = tuple(Row(name=f"row[{i}]", kind="limit") for i in range(p))
        self._qp = QP(Rows(variables, inequalities))
        self._solution = Solution(self._qp)
        self._solve = Daqp().open(self._qp, self._solution)

    def descend(
        self,
        x: Array,
        residual: Residual,
        bounds: tuple[Array, Array],
        stop: Stop,
        inequalities: Inequalities | None = None,
    ) -> Array:
        """Move x, (n,), inside its bounds down to a small residual, which is returned."""
        mu = DAMPING
        r, J = residual(x)
        for _ in range(stop.steps):
            if stop.enough(r) or mu > MAX_DAMPING:
                break
            curvature, slope = J.T @ J, J.T @ r
            self._limit(x, bounds, stop.max_step)
            if inequalities:
                self._qp.G[:], self._qp.h[:] = inequalities(x)
            while mu <= MAX_DAMPING:
                trial = self.step(x, curvature, slope, np.full(len(x), mu), bounds)
                trial_r, trial_J = residual(trial)
                if trial_r @ trial_r < r @ r:
                    break
                mu *= 4.0
            else:
                break
            stuck = trial_r @ trial_r > (1.0 - stop.stuck) * (r @ r)
            x[:], r, J, mu = trial, trial_r, trial_J, max(mu / 5.0, MIN_DAMPING)
            if stuck:
                break
        return r

    def step(
        self,
        x: Array,
        curvature: Array,
        slope: Array,
        damping: Array,
        bounds: tuple[Array, Array],
        max_step: float | None = None,
    ) -> Array:
        """The best point of the quadratic model within ``max_step`` of x; x where there is none."""
        qp = self._qp
        if max_step is not None:
            self._limit(x, bounds, max_step)
        qp.P[:] = curvature
        qp.P.reshape(-1)[:: qp.n + 1] += damping
        qp.q[:] = slope
        self._solve()
        if not self._solution.status.usable:
            return x.copy()
        step = np.clip(self._solution.v, qp.lb, qp.ub)
        return np.asarray(np.clip(x + step, *bounds), float)

    def _limit(self, x: Array, bounds: tuple[Array, Array], max_step: float) -> None:
        np.maximum(bounds[0] - x, -max_step, out=self._qp.lb)
        np.minimum(bounds[1] - x, max_step, out=self._qp.ub)
