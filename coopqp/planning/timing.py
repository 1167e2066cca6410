"""When a path is where: as fast as the joints' speeds and accelerations allow.

Along the path's length s the joints are q(s). With the tangent q' and the curvature q'' of points at
equal distances,

    |q'_j| s_dot <= v_j,   |q'_j| |s_ddot| + |q''_j| s_dot^2 <= a_j

and each half of a_j is one term's. s_dot is found by a pass forwards from rest and one backwards.
"""

from __future__ import annotations

import numpy as np

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.limit import Bounded, JointBounds
from coopqp.planning.verification import along

#: Where no limit bounds accelerations, the highest speed is there after so long [s].
TO_SPEED = 0.3
#: Speed of a joint that has no limit of it [rad/s, m/s].
UNLIMITED = 1.0
#: Share of the limits that the timing uses: the rest is for what the law corrects.
SHARE = 0.8
#: Distance of the points at which a path is timed [rad, m], and points that curvature is smoothed on.
EVERY, WIDTH = 0.02, 5


def timed(problem: ControlProblem, q: Array) -> tuple[Array, Array]:
    """Times [s] and configurations at each tick of a path q (K, n), shapes (T,) and (T, n)."""
    if len(q) < 2:
        return np.array([0.0]), q.copy()
    points = along(q, EVERY)
    speed, push = joint_limits(problem)
    s_dot = _speeds(points, SHARE * speed, SHARE * push)
    mean = np.maximum(0.5 * (s_dot[1:] + s_dot[:-1]), 1e-9)
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    t = np.concatenate([[0.0], np.cumsum(step / mean)])
    ticks = problem.dt * np.arange(int(np.ceil(t[-1] / problem.dt)) + 1)
    s = np.concatenate([[0.0], np.cumsum(step)])
    at = np.interp(ticks, t, s)
    return ticks, np.array([np.interp(at, s, column) for column in points.T]).T


def joint_limits(problem: ControlProblem) -> tuple[Array, Array]:
    """Speeds and accelerations that the limits of a problem allow, shape (n,) each."""
    chain = problem.chain
    speed, push = chain.velocity.copy(), np.full(chain.n, np.inf)
    for limit in problem.limits:
        program = limit.program(chain, problem.dt)
        if not isinstance(program, JointBounds):
            continue
        if program.of is Bounded.VELOCITY:
            speed = np.minimum(speed, np.minimum(program.upper, -program.lower))
        if program.of is Bounded.BRAKING and program.step is not None:
            push = np.minimum(push, program.step / problem.dt)
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
    s_dot = most.copy()
    s_dot[0] = s_dot[-1] = 0.0
    for k in range(1, len(points)):
        s_dot[k] = min(s_dot[k], np.sqrt(s_dot[k - 1] ** 2 + 2.0 * rise[k - 1] * step[k - 1]))
    for k in range(len(points) - 2, -1, -1):
        s_dot[k] = min(s_dot[k], np.sqrt(s_dot[k + 1] ** 2 + 2.0 * rise[k + 1] * step[k]))
    return s_dot
