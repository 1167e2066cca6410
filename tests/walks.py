"""Random walks along the closed loops of a chain, and three numbers as a task takes them."""

from __future__ import annotations

import numpy as np

from coopqp.base.rank import null_space
from coopqp.base.spec import Array
from coopqp.kernel.flat import Slide, slide
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State

STEP, STEPS = 0.05, 40  # of a walk [rad]; so many ...
NEWTON = 3  # iterations that close the loops after each
FARTHER = 3  # ... so many times as many to get outside
FARTHEST_OUTSIDE = 0.3  # [rad, m]
OPEN = 1e-7  # a walk ends where the loops do not close any more [m, rad]


def vector(numbers: Array) -> tuple[float, float, float]:
    """Three plain numbers."""
    x, y, z = np.asarray(numbers, float).tolist()
    return x, y, z


def walk(
    rng: np.random.Generator, chain: ClosedChain, *, outside: bool = False, stay: bool = False
) -> Array:
    """Where a random walk along the loops ends: inside the limits, or as soon as it is outside.

    Args:
        rng: of which as many numbers are drawn for a walk that stays where it begins.
        chain: the closed chain.
        outside: whether to look for the outside.
        stay: whether to stay; for those who have no use for a walk inside.
    """
    q, go = chain.q_start.copy(), slide(chain) or _slide(chain)
    direction = rng.normal(size=chain.n)
    steps = FARTHER * STEPS if outside else int(rng.integers(1, STEPS))
    inside = q.copy()
    for _ in range(0 if stay else steps):
        if not 0.0 <= go(q, direction, STEP, NEWTON) <= OPEN:
            return inside
        beyond = np.maximum(chain.lower - q, q - chain.upper).max()
        if beyond <= 0.0:
            inside[:] = q
        elif not outside or beyond >= FARTHEST_OUTSIDE:
            return inside
        elif rng.random() < 0.5:
            return q
    return inside


def _slide(chain: ClosedChain) -> Slide:
    """The same without the kernel."""
    state = State(chain)

    def go(q: Array, direction: Array, size: float, newton: int) -> float:
        state.q[:] = q
        state.update()
        basis = null_space(state.J_loop)
        step = basis @ (basis.T @ direction)
        state.q += size * step / max(float(np.linalg.norm(step)), 1e-9)
        state.update()
        state.close_loops(newton)
        q[:] = state.q
        return max(state.loop_position_error, state.loop_orientation_error)

    return go
