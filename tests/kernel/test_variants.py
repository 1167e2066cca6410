"""Processors with and without AVX2 make the same motions, to the last bit."""

from __future__ import annotations

import pytest
from stress.draw import draw
from variants import apart, variants
from watched_bodies import driven

from coopqp.scenario.loader import load

pytestmark = pytest.mark.skipif(len(variants()) < 2, reason="there are no two variants here")

TICKS = 100


@pytest.mark.parametrize("name", ["point_on_point", "baxter_tray", "three_ur", "tiago_torso"])
def test_scenarios_have_the_same_bits(name: str) -> None:
    off, decided = apart(load(name).problem(), TICKS)
    assert (off, decided) == (0.0, TICKS)


@pytest.mark.parametrize("name", ["two_so101", "pr2_circle"])
def test_bodies_are_kept_apart_with_the_same_bits(name: str) -> None:
    off, decided = apart(driven(name, 0), TICKS)
    assert (off, decided) == (0.0, TICKS)


@pytest.mark.parametrize("seed", [7, 72, 90, 268])
def test_drawn_problems_have_the_same_bits(seed: int) -> None:
    """Limits that bind, hard tasks that are given up, steps that are shortened."""
    off, decided = apart(draw(seed).problem, TICKS)
    assert off == 0.0
    assert decided > 0
