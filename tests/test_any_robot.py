"""Robots that nobody here wrote, three arms, weights of the arms: rank, mobility, motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from shipped_here import HAS_ROBOTS, LOADABLE

import coopqp
from coopqp.closed_chain import ClosedChain
from coopqp.closed_loop.mobility import Mobility, mobility
from coopqp.comparison import Comparison
from coopqp.errors import InvalidValueError, ScenarioError, UnknownNameError
from coopqp.grasps import Revolute, Rigid
from coopqp.held_object import HeldObject
from coopqp.robot import RobotModel
from coopqp.robots import ExampleRobot, Several, example_robot
from coopqp.scenario.loader import load, shipped
from coopqp.state import State

Array = NDArray[np.float64]
H = 1e-5  # step of the central differences [rad]
needs_robots = pytest.mark.skipif(not HAS_ROBOTS, reason="needs coopqp[robots]")


# ---- what each scenario allows ---------------------------------------------------------------


#: joints, rank, freedom, freedom of the object, of those the motors decide.
MOBILITY = {
    "baxter_tray": (14, 6, 8, 6, 6),
    "tiago_torso": (15, 6, 9, 6, 6),
    "two_pandas": (14, 6, 8, 6, 6),
    "three_ur": (18, 12, 6, 6, 6),
    "yeo_4_5": (10, 6, 4, 4, 4),
    "planar_pair": (6, 3, 3, 3, 3),
    "point_on_point": (10, 6, 4, 4, 4),
    "rigid_vs_passive": (12, 6, 6, 6, 6),
}


@cache
def study(name: str) -> Mobility:
    return mobility(load(name).chain)


@pytest.mark.parametrize("name", [name for name in MOBILITY if name in LOADABLE])
def test_rank_and_mobility_are_right(name: str) -> None:
    found = study(name)
    assert (
        len(found.joints), found.rank, found.freedom, found.object_freedom, found.motor_freedom
    ) == MOBILITY[name]  # fmt: skip
    assert found.rank_start == found.rank, "the start is regular"
    assert found.object_freedom_start == found.object_freedom
    # Grübler's count for each loop of six rows, three for the planar one.
    loops = len(load(name).chain.arms) - 1
    assert found.rank == loops * (3 if name == "planar_pair" else 6)


@pytest.mark.parametrize("name", [name for name in MOBILITY if name in LOADABLE])
def test_there_is_a_good_scheme_at_the_start(name: str) -> None:
    found = study(name)
    assert found.freedom == len(found.schemes[0].joints)
    assert any(scheme.admissible_start for scheme in found.schemes)


def test_a_scheme_that_moves_no_loop_is_inadmissible() -> None:
    """Yeo's arms: the left hand's roll stays at zero, for the right hand cannot roll."""
    schemes = study("yeo_4_5").schemes
    assert study("yeo_4_5").schemes_complete
    assert not any(scheme.admissible_start for scheme in schemes if "l5" in scheme.joints)
    J = load("yeo_4_5").chain.loop_jacobian(load("yeo_4_5").chain.q_start)
    free = np.linalg.svd(J)[2][6:]
    roll = load("yeo_4_5").chain.joint_names.index("l5")
    assert np.abs(free[:, roll]).max() < 1e-9


@needs_robots
def test_three_rigid_arms_of_seven_joints_have_rank_12_and_mobility_9() -> None:
    def panda(angle: float) -> dict[str, Any]:
        robot = ExampleRobot(name="panda", arms={"arm": "panda_hand_tcp"})
        x, y = np.cos(angle), np.sin(angle)
        return {"robot": robot, "position": (x, y, 0.0), "rpy": (0.0, 0.0, angle + np.pi)}

    names = ("a", "b", "c")
    robots = {name: panda(2 * np.pi * i / 3) for i, name in enumerate(names)}
    robot = Several(robots=robots).build()
    home = [0.0, -0.3, 0.0, -2.0, 0.0, 1.9, 0.7]
    q = robot.configuration({f"{name}/arm": home for name in names})
    found = mobility(ClosedChain.take_hold(robot, q, Rigid(), HeldObject()))
    assert (found.rank, found.freedom, found.object_freedom) == (12, 9, 6)


@needs_robots
def test_a_shared_torso_moves_the_object_and_opens_no_loop() -> None:
    chain = load("tiago_torso").chain
    state = State(chain)
    lift = chain.joint_names.index("torso_lift_joint")
    np.testing.assert_allclose(state.J_task[:, lift], [0, 0, 1, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(state.J_rel[:, lift], 0.0, atol=1e-12)
    alone = np.eye(chain.n)[lift]
    assert np.abs(state.J_rel @ alone).max() < 1e-12


# ---- what the controllers do -----------------------------------------------------------------


NEW = ("baxter_tray", "tiago_torso", "two_pandas", "three_ur", "yeo_4_5")


@cache
def comparison(name: str) -> Comparison:
    return coopqp.compare(load(name))


def of(name: str, controller: str) -> Mapping[str, Any]:
    return comparison(name).metrics[controller]


@pytest.mark.parametrize("name", [name for name in NEW if name in LOADABLE])
def test_the_qp_reaches_its_goals_with_loops_closed_inside_the_limits(name: str) -> None:
    metrics = of(name, "qp")
    assert metrics["reached"]
    assert max(metrics["task_error"].values()) < 1e-4
    assert metrics["limit_violation_max"] == 0.0
    assert metrics["velocity_violation_max"] == 0.0
    assert metrics["loop_error_max"]["position"] < 1e-5
    assert metrics["loop_error_max"]["orientation"] < 1e-5
    trace = comparison(name).traces["qp"]
    assert 0.05 < np.linalg.norm(trace.position[-1] - trace.position[0]) < 0.2


@needs_robots
def test_the_tray_stays_level_all_the_way() -> None:
    """Against our own tasks: the angle between the tray's normal and the vertical."""
    trace = comparison("baxter_tray").traces["qp"]
    up = trace.rotation.reshape(-1, 3, 3)[:, 2, 2]
    assert np.arccos(np.clip(up, -1.0, 1.0)).max() < 1e-3


