"""When a plan is where: as fast as its joints' limits allow, at the ticks of a rollout."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.planning.closed_path import ClosedPath, Loops, closed_path
from coopqp.planning.path_constraints import RowMaker, joint_bounds, motion_bounds
from coopqp.planning.time_along import POINTS, TimedPath, fastest
from coopqp.planning.verification import lengths
from coopqp.scenario.scenario import MOST_KEPT

#: Where no limit bounds accelerations, the highest speed is there after so long [s].
TO_SPEED = 0.3
#: Speed of a joint that has no limit of it [rad/s, m/s].
UNLIMITED = 1.0
#: Share of the limits that the timing uses: the rest is for what the law corrects.
SHARE = 0.8
#: Ways over which corners are rounded [rad, m], and how often all becomes slower.
ROUNDED, SLOWER = (0.05, 0.02, 0.01, 0.005), 3


def timed(
    problem: ControlProblem, q: Array, allowed: Callable[[Array], Array | None]
) -> tuple[Array, Array]:
    """Times [s] and configurations at each tick of a path q (K, n), shapes (T,) and (T, n).

    Corners are rounded as far as ``allowed`` gives what is near it on the manifold and keeps the
    limits in space; where it never does, the straight lines are followed. All goes slower where
    ticks ask for more than the limits. Errors where nothing can be followed, or ticks are too many.
    """
    chain, dt, way = problem.chain, problem.dt, lengths(q)
    best, least = q[:1].copy(), np.inf
    if len(q) < 2:
        return np.zeros(1), best
    _, push = joint_limits(problem)
    for path, found, straight in _rounded(problem, q, allowed):
        if found.duration / dt * chain.n > MOST_KEPT:
            words = "more ticks than are kept; let joints go faster"
            raise InvalidValueError(f"plan: the way lasts {found.duration:.3g} s, {words}")
        slower = 1.0
        for _ in range(SLOWER):
            ticks = dt * np.arange(int(np.ceil(slower * found.duration / dt)) + 1)
            at = np.array([found.where(t / slower)[0] for t in ticks.tolist()])
            along = at * way[-1] / path.length
            lines = np.array([np.interp(along, way, column) for column in q.T]).T
            near = allowed(lines if straight else path.spline(at))
            if near is None:
                break
            excess = max(_excess(near, push, dt), Loops(chain).opened(near) / SHARE)
            if excess < least:
                best, least = near, excess
            if excess <= 1.0:
                return np.asarray(ticks, float), near
            slower *= 1.01 * np.sqrt(excess)
    if least == np.inf and way[-1] > 1e-6:  # else it stands still
        raise InvalidValueError("plan: a path was found, but nothing near it is free at ticks")
    return np.asarray(dt * np.arange(len(best)), float), best


def _rounded(
    problem: ControlProblem, q: Array, allowed: Callable[[Array], Array | None]
) -> Iterator[tuple[ClosedPath, TimedPath, bool]]:
    """Paths with corners that are rounded less and less, where allowed; at last straight lines."""
    bounds, widest = motion_bounds(problem, *joint_limits(problem), SHARE), None
    for rounded in ROUNDED:
        try:
            path = closed_path(problem.chain, q, rounded)
            widest = widest or path
            at = np.linspace(0.0, path.length, int(path.length / rounded) + 2)
            if allowed(path.spline(at)) is not None:
                yield path, fastest(RowMaker(path, bounds), POINTS), False
        except InvalidValueError:
            continue
    if widest:
        yield widest, fastest(RowMaker(widest, bounds), POINTS), True


def _excess(q: Array, push: Array, dt: float) -> float:
    """Largest acceleration over its limit, from rest to rest."""
    v = np.diff(q, axis=0, prepend=q[:1], append=q[-1:]) / dt
    return float((np.abs(np.diff(v, axis=0)) / dt / push).max(initial=0.0))


def joint_limits(problem: ControlProblem) -> tuple[Array, Array]:
    """Speeds and accelerations of joints, finite where no limit of the problem bounds them."""
    speed, push = joint_bounds(problem)
    speed = np.where(np.isfinite(speed) & (speed > 0.0), speed, UNLIMITED)
    return speed, np.where(np.isfinite(push), push, speed / TO_SPEED)
