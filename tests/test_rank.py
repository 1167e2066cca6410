"""Null spaces against scipy's, which takes them from singular values."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from coopqp.base.rank import RANK_TOLERANCE, directions, null_space


@pytest.mark.parametrize("rank", range(6))
@pytest.mark.parametrize("shape", [(5, 5), (5, 9), (9, 5), (12, 18)])
def test_null_spaces_are_scipys(
    shape: tuple[int, int], rank: int, rng: np.random.Generator
) -> None:
    m, n = shape
    matrix = rng.normal(size=(m, rank)) @ rng.normal(size=(rank, n))
    wanted, found = scipy.linalg.null_space(matrix, rcond=RANK_TOLERANCE), null_space(matrix)
    assert found.shape == wanted.shape == (n, n - rank)
    np.testing.assert_allclose(found.T @ found, np.eye(n - rank), atol=1e-14)
    np.testing.assert_allclose(found @ found.T, wanted @ wanted.T, atol=1e-11)


def test_no_null_space_is_made_of_numbers_that_are_none() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="NaN or infinite"):
        null_space(np.full((2, 3), np.nan))


@pytest.mark.parametrize("shape", [(3, 7), (7, 3), (0, 4), (4, 0)])
def test_directions_have_their_singular_values(
    shape: tuple[int, int], rng: np.random.Generator
) -> None:
    rows = rng.normal(size=shape)
    values, ways = directions(rows)
    assert values.shape == shape[1:]
    assert ways.shape == (shape[1], shape[1])
    np.testing.assert_allclose(np.linalg.norm(rows @ ways.T, axis=0), values, atol=1e-13)
    np.testing.assert_allclose(ways @ ways.T, np.eye(shape[1]), atol=1e-14)
