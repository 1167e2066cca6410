"""The fastest profile over a path's places: the passes of TOPP-RA, with the wrench among variables.

    backward   K_N = {end},  K_i = [min, max] of x with the rows and x + 2 ds u in K_i+1
    forward    x_0 = start,  x_i+1 = x_i + 2 ds max u

Interval i keeps the rows of both its ends, each with a wrench of its own (the interpolation scheme
of Pham and Pham 2018): what is exceeded between them is then O(ds^2), and u does not chatter where
the coefficient of u passes zero. Each step is a linear program, solved by daqp's dual active set.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import daqp
import numpy as np

from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.planning.closed_path import times
from coopqp.planning.path_constraints import Rows

#: daqp's settings, and those of further tries where it cycles or finds nothing by rounding.
TRIES: tuple[dict[str, float], ...] = (
    {"primal_tol": 1e-9, "dual_tol": 1e-12, "iter_limit": 1000},
    {"primal_tol": 1e-7, "iter_limit": 1000},
    {"primal_tol": 1e-7, "iter_limit": 1000, "eps_prox": 1e-3},
)
EQUALITY = 5  # daqp's sense of it
#: Unit of the wrench in the programs [N].
FORCE = 10.0
#: A row counts as at least this share of the widest [-].
NARROW = 0.01
#: Smaller coefficients are rounding, which daqp would divide by.
ROUNDING = 1e-12
#: Largest u in the programs, over the median x_max.
STEEPEST = 1e5
#: Largest share of a limit that is told from none.
MAX_SHARE = 1e6
#: Where x_i of the pass before is missed by rounding, so much less of it is tried.
LESS = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3)


class Stuck(Exception):  # noqa: N818 - not an error of users; the caller says what it means
    """No u at a place: its index, and the bounds of x there; NaN where there is none."""

    def __init__(self, place: int, lower: float = np.nan, upper: float = np.nan) -> None:
        super().__init__(place)
        self.place, self.lower, self.upper = place, lower, upper


def program(P: Array | None, q: Array, A: Array, upper: Array, lower: Array) -> Any:
    """The x of least x'Px/2 + q'x with lower <= (x; A x) <= upper, and multipliers, or None.

    Equal ends are equalities.
    """
    sense = (upper == lower).astype(np.intc) * EQUALITY
    for settings in TRIES:
        x, _, flag, info = daqp.solve(P, q, A, upper, lower, sense.copy(), **settings)
        if flag > 0:
            return x, info["lam"]
    return None if P is not None else _by_simplex(q, A, upper, lower)


def _by_simplex(q: Array, A: Array, upper: Array, lower: Array) -> Any:
    """The same by HiGHS, a hundred times as slow, where daqp fails for its rounding."""
    from scipy.optimize import Bounds, LinearConstraint, milp  # nobody else waits for it

    n = len(q)
    found = milp(
        q, bounds=Bounds(lower[:n], upper[:n]),
        constraints=LinearConstraint(A, lower[n:], upper[n:]),
    )  # fmt: skip
    return (found.x, np.zeros(len(upper))) if found.x is not None else None


@dataclass(frozen=True)
class Profile:
    """A motion along a path."""

    s: Array  # places, shape (N,)
    x: Array  # sdot^2 there, shape (N,)
    u: Array  # sddot between them, shape (N - 1,)
    max_x: Array  # largest sdot^2 from which the path can be followed, shape (N,)
    wrench: Array  # keeps the rows at both ends of each interval, shape (N - 1, 2, m) [N, N m]

    @cached_property
    def t(self) -> Array:
        """When it is at each place, shape (N,) [s]; a CoopqpError where it would stay at one."""
        rate = np.sqrt(np.maximum(self.x, 0.0))
        both = rate[1:] + rate[:-1]
        if not both.all():
            words = "the path cannot be followed: the motion stands still between its ends"
            raise CoopqpError(words)
        return np.concatenate([[0.0], np.cumsum(2.0 * np.diff(self.s) / both)])


class Passes:
    """The programs of a path's intervals, with shares of the bounds (N, r) and speeds (N,)."""

    def __init__(self, rows: Rows, share: Array, speed: Array) -> None:
        self._x = float(np.median(rows.x_max))
        N, r, m = rows.Rl.shape
        ds = np.diff(rows.s)
        x_max = speed**2 * rows.x_max
        lo, up = rows.lo_up(share)
        wide = np.where(np.isfinite(lo), 0.5 * (up - lo), np.abs(up))
        usual = np.maximum(wide.max(axis=0, initial=0.0), rows.maker.unit)
        scale = np.maximum(wide, NARROW * usual)[:, :, None]
        scale[scale == 0.0] = 1.0
        Ru, Rx = rows.R[:2, :, :, None] * self._x / scale
        Rl = rows.Rl * FORCE / scale
        lo, up = lo / scale[:, :, 0], up / scale[:, :, 0]
        self._A = np.zeros((N - 1, 1 + 2 * r, 2 + 2 * m))
        A, h = self._A, (2.0 * ds)[:, None, None]
        A[:, 0, 0], A[:, 0, 1] = 2.0 * ds, 1.0
        A[:, 1 : 1 + r, :1], A[:, 1 : 1 + r, 1:2], A[:, 1 : 1 + r, 2 : 2 + m] = (
            Ru[:-1], Rx[:-1], Rl[:-1]
        )  # fmt: skip
        A[:, 1 + r :, :1], A[:, 1 + r :, 1:2] = Ru[1:] + h * Rx[1:], Rx[1:]
        A[:, 1 + r :, 2 + m :] = Rl[1:]
        A[np.abs(A) < ROUNDING] = 0.0
        self._upper, self._lower = np.empty((2, N - 1, 3 + 2 * m + 2 * r))
        for sign, ends, out in ((1.0, up, self._upper), (-1.0, lo, self._lower)):
            out[:, 0], out[:, 2 : 2 + 2 * m] = sign * STEEPEST, sign * np.inf
            out[:, 3 + 2 * m : 3 + 2 * m + r], out[:, 3 + 2 * m + r :] = ends[:-1], ends[1:]
        self._upper[:, 1], self._lower[:, 1] = x_max[:-1] / self._x, 0.0
        self._next, self._x_max = 2 + 2 * m, x_max / self._x
        self._s, self._ds = rows.s, ds

    def profile(self, start: float = 0.0, end: float = 0.0) -> Profile:
        """The fastest one, from sdot^2 = start to end; Stuck where there is none."""
        lower, upper = self._backward(end / self._x)
        first = start / self._x
        if not lower[0] - 1e-9 <= first <= upper[0] * (1.0 + 1e-9):
            raise Stuck(0, lower[0] * self._x, upper[0] * self._x)
        x, wrench = self._forward(min(max(first, lower[0]), upper[0]), lower, upper)
        u = np.diff(x) / (2.0 * self._ds)
        shape = len(u), 2, wrench.shape[1] // 2
        return Profile(
            self._s, x * self._x, u * self._x, upper * self._x, FORCE * wrench.reshape(shape)
        )

    def _backward(self, end: float) -> tuple[Array, Array]:
        N = len(self._x_max)
        lower, upper = np.zeros(N), np.zeros(N)
        lower[-1] = upper[-1] = end
        if end > self._x_max[-1] * (1.0 + 1e-9):
            raise Stuck(N - 1, 0.0, self._x_max[-1] * self._x)
        cost = np.zeros(self._A.shape[2])
        for i in range(N - 2, -1, -1):
            cost[1] = -1.0
            found = self._solve(i, cost, lower[i + 1], upper[i + 1])
            if found is None:
                raise Stuck(i)
            upper[i] = found[1]
            if lower[i + 1] > 0.0:  # else rest leads to rest: whatever is held there may stand
                cost[1] = 1.0
                found = self._solve(i, cost, lower[i + 1], upper[i + 1])
                lower[i] = max(0.0, found[1]) if found is not None else upper[i]
        return lower, upper

    def _forward(self, first: float, lower: Array, upper: Array) -> tuple[Array, Array]:
        x, cost = np.empty(len(upper)), np.zeros(self._A.shape[2])
        wrench = np.empty((len(upper) - 1, len(cost) - 2))
        x[0], cost[0] = first, -1.0
        for i in range(len(upper) - 1):
            for less in (0.0, *LESS):
                x_i = max(x[i] * (1.0 - less), lower[i])
                found = self._solve(i, cost, lower[i + 1], upper[i + 1], x_i)
                if found is not None:
                    break
            else:
                raise Stuck(i)
            x[i], wrench[i] = x_i, found[2:]
            x[i + 1] = min(max(x_i + 2.0 * self._ds[i] * found[0], lower[i + 1]), upper[i + 1])
        return x, wrench

    def _solve(
        self, i: int, cost: Array, x_lower: float, x_upper: float, fixed: float | None = None
    ) -> Any:
        upper, lower = self._upper[i], self._lower[i]
        upper[self._next], lower[self._next] = x_upper, x_lower
        kept = upper[1]
        if fixed is not None:
            upper[1] = lower[1] = fixed
        found = program(None, cost, self._A[i], upper, lower)
        upper[1], lower[1] = kept, 0.0
        return None if found is None else found[0]


