"""Controllers on the same variants: tests against scipy's, intervals against what they promise."""

from __future__ import annotations

import numpy as np
import pytest

from coopqp.study.sweep.summary import heads, median, success


@pytest.mark.parametrize(("b", "c"), [(0, 1), (3, 9), (20, 20), (0, 30), (200, 150)])
def test_mcnemar_is_scipys_binomial_test(b: int, c: int) -> None:
    import scipy.stats  # half a second that no other test needs

    expected = scipy.stats.binomtest(b, b + c, 0.5).pvalue
    assert heads(b, c) == pytest.approx(min(1.0, expected), rel=1e-9)


def test_successes_are_counted_by_variant() -> None:
    one = np.array([True, True, False, False, True, False])
    other = np.array([True, False, True, False, False, False])
    found = success(one, other)
    assert (found.both, found.only_one, found.only_reference, found.neither) == (1, 2, 1, 2)
    assert found.difference.value == pytest.approx(1 / 6)
    assert found.difference.p == 1.0
    assert success(one[:0], other[:0]).difference.of == 0


def test_intervals_hold_the_truth_as_often_as_they_say(rng: np.random.Generator) -> None:
    held = shares = 0
    for _ in range(400):
        hard = rng.random(80)  # of each variant; it decides more than the controller does
        one, other = hard + 0.1 * rng.random(80) < 0.7, hard + 0.1 * rng.random(80) < 0.6
        found = success(one, other).difference
        shares += found.low <= 0.1 <= found.high
        found = median(hard + rng.exponential(1.0, 80), hard)
        held += found.low <= np.log(2.0) <= found.high
    assert shares / 400 > 0.92
    assert held / 400 > 0.90


def test_pairs_see_what_two_intervals_do_not(rng: np.random.Generator) -> None:
    hard = 100.0 * rng.random(40)
    found = median(hard + 0.1, hard)
    assert found.low > 0.0
    assert found.p < 1e-9


def test_few_variants_and_lost_runs() -> None:
    few = median(np.array([1.0, 2.0, 3.0]), np.zeros(3))
    assert (few.value, few.low, few.high, few.p) == (2.0, -np.inf, np.inf, 0.25)
    lost = median(np.array([np.inf] * 7 + [np.nan]), np.zeros(8))
    assert (lost.value, lost.low, lost.of) == (np.inf, np.inf, 7)
    assert median(np.array([np.nan]), np.zeros(1)).of == 0


@pytest.mark.parametrize("n", range(6, 60))
def test_the_interval_of_the_median_is_the_shortest_that_the_sign_test_keeps(n: int) -> None:
    values = np.arange(1.0, n + 1.0)
    found = median(values, np.zeros(n))
    below = int(found.low) - 1  # values before the first of the interval
    assert heads(below, n - below) <= 0.05
    assert heads(below + 1, n - below - 1) > 0.05
