"""Robots from files, tables and packages: the same robot in every form, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from coopqp.closed_chain import ClosedChain
from coopqp.controller_run import run
from coopqp.errors import (
    CoopqpError,
    InvalidValueError,
    MissingDependencyError,
    ScenarioError,
    UnknownNameError,
)
from coopqp.grasps import Rigid
from coopqp.held_object import HeldObject
from coopqp.robot import Robot, RobotModel
from coopqp.robot_files.mjcf import read_mjcf
from coopqp.robots import (
    ExampleRobot,
    MdhTable,
    Mjcf,
    NaoT14,
    PlanarPair,
    Several,
    Urdf,
    example_robot,
    nao_t14,
)
from coopqp.robots.mdh_table import TableRow, TableTip
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.form import check, chosen, file_model
from coopqp.scenario.loader import load, shipped
from coopqp.scenario.yaml import read_yaml
from coopqp.tasks import PointOnPoint

Array = NDArray[np.float64]
HANDS = {"right": "RHand", "left": "LHand"}
SAME = 1e-9  # runs of one robot in several forms, configurations [rad]


# ---- writers: one tree in several forms ------------------------------------------------------


def words(numbers: Any) -> str:
    """Numbers as they stand in XML, exact."""
    return " ".join(repr(float(number)) for number in numbers)


def six(inertia: pin.Inertia) -> list[float]:
    """Ixx iyy izz ixy ixz iyz."""
    I = inertia.inertia  # noqa: E741
    return [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]


def urdf_text(robot: RobotModel) -> str:
    """A robot with joints about z as URDF."""
    model = robot.model
    links = {0: "base", **{j: f"{model.names[j]}_link" for j in range(1, model.njoints)}}
    lines = ['<robot name="nao">', '<link name="base"/>']
    for j in range(1, model.njoints):
        body = model.inertias[j]
        keys = zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), six(body), strict=True)
        inertia = " ".join(f'{key}="{float(value)!r}"' for key, value in keys)
        lines.append(
            f'<link name="{links[j]}"><inertial><origin xyz="{words(body.lever)}"/>'
            f'<mass value="{words([body.mass])}"/><inertia {inertia}/></inertial></link>'
            f'<joint name="{model.names[j]}" type="revolute">{origin(model.jointPlacements[j])}'
            f'<parent link="{links[model.parents[j]]}"/><child link="{links[j]}"/>'
            f'<axis xyz="0 0 1"/><limit {urdf_limits(model, j)}/></joint>'
        )
    for arm in robot.arms:
        tip = model.frames[model.getFrameId(arm.tip)]
        lines.append(
            f'<link name="{arm.tip}"/><joint name="{arm.tip}_mount" type="fixed">'
            f'{origin(tip.placement)}<parent link="{links[tip.parentJoint]}"/>'
            f'<child link="{arm.tip}"/></joint>'
        )
    return "\n".join([*lines, "</robot>"])


def origin(X: pin.SE3) -> str:
    return f'<origin xyz="{words(X.translation)}" rpy="{words(pin.rpy.matrixToRpy(X.rotation))}"/>'


def urdf_limits(model: pin.Model, j: int) -> str:
    keys = {
        "lower": model.lowerPositionLimit,
        "upper": model.upperPositionLimit,
        "velocity": model.velocityLimit,
        "effort": model.effortLimit,
    }
    return " ".join(f'{key}="{words(values[j - 1 : j])}"' for key, values in keys.items())


def mjcf_text(robot: RobotModel) -> str:
    """A robot with joints about z as MJCF: one body in the world for each arm."""
    model = robot.model

    def pose(X: pin.SE3) -> str:
        x, y, z, w = pin.Quaternion(X.rotation).coeffs()
        return f'pos="{words(X.translation)}" quat="{words([w, x, y, z])}"'

    def body(j: int) -> str:
        link = model.inertias[j]
        ends = words([model.lowerPositionLimit[j - 1], model.upperPositionLimit[j - 1]])
        torque = model.effortLimit[j - 1]
        tips = [f for f in model.frames if f.parentJoint == j and f.name in HANDS.values()]
        sites = "".join(f'<site name="{tip.name}" {pose(tip.placement)}/>' for tip in tips)
        inside = "".join(body(k) for k in range(1, model.njoints) if model.parents[k] == j)
        return (
            f'<body name="{model.names[j]}_link" {pose(model.jointPlacements[j])}>'
            f'<joint name="{model.names[j]}" axis="0 0 1" range="{ends}" '
            f'actuatorfrcrange="{words([-torque, torque])}"/>'
            f'<inertial mass="{words([link.mass])}" pos="{words(link.lever)}" '
            f'fullinertia="{words(six(link))}"/>{sites}{inside}</body>'
        )

    arms = "".join(body(j) for j in range(1, model.njoints) if model.parents[j] == 0)
    return (
        '<mujoco model="nao"><compiler angle="radian" autolimits="true"/>'
        f"<worldbody>{arms}</worldbody></mujoco>"
    )


def in_urdf(folder: Path) -> Robot:
    (folder / "nao.urdf").write_text(urdf_text(NaoT14().build()), encoding="utf-8")
    return Urdf(path=folder / "nao.urdf", arms=HANDS)


def in_mjcf(folder: Path) -> Robot:
    (folder / "nao.xml").write_text(mjcf_text(NaoT14().build()), encoding="utf-8")
    speeds = {f"*{name}": {"velocity": speed} for name, _, _, speed, _ in nao_t14.JOINTS}
    return Mjcf(path=folder / "nao.xml", arms=HANDS, joint_limits=speeds)


def in_table(_: Path) -> Robot:
    rows = []
    for row in [*nao_t14.arm_table("R"), *nao_t14.arm_table("L")]:
        p, link = row.parameters, row.link
        assert link is not None
        rows.append(
            TableRow(
                name=row.name, antecedent=row.antecedent,
                gamma=p.gamma, b=p.b, alpha_deg=math.degrees(p.alpha), d=p.d, theta=p.theta, r=p.r,
                lower=row.lower, upper=row.upper, velocity=row.velocity, effort=row.effort,
                mass=link.mass, com=link.com, inertia=link.inertia, axes="base",
            )
        )  # fmt: skip
    tips = {f"{s}Hand": TableTip(parent=f"{s}WristYaw", offset=nao_t14.HAND) for s in "RL"}
    return MdhTable(rows=tuple(rows), tips=tips, arms=HANDS)


@pytest.mark.parametrize("form", [in_urdf, in_mjcf, in_table])
@pytest.mark.parametrize("controller", ["qp", "pseudoinverse_null_space"])
def test_nao_runs_the_same_in_every_form(
    tmp_path: Path, form: Callable[[Path], Robot], controller: str
) -> None:
    scenario = load("point_on_point")
    other = replace(scenario, robot=form(tmp_path))
    mine, theirs = run(scenario, controller=controller), run(other, controller=controller)
    assert mine.ticks == 300
    order = [theirs.joints.index(joint) for joint in mine.joints]  # URDF sorts its arms
    assert np.abs(theirs.q[:, order] - mine.q).max() < SAME
    assert np.abs(theirs.position - mine.position).max() < SAME


@pytest.mark.parametrize("form", [in_urdf, in_mjcf, in_table])
def test_nao_has_the_same_masses_and_limits_in_every_form(
    tmp_path: Path, form: Callable[[Path], Robot], rng: np.random.Generator
) -> None:
    mine, theirs = NaoT14().build().model, form(tmp_path).build().model
    at = [theirs.idx_vs[theirs.getJointId(name)] for name in list(mine.names)[1:]]
    q = rng.uniform(-1.0, 1.0, 10)
    q_theirs = np.zeros(10)
    q_theirs[at] = q
    M = pin.crba(theirs, theirs.createData(), q_theirs)[np.ix_(at, at)]
    np.testing.assert_allclose(M, pin.crba(mine, mine.createData(), q), rtol=0, atol=1e-14)
    for key in ("lowerPositionLimit", "upperPositionLimit", "velocityLimit", "effortLimit"):
        np.testing.assert_allclose(getattr(theirs, key)[at], getattr(mine, key), atol=1e-15)


# ---- in a scenario ---------------------------------------------------------------------------

GOOD = shipped()["point_on_point"].read_text(encoding="utf-8")


def scenario_with(folder: Path, robot: str) -> Path:
    """A scenario whose robot is spelled in one line."""
    path = folder / "scenario.yaml"
    text = GOOD.replace("robot: nao_t14", f"robot: {robot}")
    path.write_text(text, encoding="utf-8")
    return path


def test_a_path_counts_from_the_scenario_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "models").mkdir()
    in_urdf(tmp_path / "models")
    path = scenario_with(
        tmp_path, "{urdf: {path: models/nao.urdf, arms: {right: RHand, left: LHand}}}"
    )
    monkeypatch.chdir("/")
    assert load(path).robot_model.joint_names[0] == "LShoulderPitch"
    monkeypatch.chdir(tmp_path)
    assert load("scenario.yaml").robot_model.name == "nao"


TABLE = """
  mdh_table:
    rows:                       # a(j), sigma, gamma, b, alpha, d, theta, r
      - {name: 1, antecedent: 0, sigma: 0, b: 0.1, lower_deg: -90, upper_deg: 90}
      - {name: slide, antecedent: 1, sigma: prismatic, alpha_deg: 90, lower: 0, upper: 0.5}
      - {name: wrist, antecedent: slide, sigma: fixed, d: 0.1}
      - {name: 3, antecedent: wrist, theta_deg: 90, velocity_deg: 180, mass: 1, com: [0, 0, 0.1]}
      - {name: b1, gamma_deg: 90}
    arms: {left: 3, right: hand}
    tips: {hand: {parent: b1, offset: [0.1, 0, 0]}}
