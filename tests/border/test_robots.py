"""Robot files that no parser should make something of, and joints that turn without end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import coopqp
from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.spec import Pose
from coopqp.grasps import Prismatic, Rigid
from coopqp.model.grasp_configuration import HeldObject
from coopqp.robot_files.mjcf import read_mjcf
from coopqp.robot_files.urdf import read_urdf
from coopqp.robots import Several, Urdf
from coopqp.scenario.loader import load, load_and_solve
from coopqp.scenario.start_solver import solve_start

SEEDS = Path(__file__).parents[1] / "fuzz" / "seeds"

#: File, what of it is changed, and what is then said of which line.
FAULTS: list[tuple[str, str, str, str]] = [
    (
        "dual.urdf",
        '<mass value="1"/>',
        '<mass value="-1"/>',
        "value: found '-1', needs no negative",
    ),
    ("dual.urdf", '<mass value="1"/>', '<mass value="1e9"/>', "needs sizes of at most 1e"),
    ("dual.urdf", 'axis xyz="0 1 0"', 'axis xyz="0 0 0"', "needs a direction, but all numbers are"),
    ("dual.urdf", 'axis xyz="0 1 0"', 'axis xyz="0 1"', "xyz: found '0 1', needs 3 numbers"),
    ("dual.urdf", 'xyz="0.2 -0.15 0"', 'xyz="0.2 nan 0"', "needs finite numbers"),
    ("dual.urdf", 'lower="-2"', 'lower="two"', "lower: found 'two', needs a number"),
    ("dual.urdf", 'link name="rl2"', 'link name="rl1"', "another link has this name already"),
    ("dual.urdf", 'joint name="r2"', 'joint name="r1"', "another joint has this name already"),
    (
        "dual.xml",
        'pos="0 -0.15 0"',
        'pos="0 -0.15"',
        "pos: found '0 -0.15': attribute 'pos' does not have enough",
    ),
    ("dual.xml", 'axis="0 1 0"', 'axis="0 0 0"', "axis: found '0 0 0': axis too small"),
    ("dual.xml", 'mass="0.5"', 'mass="-0.5"', "mass: found '-0.5': moves, but has no mass"),
    (
        "dual.xml",
        'fullinertia="0.01',
        'fullinertia="-0.01',
        "error 'inertia must have positive eig",
    ),
    ("dual.xml", 'size="0.02"', 'size="-0.02"', "size: found '-0.02': none may be missing"),
    ("dual.xml", 'body name="rb"', 'body name="r0"', "repeated name 'r0' in body"),
    ("dual.xml", 'angle="radian"', 'angle="gon"', "angle: invalid keyword: 'gon'"),
    ("dual.xml", 'limited="true"', 'limited="yes"', "limited: invalid keyword: 'yes'"),
    ("dual.xml", "<worldbody>", "<!DOCTYPE a><worldbody>", "not well-formed"),
    ("dual.urdf", "<robot", "<!DOCTYPE a [<!ENTITY b 'c'>]>\n<robot", "has a DOCTYPE, which is"),
]


@pytest.mark.parametrize(("name", "old", "new", "said"), FAULTS)
def test_what_no_body_can_have_is_refused_with_its_line(
    name: str, old: str, new: str, said: str, tmp_path: Path
) -> None:
    good = (SEEDS / name).read_text(encoding="utf-8")
    line = good[: good.index(old)].count("\n") + 1
    path = tmp_path / name
    path.write_text(good.replace(old, new, 1), encoding="utf-8")
    read: Callable[[Path], Any] = read_mjcf if name.endswith("xml") else read_urdf
    with pytest.raises(InvalidValueError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}:{line}: ")
    assert said in str(caught.value)


def test_deep_and_crowded_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "deep.urdf"
    path.write_text("<robot><link name='a'>" + "<b>" * 300, encoding="utf-8")
    with pytest.raises(InvalidValueError, match="more than 150 deep"):
        read_urdf(path)
    path.write_text("<robot>" + "<link/>" * 100_001 + "</robot>", encoding="utf-8")
    with pytest.raises(InvalidValueError, match="more than 100000 elements"):
        read_urdf(path)


def _endless(folder: Path) -> Urdf:
    """An arm of six joints, of which three turn without end."""
    kinds, axes = ("continuous", "revolute"), ("0 0 1", "0 1 0", "0 1 0", "0 1 0", "1 0 0", "0 0 1")
    parts = ['<robot name="r"><link name="l"/>']
    for i, axis in enumerate(axes):
        parent = f"l{i - 1}" if i else "l"
        parts.append(
            f'<link name="l{i}"/><joint name="j{i}" type="{kinds[i % 2]}"><parent link="{parent}"/>'
            f'<child link="l{i}"/><origin xyz="0 0 {0.2 if i else 0.1}"/><axis xyz="{axis}"/>'
            f'<limit lower="-2.9" upper="2.9" velocity="{1 + i}" effort="{10 + i}"/></joint>'
        )
    path = folder / "endless.urdf"
    path.write_text("".join([*parts, "</robot>"]), encoding="utf-8")
    return Urdf(path=path, arms={"arm": "l5"})


def test_joints_without_end_stand_beside_another_robot(tmp_path: Path) -> None:
    arm = _endless(tmp_path)
    placed: dict[str, Any] = {"a": {"robot": arm, "position": (0, 0.3, 0)}, "b": {"robot": arm}}
    both = Several(robots=placed).build().model
    np.testing.assert_allclose(both.velocityLimit, [1, 2, 3, 4, 5, 6] * 2)
    np.testing.assert_allclose(both.effortLimit, [10, 11, 12, 13, 14, 15] * 2)
    assert np.isinf(both.upperPositionLimit[::2]).all()


def test_a_solved_start_has_no_whole_turns_and_is_near_a_posture(tmp_path: Path) -> None:
    robot = _endless(tmp_path).build()
    data, home = robot.model.createData(), np.array([0.3, 0.4, 9.0, 0.5, -7.0, 0.2])
    pin.framesForwardKinematics(robot.model, data, home)
    X = data.oMf[robot.model.getFrameId("l5")]
    place = pin.rpy.matrixToRpy(X.rotation)
    held = HeldObject(pose=Pose(position=tuple(X.translation), rpy=tuple(place)))
    grasp = Rigid(object_in_hand=Pose())
    for seed in range(4):
        q = solve_start(robot, grasp, held, seed=seed).q
        assert np.abs(q).max() <= np.pi
    # With the posture from which the pose was made, that posture is the answer, turns and all.
    near = solve_start(robot, grasp, held, near={"arm": home.tolist()}).q
    np.testing.assert_allclose(near, home, atol=1e-6)


def test_a_file_says_what_its_start_is_near(tmp_path: Path) -> None:
    arm = _endless(tmp_path)
    text = (
        f"robot: {{urdf: {{path: {arm.path.name}, arms: {{arm: l5}}}}}}\n"
        "object: {pose: {position: [0.2, 0.1, 0.6]}}\n"
        "grasp: {rigid: {object_in_hand: {}}}\n"
        "start: solve\nstart_near: {j2: 6.0}\ntasks: [minimum_velocity]\nduration: 1\n"
    )
    path = tmp_path / "near.yaml"
    path.write_text(text, encoding="utf-8")
    assert abs(load_and_solve(path).q[2] - 6.0) <= np.pi
    path.write_text(text.replace("j2", "j9"), encoding="utf-8")
    with pytest.raises(CoopqpError, match=r"near.yaml:5: start_near: unknown arm or joint 'j9'"):
        load(path)


def test_a_range_without_room_is_refused() -> None:
    with pytest.raises(InvalidValueError, match=r"lower: found 0.2, needs less than upper, 0.1"):
        Prismatic(lower=0.2, upper=0.1)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"dt": "fast"}, "dt: found 'fast', needs a number"),
        ({"tasks": "none"}, "tasks: found 'none', needs a"),
        ({"tasks": (1,)}, "tasks: found 1 in it, needs a Task"),
        ({"robot": None}, "robot: found None, needs a Robot"),
        ({"controllers": {"qp": "qp"}}, "controllers: found 'qp' in it, needs a Controller"),
        ({"seed": 1.5}, "seed: found 1.5, needs a whole number"),
        ({"duration": True}, "duration: found True, needs a number"),
    ],
)
def test_a_scenario_with_a_field_of_another_type_is_refused(
    change: dict[str, Any], said: str
) -> None:
    with pytest.raises(InvalidValueError) as caught:
        replace(coopqp.load("point_on_point"), **change)
    assert str(caught.value).startswith(said)
