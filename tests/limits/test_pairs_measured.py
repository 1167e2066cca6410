"""How many pairs of bodies are looked at in a tick: those that can come near, not all."""

from __future__ import annotations

from dataclasses import replace

import pytest
from scenario_files import needs_robots
from side_by_side import laws, needs_kernel

from coopqp.controller import ControlProblem
from coopqp.limits import SelfCollision
from coopqp.limits._bodies import Distances
from coopqp.scenario.loader import load

pytestmark = [needs_kernel, needs_robots]


def two_pandas(*, alone: bool = False) -> ControlProblem:
    """346 pairs; alone: no other limit, so that nothing bounds the joints' speed."""
    scenario = load("two_pandas")
    others = () if alone else scenario.limits
    return replace(scenario, limits=(*others, SelfCollision())).problem()


@pytest.mark.parametrize("alone", [False, True])
def test_the_kernel_has_rows_of_near_pairs_alone(alone: bool) -> None:
    """Whatever bounds the joints: far pairs are asked whether an answer could touch them."""
    _, kernel = laws(two_pandas(alone=alone))
    state = kernel.start()
    for _ in range(100):
        kernel.step(state)
        assert kernel.compiled
        assert kernel.whole.engine.near() < 20


def test_limits_in_python_are_told_how_fast_joints_may_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before, all pairs were measured in every tick of the kernel's, not those in reach alone."""
    counts: list[int] = []
    update = Distances.update

    def counting(self: Distances, within: float) -> None:
        update(self, within)
        counts.append(len(self.near))

    plain, _ = laws(two_pandas())
    monkeypatch.setattr(SelfCollision, "program", lambda *_: None)
    _, kernel = laws(two_pandas())
    monkeypatch.setattr(Distances, "update", counting)
    kernel.tick(kernel.start())
    plain.tick(plain.start())
    of_kernel, of_plain = counts
    assert of_kernel == of_plain
    assert 0 < of_plain < 30
