"""When a plan is where, and tasks on their way: as fast as joints' limits allow, tick by tick.

The way of a task with ``kind: fastest`` is timed along where a slow run of the law has the joints
at each share of it, by the passes of :mod:`coopqp.planning.forward_backward_pass`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.model.profile import FASTEST, Profile
from coopqp.planning.closed_path import (
    LAW,
    SLOW,
    Loops,
    calm_run,
    closed_path,
    lengths,
    on_lines,
)
from coopqp.planning.path_constraints import RowMaker, motion_bounds, motion_limits
from coopqp.planning.time_along import TimedPath, fastest
from coopqp.scenario.scenario import MAX_KEPT, Scenario
from coopqp.task import Task

#: Where no limit bounds accelerations, the highest speed is there after so long [s].
TO_SPEED = 0.3
#: Speed of a joint that has no limit of it [rad/s, m/s].
UNLIMITED = 1.0
#: Share of the limits that plans and tasks use: the rest is for what the law corrects.
SHARE, SHARE_OF_TASKS = 0.8, 0.99
#: Ticks between two looks at the clock.
PART = 1000
#: Ways over which corners are rounded [rad, m], and how often all becomes slower.
ROUNDED, SLOWER = (0.05, 0.02, 0.01, 0.005), 3
#: Runs of the law, and how much slower than the fastest they are: what else moves, such as joints
#: to their middle, is then about as far as it is in the fastest.
LOOKS, CALM = 3, 1.25

Allowed = Callable[[Array], Array | None]
"""Rows near those of q (N, n) that are allowed; None where one has none."""


class Clock:
    """Says whether there is time left, of so many seconds from now on."""

    def __init__(self, seconds: float) -> None:
        self._seconds, self._begun = seconds, time.perf_counter()
        self.lasts = 0.0  # the way, as far as is known [s]

    def parts(self, rows: NDArray[Any]) -> Iterator[NDArray[Any]]:
        """The rows in parts of ``PART``, at smallest one; a TimeoutError where no time is left."""
        for k in range(0, max(len(rows), 1), PART):
            if time.perf_counter() - self._begun > self._seconds:
                lasts = f", as it lasts {self.lasts:.3g} s" if self.lasts else ""
                raise TimeoutError(
                    f"its ticks were not timed within {self._seconds:.2g} s{lasts}; "
                    "allow more seconds, or let joints go faster"
                )
            yield rows[k : k + PART]


def timed(problem: ControlProblem, q: Array, allowed: Allowed, clock: Clock) -> tuple[Array, Array]:
    """Times [s] and configurations at each tick of a path q (K, n), shapes (T,) and (T, n).

    Corners are rounded as far as ``allowed`` gives what is near it on the manifold and keeps the
    limits in space; where it never does, the straight lines are followed. All goes slower where
    ticks ask for more than the limits. Errors where nothing can be followed, ticks are too many, or
    the clock has run down.
    """
    chain, dt, way, loops = problem.chain, problem.dt, lengths(q), Loops(problem.chain)
    best, smallest = q[:1].copy(), np.inf
    if len(q) < 2:
        return np.zeros(1), best
    _, push, _ = finite_limits(problem)
    for found, place in _rounded(problem, q, allowed):
        if found.duration / dt * chain.n > MAX_KEPT:
            words = "more ticks than are kept; let joints go faster"
            raise InvalidValueError(f"plan: the way lasts {found.duration:.3g} s, {words}")
        slower = 1.0
        for _ in range(SLOWER):
            clock.lasts = slower * found.duration
            ticks = dt * np.arange(int(np.ceil(slower * found.duration / dt)) + 1)
            where = np.array([found.where(t)[0] for t in (ticks / slower).tolist()])
            near = _near(clock.parts(where), place, allowed)
            if near is None:
                break
            pushed = np.diff(near, 2, axis=0, prepend=near[:1], append=near[-1:]) / dt**2
            parts = clock.parts(np.arange(len(near)))
            opened = max(loops.opened(near[max(part[0] - 2, 0) : part[-1] + 1]) for part in parts)
            excess = float((np.abs(pushed) / push).max(initial=opened / SHARE))
            if excess < smallest:
                best, smallest = near, excess
            if excess <= 1.0:
                return np.asarray(ticks, float), near
            slower *= 1.01 * np.sqrt(excess)
    if smallest == np.inf and way[-1] > 1e-6:  # else it stands still
        raise InvalidValueError("plan: a path was found, but nothing near it is free at ticks")
    return np.asarray(dt * np.arange(len(best)), float), best


def _rounded(
    problem: ControlProblem, q: Array, allowed: Allowed
) -> Iterator[tuple[TimedPath, Callable[[Array], Array]]]:
    """Timed paths, and where these are at places along them.

    Corners are rounded less and less, where allowed; at last there are straight lines.
    """
    bounds, widest = motion_bounds(finite_limits(problem), SHARE), None
    for rounded in ROUNDED:
        try:
            path = closed_path(problem.chain, q, rounded)
            widest = widest or path
            at = np.linspace(0.0, path.length, int(path.length / rounded) + 2)
            if allowed(path.spline(at)) is not None:
                yield fastest(RowMaker(path, bounds)), path.spline
        except InvalidValueError:
            continue
    if widest:
        way, length = lengths(q), widest.length

        def straight(at: Array) -> Array:
            return on_lines(at * way[-1] / length, way, q)

        yield fastest(RowMaker(widest, bounds)), straight


def _near(
    parts: Iterable[Array], place: Callable[[Array], Array], allowed: Allowed
) -> Array | None:
    """What is allowed near places along a path."""
    found = list[Array]()
    for at in parts:
        if (near := allowed(place(at))) is None:
            return None
        found.append(near)
    return np.concatenate(found)


def finite_limits(problem: ControlProblem) -> tuple[Array, Array, Array]:
    """As :func:`motion_limits`, of joints finite where no limit of the problem bounds them."""
    speed, push, twist = motion_limits(problem)
    speed = np.where(np.isfinite(speed) & (speed > 0.0), speed, UNLIMITED)
    return speed, np.where(np.isfinite(push), push, speed / TO_SPEED), twist


def with_fastest_profiles(scenario: Scenario) -> Scenario:
    """The scenario with ``kind: fastest`` as tables; all tasks that have it go alike.

    Raises:
        InvalidValueError: in phases, without limits of speed, where the law does not move, or where
            the scenario ends before.
    """
    if not any(_is_fastest(task) for phase in scenario.schedule for task in phase.tasks):
        return scenario
    if scenario.phases:
        words = "fastest is of a motion from the start, and this scenario has phases"
        raise InvalidValueError(f"{words}; use another kind there")
    laws = [name for name, law in scenario.controllers.items() if not law.commands_torques]
    law = next(iter(laws), LAW)
    way = Profile(duration=SLOW)
    for _ in range(LOOKS):
        found = _along(scenario, law, way)
        way = replace(found, duration=CALM * found.duration)
    for task in filter(_is_fastest, scenario.tasks):
        if task.way and (end := task.way.delay + found.duration) > scenario.duration:
            raise InvalidValueError(
                f"the fastest reference of '{task.name}' arrives at {end:.4g} s, after the end at "
                f"{scenario.duration:g} s; make the duration longer"
            )
    return _with(scenario, found)


def _along(scenario: Scenario, law: str, way: Profile) -> Profile:
    """The fastest along where a law's run has the joints by its share of the way."""
    trace = calm_run(scenario, _with(scenario, way, delay=0.0).tasks, way.duration, law)
    bounds = motion_bounds(motion_limits(scenario), SHARE_OF_TASKS)
    path = closed_path(scenario.chain, trace.q)
    found = fastest(RowMaker(path, bounds))
    t = scenario.dt * np.arange(int(np.ceil(found.duration / scenario.dt)) + 1)
    shares = np.array([way.at(now)[0] for now in trace.t.tolist()])
    table = np.interp([found.where(now)[0] for now in t.tolist()], path.points, shares)
    inside = np.minimum(np.maximum.accumulate(table[1:-1]), 1.0)  # but for rounding
    return Profile(kind="table", duration=float(t[-1]), shares=[0.0, *inside.tolist(), 1.0])


def _with(scenario: Scenario, way: Profile, **keys: Any) -> Scenario:
    """The scenario with another profile where it is the fastest; delays stay."""
    tasks = []
    for task in scenario.tasks:
        keys_of = {"delay": task.way.delay, **keys} if task.way else {}
        moved: dict[str, Any] = {"profile": replace(way, **keys_of)} if _is_fastest(task) else {}
        tasks.append(replace(task, **moved))
    return replace(scenario, tasks=tuple(tasks))


def _is_fastest(task: Task) -> bool:
    return task.way is not None and task.way.kind == FASTEST
