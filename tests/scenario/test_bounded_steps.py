"""Bounded least squares against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from coopqp.base.spec import Array
from coopqp.scenario.bounded_steps import BoundedSteps, Stop

NEVER = Stop(steps=200, max_step=1.0, enough=lambda r: False, stuck=0.0)


@pytest.mark.parametrize("seed", range(5))
def test_linear_problems_end_where_scipy_ends(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, b = rng.normal(size=(8, 5)), 3.0 * rng.normal(size=8)
    low, high = -rng.uniform(0.1, 1.0, 5), rng.uniform(0.1, 1.0, 5)
    x = np.zeros(5)
    BoundedSteps(5).descend(x, lambda x: (A @ x - b, A), (low, high), NEVER)
    np.testing.assert_allclose(x, lsq_linear(A, b, (low, high), tol=1e-14).x, atol=1e-6)


def test_curved_problems_end_where_scipy_ends() -> None:
    """Rosenbrock's valley, cut off by a bound."""

    def residual(x: Array) -> tuple[Array, Array]:
        r = np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])
        return r, np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])

    low, high = np.array([-2.0, -2.0]), np.array([0.6, 2.0])
    x = np.array([-1.2, 1.0])
    BoundedSteps(2).descend(x, residual, (low, high), NEVER)
    scipy = least_squares(lambda x: residual(x)[0], (-1.2, 1.0), bounds=(low, high), xtol=1e-12)
    np.testing.assert_allclose(x, scipy.x, atol=1e-6)


def test_rows_are_kept_on_the_whole_way() -> None:
    """The nearest point to (2, 2) with x + y <= 1, each step inside."""
    seen = []

    def residual(x: Array) -> tuple[Array, Array]:
        seen.append(x.sum())
        return x - 2.0, np.eye(2)

    x, far = np.zeros(2), np.full(2, np.inf)

    def rows(x: Array) -> tuple[Array, Array]:
        return np.ones((1, 2)), np.array([1.0 - x.sum()])

    BoundedSteps(2, 1).descend(x, residual, (-far, far), NEVER, rows)
    np.testing.assert_allclose(x, [0.5, 0.5], atol=1e-6)
    assert max(seen) <= 1.0 + 1e-7