"""


def test_a_table_is_read_as_it_is_printed(tmp_path: Path) -> None:
    path = tmp_path / "table.yaml"
    rest = "tasks: [point_on_point: {goal: [0, 0, 1]}]\nduration: 1\n"
    path.write_text(f"robot:{TABLE}{rest}", encoding="utf-8")
    read: Any = check(read_yaml(path), file_model(Catalog()))
    robot = chosen(read.robot)[1].build()
    assert robot.joint_names == ("1", "slide", "3", "b1")
    model = robot.model
    np.testing.assert_allclose(model.upperPositionLimit, [math.pi / 2, 0.5, np.inf, np.inf])
    np.testing.assert_allclose(model.velocityLimit, [np.inf, np.inf, math.pi, np.inf])
    assert model.effortLimit[0] == np.inf
    assert [arm.name for arm in robot.arms] == ["left", "right"]


TWO_PAIRS = (
    "{several: {robots: {a: {robot: {planar_pair: {distance: 0.5}}},"
    " b: {robot: planar_pair, position: [1, 0, 0], rpy_deg: [0, 0, 180]}}}}"
)


def test_faults_inside_one_of_several_robots_have_their_place(tmp_path: Path) -> None:
    for old, new, message in (
        ("distance: 0.5", "distanc: 0.5", "planar_pair.distanc: unknown key 'distanc'; did you"),
        ("distance: 0.5", "distance: -1", "distance: found -1; needs greater than 0"),
        ("planar_pair, pos", "planar_pear, pos", "2: robot.several.robots.b.robot: unknown robot"),
        ("position: [1, 0, 0]", "position: [1, 0]", "b.position: found [1, 0]; needs 3 numbers"),
        ("position", "positoin", "unknown key 'positoin'; did you mean 'position'"),
        ("rpy_deg", "rpy: [0, 0, 1], rpy_deg", "not both"),
        ("{robot: planar_pair, position", "{position", "b.robot: is missing"),
    ):  # fmt: skip
        assert old in TWO_PAIRS
        with pytest.raises(ScenarioError) as caught:
            load(scenario_with(tmp_path, TWO_PAIRS.replace(old, new, 1)))
        assert message in str(caught.value)
        assert len(caught.value.faults) == 1


def test_a_robot_that_cannot_be_read_is_a_fault_of_the_scenario(tmp_path: Path) -> None:
    path = scenario_with(tmp_path, "{urdf: {path: none.urdf, arms: {right: a, left: b}}}")
    with pytest.raises(ScenarioError, match=r"scenario.yaml:2: robot: .*none.urdf: cannot be read"):
        load(path)


# ---- several bases ---------------------------------------------------------------------------


def test_several_robots_stand_where_they_are_put(rng: np.random.Generator) -> None:
    pair = PlanarPair()
    placed = {
        "a": {"robot": pair, "position": (0.0, 1.0, 0.2), "rpy_deg": (0.0, 30.0, 90.0)},
        "b": {"robot": Several(robots={"in": {"robot": pair}}), "position": (2.0, 0.0, 0.0)},
    }
    alone, both = pair.build(), Several(robots=placed).build()
    assert [arm.name for arm in both.arms] == ["a/right", "a/left", "b/in/right", "b/in/left"]
    assert both.joint_names[6] == "b/in/right_1"
    assert both.model.check(both.model.createData())
    q = rng.uniform(-1.0, 1.0, 12)
    for name, part in (("a/", slice(0, 6)), ("b/in/", slice(6, 12))):
        own, data = alone.model.createData(), both.model.createData()
        pin.framesForwardKinematics(alone.model, own, q[part])
        pin.framesForwardKinematics(both.model, data, q)
        place: Any = placed[name[0]]
        R = pin.rpy.rpyToMatrix(*np.radians(place.get("rpy_deg", (0, 0, 0))))
        X = pin.SE3(R, np.array(place["position"]))
        tip = own.oMf[alone.model.getFrameId("left_hand")]
        found = data.oMf[both.model.getFrameId(f"{name}left_hand")]
        np.testing.assert_allclose(found.homogeneous, (X * tip).homogeneous, atol=1e-14)
    np.testing.assert_allclose(both.model.velocityLimit, [*alone.model.velocityLimit] * 2)


def test_bodies_that_must_not_hit_others_come_along() -> None:
    placed = {"robot": NaoT14(), "position": (0.0, 1.0, 0.5), "rpy_deg": (0.0, 0.0, 90.0)}
    alone, one = NaoT14().build().capsules, Several(robots={"a": placed}).build().capsules
    assert [capsule.name for capsule in one] == [f"a/{capsule.name}" for capsule in alone]
    x, y, z = alone[0].start  # the torso, fixed to the base
    np.testing.assert_allclose(one[0].start, (-y, 1.0 + x, 0.5 + z), atol=1e-15)
    assert one[1].joint == f"a/{alone[1].joint}"
    assert one[1].start == alone[1].start


def test_a_robot_among_several_must_be_one() -> None:
    with pytest.raises(InvalidValueError, match="needs a robot"):
        Several(robots={"a": {"robot": "nao_t14"}})


# ---- robots by name --------------------------------------------------------------------------

try:
    metadata.distribution(example_robot.PACKAGE)
    HAS_ROBOTS = True
except metadata.PackageNotFoundError:
    HAS_ROBOTS = False
needs_robots = pytest.mark.skipif(not HAS_ROBOTS, reason="needs coopqp[robots]")

BAXTER = {"right": "right_gripper", "left": "left_gripper"}
TIAGO = {"right": "arm_right_tool_link", "left": "arm_left_tool_link"}
PR2 = {"right": "r_gripper_tool_frame", "left": "l_gripper_tool_frame"}


def held(robot: RobotModel, q: Array | None = None) -> ClosedChain:
    return ClosedChain(robot, robot.configuration({}) if q is None else q, Rigid(), HeldObject())


@needs_robots
def test_baxter_has_two_arms_of_seven_joints() -> None:
    robot = ExampleRobot(name="baxter", arms=BAXTER).build()
    assert [len(robot.arm_joints(arm)) for arm in robot.arms] == [7, 7]
    assert "head_pan" not in robot.joint_names
    assert robot.model.nq == 14
    assert not robot.warnings
    assert len(robot.shapes) > 20
    for shape in robot.shapes:
        assert robot.model.existFrame(shape.frame)
        assert shape.mesh is None or shape.mesh.is_file()
    assert np.isfinite(robot.model.velocityLimit).all()


@needs_robots
def test_a_shared_torso_moves_both_arms(rng: np.random.Generator) -> None:
    robot = ExampleRobot(name="tiago_dual", arms=TIAGO).build()
    assert robot.joint_names[0] == "torso_lift_joint"
    assert robot.model.nq == 15
    chain = held(robot)
    torso = chain.joint_names.index("torso_lift_joint")
    for q in chain.sample(rng, 5):
        up = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
        np.testing.assert_allclose(chain.object_jacobians(q)[:, :, torso], [up, up], atol=1e-12)
        # It moves both hands alike, so that no loop opens.
        np.testing.assert_allclose(chain.loop_jacobian(q)[:, torso], 0.0, atol=1e-12)
    locked = ExampleRobot(name="tiago_dual", arms=TIAGO, locked={"torso_lift_joint": 0.3}).build()
    assert locked.joint_names == robot.joint_names[1:]


@needs_robots
def test_a_locked_joint_stays_at_its_value() -> None:
    heights = []
    for lift in (0.0, 0.3):
        robot = ExampleRobot(
            name="tiago_dual", arms=TIAGO, locked={"torso_lift_joint": lift}
        ).build()
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, robot.configuration({}))
        heights.append(data.oMf[robot.model.getFrameId(TIAGO["left"])].translation[2])
    assert heights[1] - heights[0] == pytest.approx(0.3, abs=1e-12)


@needs_robots
def test_joints_that_turn_without_end_have_one_coordinate(rng: np.random.Generator) -> None:
    path = example_robot.robots()["pr2"]
    whole = pin.buildModelFromUrdf(str(path))
    robot = ExampleRobot(name="pr2", arms=PR2).build()
    roll = robot.joint_names.index("l_wrist_roll_joint")
    assert robot.model.nq == robot.model.nv == 15
    assert robot.model.lowerPositionLimit[roll] == -np.inf
    assert robot.model.velocityLimit[roll] == pytest.approx(3.6)
    q = rng.uniform(-0.3, 0.3, 15)
    q_whole = pin.neutral(whole)
    for name, value in zip(robot.joint_names, q, strict=True):
        joint = whole.joints[whole.getJointId(name)]
        both = [math.cos(value), math.sin(value)] if joint.nq == 2 else [value]
        q_whole[joint.idx_q : joint.idx_q + joint.nq] = both
    mine, theirs = robot.model.createData(), whole.createData()
    pin.framesForwardKinematics(robot.model, mine, q)
    pin.framesForwardKinematics(whole, theirs, q_whole)
    for tip in PR2.values():
        found, wanted = robot.model.getFrameId(tip), whole.getFrameId(tip)
        np.testing.assert_allclose(
            mine.oMf[found].homogeneous, theirs.oMf[wanted].homogeneous, atol=1e-12
        )
    assert pin.computeTotalMass(robot.model) <= pin.computeTotalMass(whole)
    at = [whole.joints[whole.getJointId(name)].idx_v for name in robot.joint_names]
    M = pin.crba(whole, theirs, q_whole)
    M = np.triu(M) + np.triu(M, 1).T
    found = pin.crba(robot.model, mine, q)
    found = np.triu(found) + np.triu(found, 1).T
    np.testing.assert_allclose(found, M[np.ix_(at, at)], atol=1e-10)


@needs_robots
def test_two_pandas_hold_one_object() -> None:
    pair = panda_pair().build()
    assert [arm.name for arm in pair.arms] == ["left/arm", "right/arm"]
    assert pair.joint_names[7] == "right/panda_joint1"
    q = pair.configuration({"left/arm": PANDA_BENT, "right/arm": PANDA_BENT})
    chain = held(pair, q)
    assert chain.loops.rank == 6


BAXTER_BENT = [-0.4, -0.6, 0.0, 1.3, 0.0, 0.8, 0.0]  # right arm, forward and down
PANDA_BENT = [0.0, 0.3, 0.0, -1.8, 0.0, 2.1, 0.8]


def panda_pair() -> Several:
    panda = ExampleRobot(name="panda", arms={"arm": "panda_hand_tcp"})
    return Several(
        robots={
            "left": {"robot": panda, "position": (0.0, 0.4, 0.0)},
            "right": {"robot": panda, "position": (0.0, -0.4, 0.0)},
        }
    )


def baxter_pose() -> dict[str, list[float]]:
    mirror = np.array([-1, 1, -1, 1, -1, 1, -1])
    return {"right": BAXTER_BENT, "left": list(mirror * BAXTER_BENT)}


@needs_robots
@pytest.mark.parametrize(
    ("robot", "start"),
    [
        (ExampleRobot(name="baxter", arms=BAXTER), baxter_pose()),
        (panda_pair(), {"left/arm": PANDA_BENT, "right/arm": PANDA_BENT}),
    ],
    ids=["baxter", "two_pandas"],
)
def test_the_object_is_carried_by_robots_from_the_package(
    robot: Robot, start: dict[str, list[float]]
) -> None:
    scenario = replace(load("point_on_point"), robot=robot, start=start, duration=2.5)
    goal = scenario.chain.start_position + np.array([0.03, 0.02, 0.05])
    scenario = replace(scenario, tasks=(PointOnPoint(name="lift", goal=tuple(goal), gain=5.0),))
    trace = run(scenario, controller="qp")
    assert trace.usable.all()
    assert np.linalg.norm(trace.position[-1] - goal) < 1e-3
    assert trace.loop_position.max() < 1e-4


@needs_robots
@pytest.mark.parametrize(
    ("name", "arms"),
    [
        ("talos_full_v2", {"right": "gripper_right_base_link", "left": "gripper_left_base_link"}),
        ("romeo", {"right": "r_gripper", "left": "l_gripper"}),
        ("icub", {"right": "r_hand", "left": "l_hand"}),
        ("g1_29dof_rev_1_0", {"right": "right_rubber_hand", "left": "left_rubber_hand"}),
    ],
)
def test_humanoids_load_with_their_torso_joints(name: str, arms: dict[str, str]) -> None:
    robot = ExampleRobot(name=name, arms=arms).build()
    right, left = (set(robot.arm_joints(arm)) for arm in robot.arms)
    assert right & left, "the torso moves both arms"
    assert right - left
    assert left - right
    assert (robot.model.velocityLimit > 0.0).all()


@needs_robots
def test_an_unknown_example_robot_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="unknown example robot 'baxtre'; did you mean 'b"):
        ExampleRobot(name="baxtre", arms=BAXTER).build()


def test_the_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(example_robot, "PACKAGE", "no-such-package-here")
    with pytest.raises(MissingDependencyError, match=r"pip install 'coopqp\[robots\]'"):
        ExampleRobot(name="baxter", arms=BAXTER).build()


# ---- MJCF as MuJoCo reads it -----------------------------------------------------------------

WORLD = """<mujoco model="two"><compiler angle="degree"/>
<default><joint axis="0 1 0" range="-80 80"/>
  <default class="slow"><joint axis="1 0 0" range="-10 20"/></default></default>
