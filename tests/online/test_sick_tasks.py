"""A task that gives no numbers stops the robot, and is named."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from online_loops import Scripted, follows
from own_task import Own

from coopqp.model.state import State
from coopqp.online.loop import OnlineLoop
from coopqp.solver import Status
from coopqp.task import TaskRows


@pytest.mark.parametrize("what", ["e", "J", "rate"])
def test_the_task_is_named(what: str) -> None:
    def write(state: State, rows: TaskRows) -> None:
        getattr(rows, what)[0] = math.nan if state.t > 0.045 else 0.0

    scenario = follows()
    scenario = replace(scenario, tasks=(*scenario.tasks, Own(name="fever", write=write)))
    loop, robot = OnlineLoop(scenario, clock=None), Scripted(scenario.chain.q_start)
    for k in range(10):
        command = loop.tick(robot.read(), {"target": [0.15, 0.01, 0.05]})
        robot.write(loop.setpoint, command.v)
        assert (command.status is Status.OPTIMAL) == (k < 5)
    assert not command.status.usable
    assert loop.note == f"task 'fever' gives NaN or infinite values in {what}"
