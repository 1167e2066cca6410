"""When a plan is where: as fast as its joints' limits allow, at the ticks of a rollout."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.model.closed_chain import ClosedChain
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
#: Ticks between two looks at the clock.
PART = 1000
#: Ways over which corners are rounded [rad, m], and how often all becomes slower.
ROUNDED, SLOWER = (0.05, 0.02, 0.01, 0.005), 3


class OutOfTimeError(InvalidValueError):
    """A path cannot be timed in the time that there is."""


class Clock:
    """Says whether there is time left, of so many seconds from now on."""

    def __init__(self, seconds: float) -> None:
        self._seconds, self._begun = seconds, time.perf_counter()
        self.lasts = 0.0  # the way, as far as is known [s]

    def check(self) -> None:
        """Raise an OutOfTimeError where there is none."""
        if time.perf_counter() - self._begun > self._seconds:
            lasts = f", as it lasts {self.lasts:.3g} s" if self.lasts else ""
            raise OutOfTimeError(
                f"its ticks were not timed within {self._seconds:.2g} s{lasts}; "
                "allow more seconds, or let joints go faster"
            )

    def parts(self, rows: NDArray[Any]) -> Iterator[NDArray[Any]]:
        """The rows in parts of ``PART``, with a check before each; at least one."""
        for k in range(0, max(len(rows), 1), PART):
            self.check()
            yield rows[k : k + PART]


def timed(
    problem: ControlProblem, q: Array, allowed: Callable[[Array], Array | None], clock: Clock
) -> tuple[Array, Array]:
    """Times [s] and configurations at each tick of a path q (K, n), shapes (T,) and (T, n).

    Corners are rounded as far as ``allowed`` gives what is near it on the manifold and keeps the
    limits in space; where it never does, the straight lines are followed. All goes slower where
    ticks ask for more than the limits. Errors where nothing can be followed, ticks are too many, or
    the clock has run down.
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
            clock.lasts = slower * found.duration
            ticks = dt * np.arange(int(np.ceil(slower * found.duration / dt)) + 1)
            where = np.array([found.where(t)[0] for t in (ticks / slower).tolist()])
            near = _near(clock.parts(where), path, q if straight else None, allowed)
            if near is None:
                break
            excess = max(_excess(near, push, dt), _opened(chain, near, clock) / SHARE)
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


def _near(
    parts: Iterable[Array], path: ClosedPath, straight: Array | None,
    allowed: Callable[[Array], Array | None],
) -> Array | None:  # fmt: skip
    """What is allowed near places along a path, or along the straight lines between rows."""
    found = list[Array]()
    for at in parts:
        q = path.spline(at)
        if straight is not None:
            way = lengths(straight)
            along = at * way[-1] / path.length
            q = np.array([np.interp(along, way, column) for column in straight.T]).T
        if (near := allowed(q)) is None:
            return None
        found.append(near)
    return np.concatenate(found)


def _opened(chain: ClosedChain, q: Array, clock: Clock) -> float:
    """As :meth:`Loops.opened`, part by part."""
    loops = Loops(chain)
    starts = clock.parts(np.arange(len(q)))
    return max(loops.opened(q[max(part[0] - 2, 0) : part[-1] + 1]) for part in starts)


def _excess(q: Array, push: Array, dt: float) -> float:
    """Largest acceleration over its limit, from rest to rest."""
    v = np.diff(q, axis=0, prepend=q[:1], append=q[-1:]) / dt
    return float((np.abs(np.diff(v, axis=0)) / dt / push).max(initial=0.0))


def joint_limits(problem: ControlProblem) -> tuple[Array, Array]:
    """Speeds and accelerations of joints, finite where no limit of the problem bounds them."""
    speed, push = joint_bounds(problem)
    speed = np.where(np.isfinite(speed) & (speed > 0.0), speed, UNLIMITED)
    return speed, np.where(np.isfinite(push), push, speed / TO_SPEED)
