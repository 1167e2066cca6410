"""One full tick of the QP law side by side with Pink doing the same job, in one run.

A tick is kinematics, assembly, solve, verification (ours only) and integration. Both solve with
daqp, hold the loop as a hard equality and the joint position and velocity limits as hard bounds.
Compare the medians: ``make bench`` prints them as ratios.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
import pink
import pinocchio as pin
import pytest
from pink.limits import ConfigurationLimit, VelocityLimit
from pink.tasks import FrameTask, RelativeFrameTask
from pytest_benchmark.fixture import BenchmarkFixture

from coopqp.controllers import QPController
from coopqp.execution.rollout import drive
from coopqp.scenario.scenario import Scenario

TICKS = 300  # the scenario's length: every round does the whole motion


@pytest.mark.benchmark(group="tick")
def test_coopqp_tick(benchmark: BenchmarkFixture, scenario: Scenario) -> None:
    """The tick of the hand-written loop in the README, without joint centring: Pink has none."""
    problem = replace(scenario, secondary=()).problem()
    law = QPController().build(problem)
    plant = scenario.plant.build(problem, 0, scenario.disturbance)

    def motion() -> float:
        state = law.start()
        deque(drive(law, plant, state, TICKS), maxlen=0)
        return float(np.linalg.norm(state.p_WO - scenario.tasks[0].goal))

    assert benchmark(motion) < 1e-3


@pytest.mark.benchmark(group="tick")
def test_pink_tick(benchmark: BenchmarkFixture, scenario: Scenario) -> None:
    """Pink's own loop: a position task, the relative pose as constraint, two limits."""
    chain, task, dt = scenario.chain, scenario.tasks[0], scenario.dt
    limits = [ConfigurationLimit(chain.model, 1.0), VelocityLimit(chain.model)]

    def motion() -> float:
        data = chain.model.createData()
        configuration = pink.Configuration(chain.model, data, chain.q_start)
        right, left = (f"object[{arm.name}]" for arm in chain.arms)
        reach = FrameTask(right, position_cost=1.0, orientation_cost=0.0, gain=task.gain * dt)
        loop = RelativeFrameTask(left, right, position_cost=1.0, orientation_cost=1.0)
        loop.set_target_from_configuration(configuration)
        start = configuration.get_transform_frame_to_world(right)
        way = np.array(task.goal) - start.translation
        for k in range(TICKS):
            share, _ = task.profile.at((k + 1) * dt)
            reach.set_target(pin.SE3(start.rotation, start.translation + share * way))
            v = pink.solve_ik(
                configuration, [reach], dt, solver="daqp", limits=limits,
                constraints=[loop], damping=1e-6,
            )  # fmt: skip
            configuration.integrate_inplace(v, dt)
        end = configuration.get_transform_frame_to_world(right).translation
        return float(np.linalg.norm(end - task.goal))

    assert benchmark(motion) < 5e-3
