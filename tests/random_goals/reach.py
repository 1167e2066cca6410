"""Whether a goal can be held inside the joint limits, by bounded inverse kinematics.

    minimise  sum_i w_i |e_i(q)|^2 + LOOP^2 |e_loop(q)|^2   subject to  lower <= q <= upper

from several starts, with scipy's trust region method: nothing of it is shared with any of the laws.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from coopqp.assessment.thresholds import within
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.model.state import State
from coopqp.task import TaskStack

LOOP = 10.0  # weight of the loops' errors against the tasks'
CLOSED = 1e-5  # a loop error that counts as none [m, rad]
STEPS = 60  # of one try
INSIDE = 1e-9  # a try begins this far inside the limits [rad or m]


def holds_inside(problem: ControlProblem, starts: Sequence[Array]) -> bool:
    """Whether some configuration inside the limits holds the goal of all tasks, from any start."""
    return any(_holds(problem, start) for start in starts)


def _holds(problem: ControlProblem, start: Array) -> bool:
    chain = problem.chain
    state, stack = State(chain), TaskStack(problem.tasks, State(chain))
    state.t = max(task.end for task in problem.tasks)
    parts = [part for task in problem.tasks for part in task.parts(chain)]
    closed, root = chain.loops.closed, np.sqrt(stack.weights)

    def residual(q: Array) -> Array:
        state.q[:] = q
        state.update()
        stack.update(state)
        return np.concatenate([root * stack.e, LOOP * state.loop_error[:closed]])

    def slope(q: Array) -> Array:
        residual(q)
        return np.vstack([root[:, None] * stack.J, LOOP * state.J_rel[:closed]])

    first = np.clip(start, chain.lower + INSIDE, chain.upper - INSIDE)
    bounds = (chain.lower, chain.upper)
    residual(least_squares(residual, first, slope, bounds, max_nfev=STEPS).x)
    ends = itertools.accumulate((part.rows for part in parts), initial=0)
    met = all(
        within(float(np.linalg.norm(stack.e[a:b])), part.tolerance)
        for part, (a, b) in zip(parts, itertools.pairwise(ends), strict=True)
    )
    return met and bool(np.abs(state.loop_error[:closed]).max(initial=0) < CLOSED)
