"""The command is a continuous function of the state while tasks pass the border of reach."""

from __future__ import annotations

import itertools
from functools import cache
from typing import Literal

import numpy as np
import pytest
from crossing import LEFT, Jump, Mode, jump, problem
from stress import arrangements
from unreachable_goals import chain_of, robots

from coopqp.controller import Law
from coopqp.controllers import QPController
from coopqp.solver import Status

from .continuity import BESIDE, SAME, compared, optimum_moves

SIGNS = tuple(itertools.product((1, -1), repeat=2))  # of the circle's two directions


@cache
def law_of(robot: str, mode: Mode, *, alone: bool, signs: tuple[int, int] = (1, 1)) -> Law:
    grasp = arrangements.grasps_of(robot)[0] if robot in arrangements.names() else "its own"
    return QPController().build(problem(chain_of(robot, grasp), mode, alone=alone, signs=signs))


@cache
def driven(robot: str, mode: Mode, *, alone: bool, signs: tuple[int, int] = (1, 1)) -> Jump:
    """How continuous the law is as it drives round a circle about the border."""
    return jump(law_of(robot, mode, alone=alone, signs=signs))


@pytest.mark.each_value
@pytest.mark.parametrize("signs", SIGNS)
@pytest.mark.parametrize("mode", ["soft", "hard", "scaled"])
@pytest.mark.parametrize("robot", robots())
def test_no_command_jumps_while_a_task_passes_the_border_of_reach(
    robot: str, mode: Mode, signs: tuple[int, int]
) -> None:
    """But where the optimum itself does, to the last digit of the state."""
    found = driven(robot, mode, alone=True, signs=signs)
    assert found.seen <= LEFT, found
    law = law_of(robot, mode, alone=True, signs=signs)
    assert all(optimum_moves(law, left) >= 0.5 * left.size for left in found.jumps), found


@pytest.mark.parametrize("engine", ["python", "kernel"])
def test_optimal_commands_are_optima_beside_a_jump(engine: Literal["python", "kernel"]) -> None:
    """Two wrists at their limits, which nearly say the same, and two answers 5e-4 rad/s apart."""
    problem = law_of("two_so101", "scaled", alone=True, signs=(1, -1)).problem
    found = driven("two_so101", "scaled", alone=True, signs=(1, -1))
    law = QPController(engine=engine).build(problem)
    for left in found.jumps:
        sides = zip(left.sides, (-left.step, left.step), strict=True)
        for at in (side + far * way for side, way in sides for far in (0.0, *BESIDE)):
            said, v, best = compared(law, at)
            assert said is not Status.OPTIMAL or best is None or np.abs(v - best).max() <= SAME


@pytest.mark.few(4)
@pytest.mark.parametrize("robot", robots())
def test_no_later_level_makes_a_hard_task_jump(robot: str) -> None:
    found = driven(robot, "hard", alone=False)
    assert found.seen <= LEFT, found


@pytest.mark.few(4)
@pytest.mark.parametrize("robot", robots())
def test_hard_tasks_let_later_levels_jump_no_farther_than_soft_ones_do(robot: str) -> None:
    hard, soft = driven(robot, "hard", alone=False), driven(robot, "soft", alone=False)
    assert hard.left <= soft.left + LEFT, (hard, soft)


@pytest.mark.full
def test_hard_tasks_pass_the_border() -> None:
    """In most of the runs some ticks hold all and others do not; else nothing would be tested."""
    passed = [robot for robot in robots() if driven(robot, "hard", alone=True).crossings >= 2]
    assert 2 * len(passed) > len(robots())
