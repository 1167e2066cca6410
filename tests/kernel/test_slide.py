"""Motions along the loops, as far as asked for: along what pinocchio leaves, and closed."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from side_by_side import needs_kernel
from stress import arrangements

from coopqp.base.rank import null_space
from coopqp.kernel.flat import slide
from coopqp.model.state import State

pytestmark = needs_kernel

STEP = 1e-3  # [rad]


@pytest.mark.parametrize("name", arrangements.names())
def test_a_slide_goes_along_the_loops_and_closes_them(name: str) -> None:
    chain = arrangements.chain(name, arrangements.grasps_of(name)[-1])
    go, rng = slide(chain), np.random.default_rng(1)
    assert go is not None
    q = chain.q_start.copy()
    for _ in range(5):
        before, direction = State(chain, q), rng.normal(size=chain.n)
        basis = null_space(before.J_loop)
        way = basis @ (basis.T @ direction)
        gap = go(q, direction, STEP, 3)
        expected = before.q + STEP * way / np.linalg.norm(way)
        np.testing.assert_allclose(q, expected, atol=30.0 * STEP**2)
        after = State(chain, q)
        found = max(after.loop_position_error, after.loop_orientation_error)
        assert found < 1e-12
        assert gap == pytest.approx(found, abs=1e-14)


def test_a_chain_is_copied_without_what_was_made_of_it() -> None:
    chain = arrangements.chain("nao_t14", "rigid")
    assert slide(chain) is slide(chain.moved(chain.q_start))
    other = copy.deepcopy(chain)
    q, twin = chain.q_start.copy(), chain.q_start.copy()
    direction = np.ones(chain.n)
    assert slide(other)(twin, direction, STEP, 3) == slide(chain)(q, direction, STEP, 3)  # type: ignore[misc]
    np.testing.assert_array_equal(q, twin)
