"""The object's place between the arms, by weight."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scenario_files import GOOD, write

import coopqp
from coopqp.base.errors import InvalidValueError, ScenarioError, UnknownNameError
from coopqp.base.spec import Array
from coopqp.grasps import Revolute, Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State
from coopqp.robot import RobotModel
from coopqp.robots import Several
from coopqp.scenario.loader import load

H = 1e-5  # step of the central differences [rad]


def facing_arms() -> tuple[RobotModel, Array]:
    """Yeo's two arms and another left one that faces them; anywhere inside the limits."""
    robot = load("yeo_4_5").robot
    build = Several(
        robots={
            "a": {"robot": robot},
            "b": {"robot": robot, "position": (0.9, 0.0, 0.0), "rpy_deg": (0, 0, 180)},
        }
    ).build()
    arms = tuple(arm for arm in build.arms if arm.name != "b/right")
    return replace(build, arms=arms), np.clip(
        0.3 * np.ones(build.model.nq),
        build.model.lowerPositionLimit,
        build.model.upperPositionLimit,
    )


WEIGHTS = [(1.0, 0.0, 0.0), (0.5, 0.3, 0.2), (0.0, 0.0, 1.0), (1 / 3, 1 / 3, 1 / 3)]


@pytest.mark.parametrize("weights", WEIGHTS)
def test_the_weighted_pose_moves_with_its_jacobian(
    weights: tuple[float, ...], rng: np.random.Generator
) -> None:
    """At closed loops, in all directions, those that open them too."""
    robot, q = facing_arms()
    alpha = dict(zip((arm.name for arm in robot.arms), weights, strict=True))
    grasps = {arm.name: Revolute() if "left" in arm.name else Rigid() for arm in robot.arms}
    chain = ClosedChain.attach(robot, q, grasps, HeldObject(), alpha=alpha)
    np.testing.assert_allclose(chain.alpha, weights)
    J = State(chain).J_task
    for direction in rng.normal(size=(20, chain.n)):
        before = State(chain, chain.q_start - H * direction)
        after = State(chain, chain.q_start + H * direction)
        speed = (after.p_WO - before.p_WO) / (2 * H)
        omega = pin.log3(after.R_WO @ before.R_WO.T) / (2 * H)
        np.testing.assert_allclose(J @ direction, [*speed, *omega], atol=1e-7)


def object_pose(chain: ClosedChain, arm: int, q: Array) -> pin.SE3:
    data = chain.model.createData()
    pin.framesForwardKinematics(chain.model, data, q)
    return data.oMf[chain.frames[arm]].copy()


@pytest.mark.parametrize("leader", [0, 1])
def test_leader_and_follower_is_the_pose_of_the_leader(
    nao: RobotModel, chain: ClosedChain, leader: int, rng: np.random.Generator
) -> None:
    """Also where the loops are open."""
    q_start = chain.q_start
    alpha = {("right", "left")[leader]: 1.0}
    led = ClosedChain.attach(nao, q_start, Rigid(), HeldObject(), alpha=alpha)
    for q in led.sample(rng, 20):
        state, X = State(led, q), object_pose(led, leader, q)
        np.testing.assert_allclose(state.p_WO, X.translation, atol=1e-14)
        np.testing.assert_allclose(state.R_WO, X.rotation, atol=1e-9)
        data = led.model.createData()
        J = pin.computeFrameJacobian(
            led.model, data, q, led.frames[leader], pin.LOCAL_WORLD_ALIGNED
        )
        np.testing.assert_allclose(state.J_task, J, atol=1e-12)


def test_weights_matter_only_while_loops_are_open(nao: RobotModel, chain: ClosedChain) -> None:
    alpha = {"right": 0.8, "left": 0.2}
    weighted = ClosedChain.attach(nao, chain.q_start, Rigid(), HeldObject(), alpha=alpha)
    here, there = State(chain), State(weighted)
    free = np.linalg.svd(here.J_rel)[2][6:].T
    np.testing.assert_allclose(here.J_task @ free, there.J_task @ free, atol=1e-12)
    assert np.abs(here.J_task - there.J_task).max() > 0.01
    assert State(weighted, chain.q_start + 0.1).p_WO != pytest.approx(
        State(chain, chain.q_start + 0.1).p_WO
    )


@pytest.mark.parametrize(
    ("alpha", "error", "message"),
    [
        ({"rihgt": 1.0}, UnknownNameError, "unknown arm 'rihgt'; did you mean 'right'"),
        ({"right": 1.5, "left": -0.5}, InvalidValueError, "weight of arm left: found -0.5"),
        ({"right": float("nan")}, InvalidValueError, "weight of arm right: found nan"),
        ({"right": 0.5}, InvalidValueError, r"sum to 0.5, need 1"),
        ({}, InvalidValueError, r"sum to 0, need 1"),
    ],
)
def test_weights_that_cannot_be_are_refused(
    nao: RobotModel, chain: ClosedChain, alpha: dict[str, float], error: type, message: str
) -> None:
    with pytest.raises(error, match=message):
        ClosedChain.attach(nao, chain.q_start, Rigid(), HeldObject(), alpha=alpha)


def scenario_with(folder: Path, weights: str) -> Path:
    return write(folder, GOOD.replace("grasp: rigid", f"grasp: rigid\nweights: {weights}"))


def test_a_scenario_gives_weights(tmp_path: Path) -> None:
    scenario = load(scenario_with(tmp_path, "{right: 1.0, left: 0.0}"))
    assert scenario.weights == {"right": 1.0, "left": 0.0}
    assert scenario.chain.alpha.tolist() == [1.0, 0.0]
    assert load("point_on_point").chain.alpha.tolist() == [0.5, 0.5]
    metrics = coopqp.compare(scenario, controllers=["qp"]).metrics["qp"]
    assert metrics["reached"]


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ("{rihgt: 1.0}", "weights: unknown arm 'rihgt'; did you mean 'right'?"),
        ("{right: 2.0, left: -1.0}", "weights.left: found -1.0; needs greater than or equal to 0"),
        ("{right: 0.5, left: 0.4}", "weights: the weights of the arms sum to 0.9, need 1"),
        ("{right: '1'}", 'weights.right: found "1"; needs a number'),
        ("[1, 0]", "weights: found [1, 0]; needs"),
    ],
)
def test_weights_in_a_file_are_refused_with_their_place(
    tmp_path: Path, weights: str, message: str
) -> None:
    path = scenario_with(tmp_path, weights)
    with pytest.raises(ScenarioError) as caught:
        load(path)
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"{path}:")
    assert len(caught.value.faults) == 1
