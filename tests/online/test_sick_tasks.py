"""A task that gives no numbers stops the robot, and is named."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from online_loops import Scripted, follows

from coopqp.base.spec import spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.online.loop import OnlineLoop
from coopqp.solver import Status
from coopqp.task import Task, TaskRows


@spec
class Sick(Task):
    """Asks for nothing, and after a while for no number."""

    what: str = "e"

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return ("z",)

    def bind(self, start: State) -> Any:
        def evaluate(state: State, rows: TaskRows) -> None:
            getattr(rows, self.what)[0] = math.nan if state.t > 0.045 else 0.0

        return evaluate


@pytest.mark.parametrize("what", ["e", "J", "rate"])
def test_the_task_is_named(what: str) -> None:
    scenario = follows()
    task = Sick(name="fever", what=what)
    scenario = replace(scenario, tasks=(*scenario.tasks, task))
    loop, robot = OnlineLoop(scenario, clock=None), Scripted(scenario.chain.q_start)
    for k in range(10):
        command = loop.tick(robot.read(), {"target": [0.15, 0.01, 0.05]})
        robot.write(loop.setpoint, command.v)
        assert (command.status is Status.OPTIMAL) == (k < 5)
    assert not command.status.usable
    assert loop.note == f"task 'fever' gives NaN or infinite values in {what}"
