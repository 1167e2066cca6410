"""Two strict levels: what the secondary objective costs, which is nothing."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import laws
import numpy as np
import pinocchio as pin
import pytest
from laws import LIMITS, PLAIN, WIDE, run, ticks

from coopqp.controllers import QPController
from coopqp.grasps import Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.robot import Arm, RobotModel
from coopqp.robots import PlanarPair
from coopqp.scenario.loader import load
from coopqp.solver import Status
from coopqp.task import Task
from coopqp.tasks import JointCentering, PointOnPoint, Posture

ARM_OUT = {"right": [0.6, -0.3, 1.0, 0.8, 0.0]}
problem = partial(laws.problem, budget=WIDE)
SECONDARY: dict[str, Task] = {
    "centring": JointCentering(name="centre", gain=5.0),
    "posture": Posture(name="arm out", goal=ARM_OUT, gain=5.0, weight=10.0),
}
each_secondary = pytest.mark.parametrize("secondary", SECONDARY.values(), ids=SECONDARY.keys())


@each_secondary
@pytest.mark.parametrize("scenario", ["point_on_point", "joint_limit_stress"])
def test_secondary_objective_costs_the_main_task_nothing_in_any_tick(
    scenario: str, secondary: Task
) -> None:
    """Along a whole run, at its limits too: J v of the task is what it is without it."""
    given = replace(load(scenario).problem(), secondary=(secondary,))
    law, alone = (QPController().build(replace(given, secondary=k)) for k in ((secondary,), ()))
    state, moved = law.start(), 0.0
    for command in ticks(law, state, 300):
        v, without = command.v, alone.tick(state).v
        assert law.command.status is alone.command.status is Status.OPTIMAL
        np.testing.assert_allclose(state.J_task[:3] @ v, state.J_task[:3] @ without, atol=1e-9)
        np.testing.assert_allclose(state.J_rel @ v, state.J_rel @ without, atol=1e-9)
        moved = max(moved, float(np.abs(v - without).max()))
    assert moved > 1e-2


@pytest.fixture(scope="module")
def gantry() -> ClosedChain:
    """Two gantries of four slides each: joint steps add up without linearisation error."""
    model, tips = pin.Model(), []
    kinds = (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ, pin.JointModelPX)
    for side, y in (("right", -0.2), ("left", 0.2)):
        place, parent = pin.SE3(np.eye(3), np.array([0.0, y, 0.0])), 0
        for i, kind in enumerate(kinds):
            one = np.ones(1)
            parent = model.addJoint(parent, kind(), place, f"{side}_{i}", one, 5 * one, -one, one)
            place = pin.SE3.Identity()
        tips.append(f"{side}_hand")
        model.addFrame(pin.Frame(tips[-1], parent, place, pin.FrameType.OP_FRAME))
    arms = tuple(Arm(name=s, tip=t) for s, t in zip(("right", "left"), tips, strict=True))
    robot = RobotModel(name="gantry", model=model, arms=arms)
    start = np.array([0.3, -0.1, 0.2, 0.0, -0.2, 0.1, 0.0, 0.1])
    return ClosedChain.attach(robot, start, Rigid(), HeldObject())


@pytest.mark.parametrize("secondary", [
    JointCentering(name="centre", gain=5.0),
    Posture(name="posture", goal=[0.2, 0.2, -0.1, -0.2, 0.1, 0.1, 0.3, 0.3], gain=5.0, weight=10.0),
], ids=["centring", "posture"])  # fmt: skip
def test_whole_run_of_the_main_task_is_the_same_to_a_nanometre(
    secondary: Task, gantry: ClosedChain
) -> None:
    """Over 300 ticks of linear kinematics error and object path do not see the secondary."""
    task = PointOnPoint(name="reach", goal=(0.3, 0.1, -0.2), profile=Profile(duration=2.0))
    without = run(PLAIN, problem(gantry, task, limits=LIMITS), 300)
    with_it = run(PLAIN, problem(gantry, task, secondary=[secondary], limits=LIMITS), 300)
    assert np.abs(with_it.q - without.q).max() > 1e-2
    np.testing.assert_allclose(with_it.task_error, without.task_error, atol=1e-9)
    np.testing.assert_allclose(with_it.position, without.position, atol=1e-9)


@each_secondary
def test_what_a_run_differs_by_is_the_curvature_of_a_step(secondary: Task) -> None:
    """On NAO the object path differs by the square of dt only: no first-order cost."""
    given = load("point_on_point").problem()
    task = replace(given.tasks[0], gain=5.0)
    off = []
    for dt in (0.02, 0.01, 0.005):
        both = [
            run(
                PLAIN,
                replace(given, tasks=(task,), secondary=s, dt=dt, kappa=1 / dt),
                round(2 / dt),
            )
            for s in ((secondary,), ())
        ]
        k = round(1.0 / dt)
        off.append(np.abs(both[0].position[: k + 1] - both[1].position[: k + 1]).max())
    assert off[1] < 0.6 * off[0]
    assert off[2] < 0.6 * off[1]
    assert off[2] < 1e-4


SINGULAR_DEG: dict[str, list[float]] = {
    "all stretched": [0, 0, 0, 0, 0, 0],
    "stretched, spread": [-20, 0, 0, 20, 0, 0],
}


@pytest.mark.parametrize("start", SINGULAR_DEG.values(), ids=SINGULAR_DEG.keys())
def test_secondary_costs_nothing_after_a_singular_start(start: list[float]) -> None:
    """Stretched arms lose rank; some ticks later they have it back."""
    chain = ClosedChain.attach(PlanarPair().build(), np.radians(start), Rigid(), HeldObject())
    x, y, z = State(chain).p_WO.tolist()
    task = PointOnPoint(name="pull back", goal=(x - 0.1, y + 0.05, z))
    posture = Posture(name="posture", goal=[0.5, -0.3, 0.4, 0.2, 0.6, -0.3])
    given = problem(chain, task, secondary=[posture], limits=LIMITS)
    law, alone = PLAIN.build(given), PLAIN.build(replace(given, secondary=()))
    state = law.start()
    for command in ticks(law, state, 200):
        v, without = command.v, alone.tick(state).v
        np.testing.assert_allclose(state.J_rel @ v, state.J_rel @ without, atol=1e-9)
        np.testing.assert_allclose(state.J_task[:3] @ v, state.J_task[:3] @ without, atol=1e-9)