<include file="part.xml"/>
<worldbody>
  <body name="cup" pos="2 0 0"><freejoint name="cup"/><geom size="0.1"/></body>
  <body pos="0 0.3 1" euler="10 20 30">
    <joint name="a1" pos="0.1 0 0"/><joint name="a2" class="slow"/>
    <joint name="a3" type="slide" range="0 1" axis="0 1 1"/>
    <inertial mass="1" pos="0.1 0 0" diaginertia="0.1 0.1 0.1"/>
    <body name="fore" childclass="slow" pos="0.3 0 0" quat="0.5 0.5 0.5 0.5">
      <joint name="a4"/><joint name="a5" axis="0 0 1"/>
      <geom type="box" size=".1 .1 .2" pos="0 0 .2" mass="2"/>
      <body pos="0.1 0 0"><joint name="a6"/><geom size="0.1" mass="0.3"/><site name="tip_a"/>
      </body>
    </body>
  </body>
</worldbody></mujoco>"""

PART = """<mujocoinclude><worldbody><body name="other" pos="0 -0.3 1">
  <joint name="b1" axis="0 0 1"/><geom type="capsule" size=".1 .2" mass="1"/>
  <body name="b" pos="0 0 .5"><joint name="b2" armature="0.1"/><geom size=".1" mass="1"/>
    <site name="tip_b" pos="0 0 1"/></body>
