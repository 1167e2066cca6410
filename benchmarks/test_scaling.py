"""Two, three, four and eight seven-joint arms round one object: our tick and Pink's, in one run.

The job is that of ``test_tick.py``: the object's position follows a reference, N - 1 loops are hard
equalities, joint positions and velocities are bounded, daqp solves. Compare the two medians of a
group; the last test takes turns, prints the ratios (``-s``) and holds us to the target.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from functools import cache
from statistics import median
from time import perf_counter

import numpy as np
import pink
import pinocchio as pin
import pytest
from pink.limits import ConfigurationLimit, VelocityLimit
from pink.tasks import FrameTask, RelativeFrameTask
from pytest_benchmark.fixture import BenchmarkFixture

from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.execution.rollout import drive
from coopqp.grasps import Rigid
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.profile import Profile
from coopqp.plant import Disturbance
from coopqp.plants import Kinematic
from coopqp.robot import Arm, RobotModel
from coopqp.robot_files.mdh import MdhParameters, MdhRow, Tip, build_model
from coopqp.solvers import Daqp
from coopqp.tasks import PointOnPoint

ARMS = (2, 3, 4, 8)
TICKS, DT = 100, 0.01
TURNS = 31
TARGET = 0.4  # of Pink's time, at eight arms
NEAR = 5e-3  # both end this close to the goal [m]
WAY = np.array([0.05, 0.03, 0.1])  # [m]

#: Panda: alpha, d (before the axis) and r, theta free; limits [rad], speed [rad/s].
TABLE = (
    (0.0, 0.0, 0.333, -2.8973, 2.8973, 2.175),
    (-90.0, 0.0, 0.0, -1.7628, 1.7628, 2.175),
    (90.0, 0.0, 0.316, -2.8973, 2.8973, 2.175),
    (90.0, 0.0825, 0.0, -3.0718, -0.0698, 2.175),
    (-90.0, -0.0825, 0.384, -2.8973, 2.8973, 2.61),
    (90.0, 0.0, 0.0, -0.0175, 3.7525, 2.61),
    (90.0, 0.088, 0.107, -2.8973, 2.8973, 2.61),
)
READY = (0.0, -0.3, 0.0, -2.2, 0.0, 2.0, math.pi / 4.0)
REACH = 0.9  # of the circle on which the bases stand [m]


def ring(count: int) -> RobotModel:
    """Arms on a circle that face its centre."""
    rows: list[MdhRow] = []
    for arm in range(count):
        turn = 2.0 * math.pi * arm / count
        # rot_z turn, then back along x: the base, before the first row's own transform.
        base = MdhParameters(gamma=turn, d=-REACH)
        rows.append(MdhRow(name=f"base{arm}", sigma="fixed", **vars(base)))
        before = f"base{arm}"
        for joint, (alpha, d, r, lower, upper, speed) in enumerate(TABLE, start=1):
            before_this, before = before, f"arm{arm}_{joint}"
            rows.append(
                MdhRow(
                    name=before,
                    antecedent=before_this,
                    alpha=math.radians(alpha),
                    d=d,
                    r=r,
                    lower=lower,
                    upper=upper,
                    velocity=speed,
                )
            )
    tips = {f"hand{arm}": Tip(parent=f"arm{arm}_7") for arm in range(count)}
    return RobotModel(
        name=f"{count} arms",
        model=build_model("ring", rows, tips),
        arms=tuple(Arm(name=f"arm{arm}", tip=f"hand{arm}") for arm in range(count)),
    )


@cache
def job(count: int) -> ControlProblem:
    """The object goes to a point in a second."""
    robot = ring(count)
    q = robot.configuration({arm.name: READY for arm in robot.arms})
    chain = ClosedChain.attach(robot, q, Rigid(), HeldObject())
    return ControlProblem(
        chain=chain,
        tasks=[
            PointOnPoint(
                name="reach",
                gain=20.0,
                goal=tuple(chain.start_position + WAY),
                profile=Profile(duration=TICKS * DT),
            )
        ],
        limits=[JointPosition(), JointVelocity()],
        dt=DT,
        kappa=1.0 / DT,
        solver=Daqp(),
    )


def ours(count: int) -> Callable[[], float]:
    """A motion of 100 ticks that returns how far from the goal it ends [m]."""
    problem = job(count)
    law = QPController().build(problem)
    plant = Kinematic().build(problem, 0, Disturbance())

    def motion() -> float:
        state = law.start()
        deque(drive(law, plant, state, TICKS), maxlen=0)
        return float(np.linalg.norm(state.p_WO - problem.tasks[0].goal))

    return motion


def pinks(count: int) -> Callable[[], float]:
    """The same motion by Pink."""
    problem = job(count)
    chain, task = problem.chain, problem.tasks[0]
    limits = [ConfigurationLimit(chain.model, 1.0), VelocityLimit(chain.model)]
    first, *others = (f"object[{arm.name}]" for arm in chain.arms)

    def motion() -> float:
        data = chain.model.createData()
        configuration = pink.Configuration(chain.model, data, chain.q_start)
        reach = FrameTask(first, position_cost=1.0, orientation_cost=0.0, gain=task.gain * DT)
        loops = [
            RelativeFrameTask(other, first, position_cost=1.0, orientation_cost=1.0)
            for other in others
        ]
        for loop in loops:
            loop.set_target_from_configuration(configuration)
        start = configuration.get_transform_frame_to_world(first)
        for k in range(TICKS):
            share, _ = task.profile.at((k + 1) * DT)
            reach.set_target(pin.SE3(start.rotation, start.translation + share * WAY))
            v = pink.solve_ik(
                configuration, [reach], DT, solver="daqp", limits=limits,
                constraints=loops, damping=1e-6,
            )  # fmt: skip
            configuration.integrate_inplace(v, DT)
        end = configuration.get_transform_frame_to_world(first).translation
        return float(np.linalg.norm(end - task.goal))

    return motion


@pytest.mark.parametrize("count", ARMS)
def test_coopqp(benchmark: BenchmarkFixture, count: int) -> None:
    benchmark.group = f"{count} arms"
    assert benchmark(ours(count)) < NEAR


@pytest.mark.parametrize("count", ARMS)
def test_pink(benchmark: BenchmarkFixture, count: int) -> None:
    benchmark.group = f"{count} arms"
    assert benchmark(pinks(count)) < NEAR


def test_ratios(benchmark: BenchmarkFixture) -> None:
    """Medians over turns, recorded under extra_info: times of a tick [us] and their ratio."""
    benchmark.group = "ratios"
    rows: dict[int, tuple[float, float, float]] = {}

    def measure() -> None:
        for count in ARMS:
            rows[count] = side_by_side(ours(count), pinks(count))

    benchmark.pedantic(measure, rounds=1)
    _, own_first, other_first = rows[ARMS[0]]
    print("\narms  ratio  coopqp [us]  Pink [us]  growth: coopqp  Pink")
    for count, (ratio, own, other) in rows.items():
        growth, others = own / own_first, other / other_first
        print(f"{count:4d} {ratio:6.3f} {own:12.1f} {other:10.1f} {growth:15.2f} {others:5.2f}")
        benchmark.extra_info[f"{count} arms"] = {
            "ratio": ratio, "growth": growth, "growth of Pink": others
        }  # fmt: skip
    assert rows[8][0] <= TARGET


def side_by_side(
    own: Callable[[], float], other: Callable[[], float]
) -> tuple[float, float, float]:
    """Ratio and times of a tick [us]; they take turns, so that a slow moment hits both."""
    turns = [(seconds(own), seconds(other)) for _ in range(TURNS)]
    ratio = median(a / b for a, b in turns)
    a, b = (1e6 / TICKS * median(times) for times in zip(*turns, strict=True))
    return ratio, a, b


def seconds(motion: Callable[[], float]) -> float:
    """How long it takes."""
    begin = perf_counter()
    motion()
    return perf_counter() - begin