@needs_robots
def test_the_torso_keeps_its_limits_with_the_qp_alone() -> None:
    assert of("tiago_torso", "pseudoinverse")["limit_violation_max"] > 1e-3
    assert of("tiago_torso", "pseudoinverse")["velocity_violation_max"] > 0.01
    trace = comparison("tiago_torso").traces["qp"]
    lift = trace.joints.index("torso_lift_joint")
    assert trace.q[-1, lift] - trace.q[0, lift] > 0.05  # it takes part


def test_without_the_package_a_scenario_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Empty:
        PackageNotFoundError = metadata.PackageNotFoundError

        @staticmethod
        def distribution(name: str) -> None:
            raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(example_robot, "metadata", Empty)
    for name in ("baxter_tray", "two_pandas"):  # by itself, and one of several
        with pytest.raises(ScenarioError, match=r"robot: .*pip install 'coopqp\[robots\]'"):
            load(name)


# ---- absolute variables ----------------------------------------------------------------------


def three_arms() -> tuple[RobotModel, Array]:
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
    robot, q = three_arms()
    alpha = dict(zip((arm.name for arm in robot.arms), weights, strict=True))
    grasps = {arm.name: Revolute() if "left" in arm.name else Rigid() for arm in robot.arms}
    chain = ClosedChain.take_hold(robot, q, grasps, HeldObject(), alpha=alpha)
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
    led = ClosedChain.take_hold(nao, q_start, Rigid(), HeldObject(), alpha=alpha)
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
    weighted = ClosedChain.take_hold(nao, chain.q_start, Rigid(), HeldObject(), alpha=alpha)
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
        ClosedChain.take_hold(nao, chain.q_start, Rigid(), HeldObject(), alpha=alpha)


GOOD = shipped()["point_on_point"].read_text(encoding="utf-8")


def scenario_with(folder: Path, weights: str) -> Path:
    path = folder / "weighted.yaml"
    path.write_text(GOOD.replace("grasp: rigid", f"grasp: rigid\nweights: {weights}"), "utf-8")
    return path


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
        ("{rihgt: 1.0}", "weights.rihgt: unknown arm 'rihgt'; did you mean 'right'?"),
        ("{right: 2.0, left: -1.0}", "weights.left: found -1.0; needs greater than or equal to 0"),
        ("{right: 0.5, left: 0.4}", "weights: the weights of the arms sum to 0.9, need 1"),
        ("{right: '1'}", 'weights.right: found "1"; needs a valid number'),
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


def test_passive_joints_keep_the_armatures_of_the_motors(nao: RobotModel) -> None:
    """What appendModel of pinocchio forgets."""
    model = nao.model.copy()
    model.armature = np.linspace(0.1, 1.0, model.nv)
    robot = replace(nao, model=model)
    chain = ClosedChain.take_hold(robot, np.zeros(model.nv), Revolute(), HeldObject())
    for name, armature in zip(robot.joint_names, model.armature, strict=True):
        at = chain.model.idx_vs[chain.model.getJointId(name)]
        assert chain.model.armature[at] == armature
    assert (chain.model.armature[chain.passive] == 0.0).all()