</body></worldbody></mujocoinclude>"""


def write_world(folder: Path, text: str = WORLD) -> Path:
    (folder / "part.xml").write_text(PART, encoding="utf-8")
    (folder / "world.xml").write_text(text, encoding="utf-8")
    return folder / "world.xml"


def test_an_mjcf_file_moves_as_in_mujoco(tmp_path: Path, rng: np.random.Generator) -> None:
    mujoco = pytest.importorskip("mujoco")
    path = write_world(tmp_path)
    robot = Mjcf(path=path, arms={"a": "tip_a", "b": "tip_b"}).build()
    assert robot.joint_names == ("b1", "b2", "a1", "a2", "a3", "a4", "a5", "a6")
    theirs = mujoco.MjModel.from_xml_path(str(path))
    state, data = mujoco.MjData(theirs), robot.model.createData()
    at_v = [theirs.joint(name).dofadr[0] for name in robot.joint_names]
    for _ in range(5):
        q = rng.uniform(-0.5, 0.5, 8)
        for name, value in zip(robot.joint_names, q, strict=True):
            state.qpos[theirs.joint(name).qposadr[0]] = value
        mujoco.mj_forward(theirs, state)
        pin.framesForwardKinematics(robot.model, data, q)
        for tip in ("tip_a", "tip_b"):
            X, site = data.oMf[robot.model.getFrameId(tip)], state.site(tip)
            np.testing.assert_allclose(X.translation, site.xpos, atol=1e-12)
            np.testing.assert_allclose(X.rotation, site.xmat.reshape(3, 3), atol=1e-12)
        gravity = pin.computeGeneralizedGravity(robot.model, data, q)
        np.testing.assert_allclose(gravity, state.qfrc_bias[at_v], atol=1e-10)
    limits = np.array([theirs.joint(name).range for name in robot.joint_names])
    np.testing.assert_allclose(robot.model.lowerPositionLimit, limits[:, 0])
    np.testing.assert_allclose(robot.model.upperPositionLimit, limits[:, 1])
    assert np.isinf(robot.model.velocityLimit).all()
    assert robot.model.armature.tolist() == [0.0, 0.1] + 6 * [0.0]


def test_keyframes_and_missing_meshes_do_not_matter(tmp_path: Path) -> None:
    text = WORLD.replace("<default>", '<asset><mesh name="m" file="m.stl"/></asset><default>', 1)
    text = text.replace("</mujoco>", '<keyframe><key qpos="0"/></keyframe></mujoco>')
    robot = Mjcf(path=write_world(tmp_path, text), arms={"a": "tip_a", "b": "tip_b"}).build()
    assert robot.warnings == (
        "world.xml: 1 of 1 meshes cannot be found (m.stl); "
        "links left without geometry are drawn as capsules",
    )


def test_a_floating_base_is_fixed_only_when_told(tmp_path: Path) -> None:
    text = WORLD.replace(
        '<body pos="0 0.3 1" euler="10 20 30">',
        "<body pos='0 0.3 1'><freejoint name='base'/><body>",
    )
    path = write_world(tmp_path, text.replace("</worldbody>", "</body></worldbody>"))
    arms = {"a": "tip_a", "b": "tip_b"}
    with pytest.raises(InvalidValueError, match=r"joint base: is floating and .* under lock"):
        Mjcf(path=path, arms=arms).build()
    robot = Mjcf(path=path, arms=arms, locked=["base"]).build()
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, np.zeros(8))
    assert data.oMi[robot.model.getJointId("a1")].translation[2] == pytest.approx(1.0)


UNLIMITED = """
<mujoco>
  <default>
    <joint limited="false"/>
    <default class="on"><joint limited="true"/><default class="in"/></default>
    <default class="off"><joint axis="0 1 0"/></default>
  </default>
  <worldbody>
    <body name="a" childclass="on"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <joint name="a1" range="-30 40"/><joint name="a2" class="off" range="-30 40"/>
      <body name="a_hand"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        <joint name="a3" class="in" range="-30 40"/></body>
    </body>
    <body name="b"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <joint name="b1" range="-30 40"/><joint name="b2" axis="1 0 0" limited="true" range="-30 40"/>
      <joint name="b3" type="slide" limited="auto" range="-0.3 0.4"/>
    </body>
  </worldbody>