class Share:
    """How much of its limits the best wrench leaves a motion, and which row it is.

    One program a place: min t with |row| <= t size, at contacts row <= size + (t - 1) unit.
    """

    def __init__(self, rows: Rows) -> None:
        self._rows, made = rows, rows.maker
        self._at = np.flatnonzero(made.kinds != "acceleration")
        self._unit, self._sided = made.unit[self._at], made.two_sided[self._at]
        self._margin = made.size[self._at] - self._unit
        typical = np.median(self._unit) if len(self._at) else 0.0
        self._scale = np.maximum(self._unit, NARROW * typical)
        k, self._m = len(self._at), rows.Rl.shape[2]
        self._A = np.empty((k + self._sided.sum(), self._m + 1))
        self._A[:k, -1] = -self._unit / self._scale
        self._A[k:, -1] = self._A[:k, -1][self._sided]
        self._upper = np.full(self._m + 1 + len(self._A), np.inf)
        self._lower, self._cost = -self._upper, np.zeros(self._m + 1)
        self._upper[self._m], self._lower[self._m], self._cost[self._m] = MAX_SHARE, 0.0, 1.0

    def of(self, i: int, u: float, x: float) -> tuple[float, str]:
        """t, and the row that holds it back most; infinite where no wrench will do."""
        rows, m, k, sided = self._rows, self._m, len(self._at), self._sided
        if not k:
            return 0.0, ""
        by_u, by_x, values = rows.R[:, i, self._at] / self._scale
        values = values + by_u * u + by_x * x
        A, left = self._A, self._margin / self._scale
        by_wrench = rows.Rl[i, self._at] * (FORCE / self._scale)[:, None]
        by_wrench[np.abs(by_wrench) < ROUNDING] = 0.0
        A[:k, :m], A[k:, :m] = by_wrench, -by_wrench[sided]
        self._upper[m + 1 :] = np.concatenate([left - values, (left + values)[sided]])
        solved = program(None, self._cost, A, self._upper, self._lower)
        if solved is None:
            return np.inf, ""
        found, multipliers = solved
        pull = np.abs(multipliers[m + 1 :])
        pull[:k][sided] += pull[k:]
        return float(found[m]), rows.maker.names[self._at[int(pull[:k].argmax())]]

    def with_wrench(self, lam: Array, u: Array, x: Array) -> Array:
        """The same of all places, (N,), with wrenches near lam, (N, m), that keep hinges free."""
        if not len(self._at):
            return np.zeros(len(u))
        R, hinged = self._rows.Rl[:, self._at], self._unit == 0.0
        values = self._rows.values(u, x)[:, self._at] + times(R, lam)
        if hinged.any():
            inverse = np.asarray(np.linalg.pinv(R[:, hinged]), float)
            values -= times(R, times(inverse, values[:, hinged]))
        used = np.where(self._sided, np.abs(values), values) - self._margin
        return np.asarray((used[:, ~hinged] / self._unit[~hinged]).max(axis=1, initial=0.0), float)
