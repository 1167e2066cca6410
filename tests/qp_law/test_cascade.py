"""The law's commands are the lexicographic optima of their ticks, told apart from the law."""

from __future__ import annotations

from collections import Counter

import pytest

from .cascade import compare

TICKS = 40


@pytest.mark.few(1)
@pytest.mark.parametrize("engine", ["python", "auto"])
def test_commands_are_lexicographic_optima(engine: str) -> None:
    """Also where hard and scaled tasks cannot hold; more by ``python -m tests.qp_law.cascade``."""
    ticks = [compare(seed, engine) for seed in range(TICKS)]
    assert not [tick.seed for tick in ticks if tick.outcome == "off"]
    assert Counter(tick.outcome for tick in ticks)["within"] > 0.8 * TICKS


@pytest.mark.parametrize("seed", [1722, 1841])
def test_last_digits_of_a_level_move_no_later_one(seed: int) -> None:
    """Active limits held to daqp's 1e-9 only, and little damping; answers were 4e-7 rad/s off."""
    assert compare(seed, "python").outcome == "within"
