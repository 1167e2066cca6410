"""The saddle-point system: solved where it is regular, told where it is not, at little cost."""

from __future__ import annotations

import numpy as np
import pytest

from coopqp.closed_loop.dynamics import PIVOT, SINGULAR, Saddle


def filled(rng: np.random.Generator, n: int, m: int, lost: float) -> Saddle:
    """Random inertia and loop rows, the last of which is a combination of the others but for lost.

    Bodies weigh from grams to some kilograms, and rows turn as much as they slide.
    """
    saddle = Saddle(n, m)
    root = rng.normal(size=(n, n)) * 10.0 ** rng.uniform(-2.0, 0.5, n)[:, None]
    J = rng.normal(size=(m, n)) * 10.0 ** rng.uniform(-1.0, 0.0, m)[:, None]
    J[-1] = rng.normal(size=m - 1) @ J[:-1] + lost * J[-1]
    saddle.top[:], saddle.right[:], saddle.left[:] = root.T @ root, J.T, J
    return saddle


@pytest.mark.parametrize("lost", [1.0, 1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14, 0.0])
def test_it_is_singular_exactly_where_the_condition_number_says_so(
    rng: np.random.Generator, lost: float
) -> None:
    """By singular values, off the border by more than LAPACK's estimate and norms can be wrong."""
    for n, m in [(4, 3), (12, 6), (14, 6), (18, 12), (24, 18)] * 20:
        saddle = filled(rng, n, m, lost)
        K = np.block([[saddle.top, saddle.right], [saddle.left, saddle.corner]])
        rhs = rng.normal(size=n + m)
        x, singular = saddle.solve(rhs)
        values = np.linalg.svd(K, compute_uv=False)
        share = values[-1] / values[0]
        if share > 1e3 * SINGULAR:
            assert not singular
            np.testing.assert_allclose(K @ x, rhs, atol=1e-10 * values[0] * np.abs(x).max())
        if share < 1e-3 * SINGULAR:
            assert singular
            best = np.linalg.lstsq(K, rhs, rcond=1e-8)[0]
            np.testing.assert_allclose(x, best, atol=1e-6 * np.abs(best).max())


def test_no_pivot_hides_a_singular_system(rng: np.random.Generator) -> None:
    """The least pivot of a system near the border is far below the share that is trusted."""
    from scipy.linalg import lapack

    worst = 0.0
    for n, m in [(4, 3), (12, 6), (18, 12), (24, 18)] * 50:
        saddle = filled(rng, n, m, 10.0 ** rng.uniform(-14.0, -4.0))
        K = np.block([[saddle.top, saddle.right], [saddle.left, saddle.corner]])
        pivots = np.abs(np.diag(lapack.dgetrf(K)[0])) / np.linalg.norm(K)
        values = np.linalg.svd(K, compute_uv=False)
        if values[-1] / values[0] < 10.0 * SINGULAR:
            worst = max(worst, float(pivots.min()))
    assert 0.0 < worst < 1e-2 * PIVOT