</mujoco>
"""


def test_ranges_count_where_mujoco_counts_them(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    path = tmp_path / "ranges.xml"
    path.write_text(UNLIMITED, encoding="utf-8")
    robot = Mjcf(path=path, arms={"a": "a_hand", "b": "b"}).build()
    theirs = mujoco.MjModel.from_xml_path(str(path))
    limited = []
    for i, name in enumerate(robot.joint_names):
        found = robot.model.lowerPositionLimit[i], robot.model.upperPositionLimit[i]
        if theirs.joint(name).limited[0]:
            limited.append(name)
            np.testing.assert_allclose(found, theirs.joint(name).range)
        else:
            assert found == (-np.inf, np.inf)
    assert limited == ["a1", "a3", "b2", "b3"]


def test_an_equality_makes_a_joint_follow(tmp_path: Path) -> None:
    tie = '<equality><joint joint1="a6" joint2="a5" polycoef="0.1 2 0 0 0"/></equality>'
    path = write_world(tmp_path, WORLD.replace("</mujoco>", f"{tie}</mujoco>"))
    arms = {"a": "tip_a", "b": "tip_b"}
    assert read_mjcf(path).followers["a6"].offset == 0.1
    with pytest.raises(InvalidValueError, match=r"joint a6: follows a5 \(mimic\) and cannot"):
        Mjcf(path=path, arms=arms).build()
    assert "a6" not in Mjcf(path=path, arms=arms, locked=["a6"]).build().joint_names


# ---- which joints are free -------------------------------------------------------------------


def link(name: str, extra: str = "") -> str:
    return (
        f'<link name="{name}"><inertial><mass value="1"/>'
        f'<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>{extra}</link>'
    )


def joint(name: str, parent: str, child: str, kind: str = "revolute", extra: str = "") -> str:
    limit = '<limit lower="-1" upper="1" velocity="2" effort="3"/>' if "<limit" not in extra else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.1 0 0.2"/><axis xyz="0 1 0"/>{limit}{extra}</joint>'
    )


TREE = [
    *(link(name) for name in ("base", "torso", "head", "l1", "l2", "l_hand", "r1", "r2")),
    link("r_hand", '<visual><geometry><mesh filename="package://tree/hand.stl"/></geometry></visual>'
    '<visual><geometry><mesh filename="finger.stl"/></geometry></visual>'
    '<visual><geometry><box size="1 2 3"/></geometry></visual>'),
    joint("turn", "base", "torso"),
    joint("nod", "torso", "head", extra='<limit lower="0.2" upper="1" velocity="0" effort="0"/>'),
    joint("l_a", "torso", "l1"), joint("l_b", "l1", "l2"), joint("l_c", "l2", "l_hand"),
    joint("r_a", "torso", "r1"), joint("r_b", "r1", "r2"), joint("r_c", "r2", "r_hand"),
]  # fmt: skip
TIPS = {"left": "l_hand", "right": "r_hand"}


@pytest.fixture
def tree(tmp_path: Path) -> Callable[..., Urdf]:
    """A function that writes a torso with two arms and a head, changed, as a robot."""

    def write(old: str = "", new: str = "", **keys: Any) -> Urdf:
        text = f'<robot name="tree">{"".join(TREE)}</robot>'
        assert old in text
        path = tmp_path / "tree.urdf"
        path.write_text(text.replace(old, new, 1) if old else text, encoding="utf-8")
        return Urdf(path=path, **{"arms": TIPS, **keys})

    return write


def test_joints_of_no_arm_are_locked(tree: Callable[..., Urdf]) -> None:
    ways = ("turn", "l_a", "l_b", "l_c", "r_a", "r_b", "r_c")
    assert tree().build().joint_names == ways
    assert set(tree(free=["nod"]).build().joint_names) == {*ways, "nod"}
    assert tree(locked=["turn"]).build().joint_names == ways[1:]
    named = {"left": {"tip": "l_hand", "joints": ["l_b", "l_c"]}, "right": "r_hand"}
    assert tree(arms=named).build().joint_names == ("turn", "l_b", "l_c", "r_a", "r_b", "r_c")
    named["right"] = {"tip": "r_hand", "joints": ["r_c"]}
    assert tree(arms=named).build().joint_names == ("l_b", "l_c", "r_c")
    assert tree(arms=named, free=["turn"]).build().joint_names == ("turn", "l_b", "l_c", "r_c")


def test_a_locked_joint_is_at_zero_or_its_nearest_limit(tree: Callable[..., Urdf]) -> None:
    for keys, angle in (({}, 0.2), ({"locked": {"nod": 0.7}}, 0.7)):
        robot = tree(**keys).build()
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, np.zeros(7))
        R = data.oMf[robot.model.getFrameId("head")].rotation
        assert math.atan2(R[0, 2], R[0, 0]) == pytest.approx(angle)


def test_zero_speed_and_torque_mean_no_limit(tree: Callable[..., Urdf]) -> None:
    robot = tree(free=["nod"], joint_limits={"l_*": {"velocity": 9, "lower": -0.5}}).build()
    at = robot.joint_names.index
    assert robot.model.velocityLimit[at("nod")] == np.inf
    assert robot.model.effortLimit[at("nod")] == np.inf
    assert robot.model.velocityLimit[at("r_a")] == 2.0
    assert robot.model.velocityLimit[at("l_b")] == 9.0
    assert robot.model.lowerPositionLimit[at("l_c")] == -0.5


def test_meshes_are_found_or_left_out(tree: Callable[..., Urdf], tmp_path: Path) -> None:
    robot = tree().build()
    assert robot.warnings == (
        "tree.urdf: 2 of 2 meshes cannot be found (package://tree/hand.stl, finger.stl); "
        "links left without geometry are drawn as capsules",
    )
    assert [shape.size for shape in robot.shapes] == [(1.0, 2.0, 3.0)]
    (tmp_path / "else" / "tree").mkdir(parents=True)
    for file in (tmp_path / "else" / "tree" / "hand.stl", tmp_path / "finger.stl"):
        file.touch()
    robot = tree(package_dirs=[tmp_path / "else"]).build()
    assert not robot.warnings
    assert [shape.kind for shape in robot.shapes] == ["mesh", "mesh", "box"]


def test_links_and_joints_may_share_a_name(tree: Callable[..., Urdf]) -> None:
    robot = tree('name="l_c"', 'name="l_hand"').build()
    assert robot.arm_joints(robot.arms[0])[-1] == "l_hand"
    held(robot)
    assert len(Several(robots={"a": {"robot": tree()}}).build().joint_names) == 7


def test_a_finger_follows_its_locked_leader(tree: Callable[..., Urdf]) -> None:
    mimic = '<mimic joint="l_c" multiplier="-2" offset="0.1"/></joint>'
    one = tree("</joint>", mimic)  # the first joint: turn
    with pytest.raises(InvalidValueError, match=r"joint turn: follows l_c \(mimic\) and cannot"):
        one.build()
    robot = tree("</joint>", mimic, locked={"turn": None, "l_c": 0.2}).build()
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, np.zeros(5))
    R = data.oMf[robot.model.getFrameId("torso")].rotation
    assert math.atan2(R[0, 2], R[0, 0]) == pytest.approx(-0.3)


def test_a_follower_that_is_kept_still_is_told(tree: Callable[..., Urdf]) -> None:
    nod = '<limit lower="0.2" upper="1" velocity="0" effort="0"/>'
    robot = tree(nod, f'{nod}<mimic joint="turn"/>').build()
    assert "tree: joint nod follows turn, but is kept still" in robot.warnings


def test_a_shared_joint_has_one_start_value(tree: Callable[..., Urdf]) -> None:
    robot = tree().build()
    q = robot.configuration({"left": [0.5, 0, 0, 0], "right": [0.5, 1, 0, 0]})
    assert q.tolist() == [0.5, 0, 0, 0, 1, 0, 0]
    with pytest.raises(InvalidValueError, match=r"right: found 0.4 for turn, which left shares"):
        robot.configuration({"left": [0.5, 0, 0, 0], "right": [0.4, 1, 0, 0]})


FLOATING = ('<joint name="turn" type="revolute">', '<joint name="turn" type="floating">')

#: what to change in the tree, and what the message must say.
REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"arms": {"left": "l_hand", "right": "r_hnd"}}, "arm right: unknown frame 'r_hnd'; did you"),
    ({"locked": ["trun"]}, "locked: unknown joint 'trun'; did you mean 'turn'"),
    ({"free": ["nood"]}, "free: unknown joint 'nood'; did you mean 'nod'"),
    ({"free": ["nod"], "locked": ["nod"]}, "joint nod: is listed under free and under locked"),
    ({"locked": {"nod": 2}}, "locked: joint nod at 2 is outside its limits 0.2 to 1"),
    ({"arms": {"left": {"tip": "l_hand", "joints": ["l_x"]}}}, "arm left: unknown joint 'l_x'"),
    (
        {"arms": {"left": {"tip": "l_hand", "joints": ["r_a"]}}},
        "arm left: joint r_a does not move the tip l_hand; those that do: turn, l_a, l_b, l_c",
    ),
    ({"arms": {"a": "l_hand", "b": "l_hand"}}, "arm a: all its joints .* also move arm b"),
    ({"arms": {"a": "l_hand", "b": "torso"}}, r"arm b: all its joints \(turn\) also move arm a"),
    ({"arms": {"a": "l_hand", "b": "base"}}, "arm b: no free joint between the base and its tip"),
    ({"locked": ["turn", "r_a", "r_b", "r_c"]}, "arm right: no free joint between the base"),
    ({"old": FLOATING[0], "new": FLOATING[1]}, "joint turn: is floating, with 6 coordinates, and"),
    (
        {"old": FLOATING[0], "new": FLOATING[1], "locked": {"turn": 1}},
        "joint turn has 6 coordinates; give its name without a value",
    ),
    ({"old": '"revolute"', "new": '"planar"'}, "joint turn: is planar, with 3 coordinates, and"),
    ({"old": 'lower="-1" upper="1"', "new": ""}, "joint turn: limits 0 to 0 leave it no room"),
    ({"joint_limits": {"x_*": {"lower": 1}}}, r"joint_limits: unknown joint 'x_\*'"),
    ({"joint_limits": {"l_a": {"lower": 2}}}, "joint l_a: limits 2 to 1 leave it no room"),
    ({"old": "</robot>", "new": ""}, "tree.urdf: is not a URDF file: no element found"),
    ({"old": 'link="base"', "new": 'link="bas"'}, "tree.urdf: "),
    ({"old": "<robot", "new": "<robot xmlns:xacro='x'><xacro:a/></robot><!--"}, "URDF|xacro"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "message"), REFUSED)
def test_a_choice_that_cannot_be_is_refused_in_words(
    tree: Callable[..., Urdf], changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(CoopqpError, match=message) as caught:
        tree(**changes).build()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", [Urdf, Mjcf])
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is not a (URDF|MJCF) file: no element found"),
        ("hello", "is not a (URDF|MJCF) file: syntax error"),
        ("<sdf/>", "starts with <sdf>, needs <(robot|mujoco)>"),
        ("<robot/>", "has no <link>|starts with <robot>"),
        ("<mujoco/>", "has no <body>|starts with <mujoco>"),
        (None, "cannot be read: No such file"),
    ],
)
def test_a_file_that_is_no_robot_is_refused(
    tmp_path: Path, kind: type[Urdf] | type[Mjcf], text: str | None, message: str
) -> None:
    path = tmp_path / "robot.xml"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidValueError, match=message) as caught:
        kind(path=path, arms=TIPS).build()
    assert str(caught.value).startswith(str(path))


def test_a_folder_or_binary_file_is_no_robot(tmp_path: Path) -> None:
    with pytest.raises(InvalidValueError, match="cannot be read: Is a directory"):
        Urdf(path=tmp_path, arms=TIPS).build()
    (tmp_path / "b.urdf").write_bytes(bytes(range(256)))
    with pytest.raises(InvalidValueError, match="is not a URDF file"):
        Urdf(path=tmp_path / "b.urdf", arms=TIPS).build()


def test_includes_that_are_missing_or_circular_are_refused(tmp_path: Path) -> None:
    path = write_world(tmp_path, WORLD.replace("part.xml", "no.xml"))
    with pytest.raises(InvalidValueError, match=r"no.xml: included file cannot be read"):
        Mjcf(path=path, arms=TIPS).build()
    path = write_world(tmp_path, WORLD.replace("part.xml", "world.xml"))
    with pytest.raises(InvalidValueError, match="include each other without end"):
        Mjcf(path=path, arms=TIPS).build()


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"name": "a", "gamma": 1, "gamma_deg": 1}, "not both"),
        ({"name": "a", "com": [0, 0, 1]}, "need a mass"),
        ({"name": "a", "sigma": "prismatic", "upper_deg": 3}, "a prismatic joint has no degrees"),
        ({"name": "a", "sigma": "helical"}, "'revolute', 'prismatic' or 'fixed'"),
        ({"name": "a", "velocity": 0}, "greater than 0"),
    ],
)
def test_a_row_that_cannot_be_is_refused(row: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidValueError, match=message):
        TableRow(**row)


def test_a_table_that_cannot_be_is_refused() -> None:
    row = TableRow(name="a", antecedent="z")
    with pytest.raises(UnknownNameError, match="row a: unknown antecedent 'z'"):
        MdhTable(rows=(row,), arms={"x": "a"}).build()
    row = TableRow(name="a", mass=1, inertia=(1, 0, 0, 1, 0, 3))
    with pytest.raises(InvalidValueError, match="principal moments"):
        MdhTable(rows=(row,), arms={"x": "a"}).build()


def test_no_arm_at_all_is_refused() -> None:
    with pytest.raises(InvalidValueError, match="needs arms by name"):
        Urdf(path=Path("x"), arms={})


def test_a_fault_of_one_of_several_names_the_robot() -> None:
    with pytest.raises(CoopqpError, match=r"robot a: no.urdf: cannot be read"):
        Several(robots={"a": {"robot": Urdf(path="no.urdf", arms=TIPS)}}).build()


DOCS = Path(__file__).parents[1] / "docs" / "robots.md"


def test_the_examples_of_the_manual_are_good(tmp_path: Path) -> None:
    blocks = [part.split("```", 1)[0] for part in DOCS.read_text("utf-8").split("```yaml\n")[1:]]
    rest = "tasks: [point_on_point: {goal: [0, 0, 1]}]\nduration: 1\n"
    seen = set()
    for block in blocks:
        path = tmp_path / "manual.yaml"
        path.write_text(block + rest, encoding="utf-8")
        read: Any = check(read_yaml(path), file_model(Catalog()))
        name, robot = chosen(read.robot)
        seen.add(name)
        if name == "mdh_table" or (HAS_ROBOTS and name in ("example_robot", "several")):
            assert len(robot.build().arms) > 1
    assert seen >= {"urdf", "mjcf", "mdh_table", "example_robot", "several"}
