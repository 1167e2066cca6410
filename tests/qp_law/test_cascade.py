"""The law's commands are the lexicographic optima of their ticks, told apart from the law."""

from __future__ import annotations

from collections import Counter

import pytest

from .cascade import compare

TICKS = 40
#: Off by 1.4e-7 rad/s: DAQP passes bounds by up to 1e-9, which the least damping of hard tasks,
#: 1e-9, magnifies. The kernel is within 1e-12 there.
OFF = {"python": {18}, "auto": set[int]()}


@pytest.mark.parametrize("engine", ["python", "auto"])
def test_commands_are_lexicographic_optima(engine: str) -> None:
    """Also where hard and scaled tasks cannot hold; more by ``python -m tests.qp_law.cascade``."""
    ticks = [compare(seed, engine) for seed in range(TICKS)]
    assert {tick.seed for tick in ticks if tick.outcome == "off"} == OFF[engine]
    assert Counter(tick.outcome for tick in ticks)["within"] > 0.8 * TICKS
