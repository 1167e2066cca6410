"""When a path is where: as fast as the joints' speeds and accelerations allow.

Along the path's length s the joints are q(s). With the tangent q' and the curvature q'' of points
at equal distances,

    |q'_j| s_dot <= v_j,   |q'_j| |s_ddot| + |q''_j| s_dot^2 <= a_j

and each half of a_j is one term's. s_dot is found by a pass forwards from rest and one backwards.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from coopqp.assessment.thresholds import LOOP_CLOSED, LOOP_CLOSED_ANGLE
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.model.closed_chain import ClosedChain
from coopqp.planning.closed_path import smoothed
from coopqp.planning.rows import joint_bounds
from coopqp.planning.verification import along, lengths

#: Where no limit bounds accelerations, the highest speed is there after so long [s].
TO_SPEED = 0.3
#: Speed of a joint that has no limit of it [rad/s, m/s].
UNLIMITED = 1.0
#: Share of the limits that the timing uses: the rest is for what the law corrects.
SHARE = 0.8
#: Ticks that corners are rounded over, and how much slower all may become for them.
WINDOWS, SLOWER = (1, 5, 9, 15, 21, 31), (1.0, 1.2, 1.4, 1.7, 2.0, 2.5, 3.0)
#: Distance of the points at which a path is timed [rad, m], and how many curvature is averaged on.
EVERY, WIDTH = 0.02, 5

Allowed = Callable[[Array], Array | None]
"""From rows near a path to those on the manifold; None where a limit is not kept."""


def timed(problem: ControlProblem, q: Array, allowed: Allowed) -> tuple[Array, Array]:
    """Times [s] and configurations at each tick of a path q (K, n), shapes (T,) and (T, n).

    Corners are rounded in time, so that accelerations keep their limits, as far as ``allowed``
    gives what is near it on the manifold and keeps the limits in space; where it does not, all
    goes slower.
    """
    dt = problem.dt
    if len(q) < 2:
        return np.array([0.0]), q.copy()
    points = along(q, EVERY)
    speed, push = joint_limits(problem)
    s_dot = _speeds(points, SHARE * speed, SHARE * push)
    mean = np.maximum(0.5 * (s_dot[1:] + s_dot[:-1]), 1e-9)
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    s, t = lengths(points), np.concatenate([[0.0], np.cumsum(step / mean)])
    best, least = points[:1], np.inf
    for slower, window in itertools.product(SLOWER, WINDOWS):
        ticks = dt * np.arange(int(np.ceil(slower * t[-1] / dt)) + 1)
        at = np.interp(ticks, slower * t, s)
        made = np.array([np.interp(at, s, column) for column in points.T]).T
        near = allowed(_averaged(made, window))
        if near is None:
            continue
        excess = max(_excess(near, push, dt), _opening(problem.chain, near))
        if excess < least:
            best, least = near, excess
        if excess <= 1.0:
            break
    return np.asarray(dt * np.arange(len(best)), float), best


def _averaged(q: Array, window: int) -> Array:
    """Moving average, twice, from rest to rest; so many ticks longer at both ends."""
    if window < 2:
        return q
    held = np.concatenate([np.repeat(q[:1], window, 0), q, np.repeat(q[-1:], window, 0)])
    ends = [np.repeat(held[at], window - 1, 0) for at in (slice(0, 1), slice(-1, None))]
    return smoothed(np.concatenate([ends[0], held, ends[1]]), window)


def _excess(q: Array, push: Array, dt: float) -> float:
    """Largest acceleration over its limit, from rest to rest."""
    v = np.diff(q, axis=0, prepend=q[:1], append=q[-1:]) / dt
    return float((np.abs(np.diff(v, axis=0)) / dt / push).max(initial=0.0))


def _opening(chain: ClosedChain, q: Array) -> float:
    """How far a tick's straight step opens the loops, over what counts as closed."""
    if not chain.loops.closed:
        return 0.0
    ahead = 2.0 * q[1:-1] - q[:-2]
    errors = np.array([chain.loop_error(row) for row in ahead]).reshape(-1, 2, 3)
    position, angle = np.linalg.norm(errors, axis=2).max(axis=0, initial=0.0).tolist()
    return float(max(position / LOOP_CLOSED, angle / LOOP_CLOSED_ANGLE) / SHARE)


def joint_limits(problem: ControlProblem) -> tuple[Array, Array]:
    """Speeds and accelerations of joints, finite where no limit of the problem bounds them."""
    speed, push = joint_bounds(problem)
    speed = np.where(np.isfinite(speed) & (speed > 0.0), speed, UNLIMITED)
    return speed, np.where(np.isfinite(push), push, speed / TO_SPEED)


def _speeds(points: Array, speed: Array, push: Array) -> Array:
    """s_dot at each point, from rest to rest, shape (K,)."""
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if len(points) < 3 or not step.all():
        return np.zeros(len(points))
    tangent = np.gradient(points, axis=0) / np.gradient(np.cumsum([0.0, *step]))[:, None]
    bend = np.abs(np.gradient(tangent, axis=0)) / step.mean()
    width = min(WIDTH, len(points))
    window = np.ones(width) / width
    bend = np.array([np.convolve(column, window, "same") for column in bend.T]).T
    size = np.maximum(np.abs(tangent), 1e-9)
    most = np.minimum((speed / size).min(axis=1), np.sqrt((0.5 * push / (bend + 1e-9)).min(axis=1)))
    rise = (0.5 * push / size).min(axis=1)
    s_dot = np.asarray(most, float)
    s_dot[0] = s_dot[-1] = 0.0
    for k in range(1, len(points)):
        s_dot[k] = min(s_dot[k], np.sqrt(s_dot[k - 1] ** 2 + 2.0 * rise[k - 1] * step[k - 1]))
    for k in range(len(points) - 2, -1, -1):
        s_dot[k] = min(s_dot[k], np.sqrt(s_dot[k + 1] ** 2 + 2.0 * rise[k + 1] * step[k]))
    return s_dot
