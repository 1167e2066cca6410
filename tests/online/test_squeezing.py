"""The loop for robots squeezes by what force sensors say."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from online_loops import follows, simulated

from coopqp.base.errors import InvalidValueError
from coopqp.closed_loop.admittance import Admittance
from coopqp.closed_loop.grasp_matrix import section
from coopqp.controllers import QPController
from coopqp.online.simulated import SimulatedRobot
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status
from coopqp.tasks import InternalWrench

WANTED = 5.0  # [N]
AWAY = (0.17, 0.02, 0.08)  # [m]


@cache
def squeezing() -> Scenario:
    """NAO stays where it is, on rigid bodies, and squeezes; its servos alone yield."""
    scenario = follows("rigid_body")
    press = InternalWrench(squeeze=WANTED)
    law = QPController(admittance=Admittance(stiffness=4e3))
    return replace(scenario, tasks=(*scenario.tasks, press), controllers={"qp": law})


def felt(robot: SimulatedRobot) -> float:
    """The squeeze, by the plant [N]."""
    told = robot.plant.signals
    p, h = told["hand_point"].reshape(-1, 3), told["hand_wrench"].reshape(-1, 6)
    return float(section(p[0], p[1]).of(h)[0])


def test_it_comes_to_the_squeeze_and_stays_there_when_the_sensor_is_lost() -> None:
    loop, robot = simulated(squeezing(), reference="commanded")
    for _ in range(120):
        command = loop.tick(robot.read(), {"hand_wrench": robot.plant.hand_wrench})
        assert Status.FORCE_NOT_MEASURED not in command.causes
        robot.write(loop.setpoint, command.v)
    assert felt(robot) == pytest.approx(WANTED, rel=0.02)
    lost: tuple[Any, ...] = (None, {}, {"hand_wrench": "wrist"}, {"hand_wrench": [np.nan] * 12})
    for given in lost * 5:
        command = loop.tick(robot.read(), given)
        assert Status.FORCE_NOT_MEASURED in command.causes
        assert not loop.stopped
        robot.write(loop.setpoint, command.v)
    assert felt(robot) == pytest.approx(WANTED, rel=0.05)


def test_a_misspelt_name_is_told_the_one_that_is_needed() -> None:
    loop, robot = simulated(squeezing(), reference="commanded")
    loop.tick(robot.read())
    loop.tick(robot.read(), {"hand_wrenc": robot.plant.hand_wrench})
    assert "unknown input 'hand_wrenc'; did you mean 'hand_wrench'?" in loop.note


def test_coming_to_rest_does_not_let_go() -> None:
    loop, robot = simulated(squeezing(), reference="commanded")
    for k in range(130):
        given = {"hand_wrench": robot.plant.hand_wrench}
        command = loop.tick(robot.read(), given | {"target": AWAY} if k > 105 else given)
        robot.write(loop.setpoint, command.v)
    assert np.abs(command.v).max() > 0.05
    loop.stop()
    for _ in range(40):
        command = loop.tick(robot.read(), {"hand_wrench": robot.plant.hand_wrench})
        robot.write(loop.setpoint, command.v)
    assert loop.at_rest
    assert felt(robot) == pytest.approx(WANTED, rel=0.2)


def test_commands_that_do_not_integrate_are_refused() -> None:
    with pytest.raises(InvalidValueError, match='need "commanded"'):
        simulated(squeezing(), reference="measured")
