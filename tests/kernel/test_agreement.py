"""The kernel and the plain law decide the same, along whole motions."""

from __future__ import annotations

import pytest
from judged import compare
from scenario_files import LOADABLE
from side_by_side import drive, needs_kernel
from stress.draw import draw
from watched_bodies import OF_ROBOTS, driven, watching

from coopqp.controllers.qp import QPController
from coopqp.kernel.flat import why_not
from coopqp.scenario.loader import load

pytestmark = needs_kernel

SAME = 1e-10  # [rad/s, m/s]


@pytest.mark.few(12)
@pytest.mark.parametrize("name", LOADABLE)
def test_shipped_scenarios_move_alike(name: str) -> None:
    """Every tick is the kernel's, and as the plain law's to rounding."""
    scenario = load(name)
    if not any(isinstance(c, QPController) for c in scenario.controllers.values()):
        pytest.skip("no controller solves a QP in velocities")
    problem = scenario.problem()
    assert why_not(problem) == ""
    ticks = min(scenario.schedule[0].ticks(scenario.dt), 250)
    seen = drive(problem, ticks)
    assert seen.decided == ticks, dict(seen.left)
    assert seen.v < SAME


@pytest.mark.few(3)
@pytest.mark.parametrize("name", OF_ROBOTS)
def test_bodies_are_kept_apart_alike(name: str) -> None:
    """With self-collision and things nearby, towards a goal, also without any other limit."""
    seen = drive(driven(name, 1), 100)
    alone = drive(watching(name, alone=True), 20)
    assert seen.decided == 100, dict(seen.left)
    assert alone.decided == 20, dict(alone.left)
    assert max(seen.v, alone.v) < SAME


@pytest.mark.parametrize("seed", [*range(24), 381])  # the last needs its answer refined
def test_random_problems_move_alike(seed: int) -> None:
    """All modes, limits that bind, several levels; where they differ the plain law is off."""
    problem = draw(seed).problem
    assert why_not(problem) == ""
    seen = compare(f"seed {seed}", problem, 30)
    assert not seen.kernel_off
    assert seen.alike + sum(seen.judged.values()) >= 0.9 * seen.ticks
