"""Which joints are free, which are locked, and files that are no robot."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from chains import held

from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.robots import Mjcf, Several, Urdf


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
    ({"old": "</robot>", "new": ""}, "tree.urdf:1: is not a URDF file: no element found"),
    (
        {"old": 'link="base"', "new": 'link="bas"'},
        r"tree.urdf:1: <parent> of joint turn: unknown link 'bas'; did you mean 'base'\?",
    ),
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
    with pytest.raises(InvalidValueError, match="cannot be read: is a folder"):
        Urdf(path=tmp_path, arms=TIPS).build()
    (tmp_path / "b.urdf").write_bytes(bytes(range(256)))
    with pytest.raises(InvalidValueError, match="is not a URDF file"):
        Urdf(path=tmp_path / "b.urdf", arms=TIPS).build()


def test_no_arm_at_all_is_refused() -> None:
    with pytest.raises(InvalidValueError, match="needs arms by name"):
        Urdf(path=Path("x"), arms={})
