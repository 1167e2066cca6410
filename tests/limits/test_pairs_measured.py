"""How many pairs of bodies are measured in a tick: those that can come near, not all."""

from __future__ import annotations

from dataclasses import replace

import pytest
from side_by_side import laws, needs_kernel

from coopqp.limits import SelfCollision
from coopqp.limits._distances import Distances
from coopqp.scenario.loader import load


@needs_kernel
def test_the_kernel_tells_limits_how_fast_joints_may_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before, all 346 pairs of two Pandas were measured in every tick with the kernel."""
    scenario = load("two_pandas")
    scenario = replace(scenario, limits=(*scenario.limits, SelfCollision()))
    counts: list[int] = []
    update = Distances.update

    def counting(self: Distances, within: float) -> None:
        update(self, within)
        counts.append(len(self.near))

    plain, kernel = laws(scenario.problem())
    monkeypatch.setattr(Distances, "update", counting)
    kernel.tick(kernel.start())
    plain.tick(plain.start())
    of_kernel, of_plain = counts
    assert of_kernel == of_plain
    assert 0 < of_plain < 30
