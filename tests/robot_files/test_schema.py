"""What robot files misspell is refused with its line; what they rightly have is not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from scenario_files import needs_robots

from coopqp.base.errors import InvalidValueError
from coopqp.robot_files.mjcf import read_mjcf
from coopqp.robot_files.urdf import _check_schema, read_urdf
from coopqp.robot_files.xml import read_xml
from coopqp.robots import example_robot

SEEDS = Path(__file__).parents[1] / "fuzz" / "seeds"

#: What of the seed is changed, and what is then said; MuJoCo refuses all of these, too.
MJCF = [
    ('<geom type="capsule"', '<geon type="capsule"', "unknown element 'geon'; did you mean 'geom'"),
    ('<joint name="r2"', '<jiont name="r2"', "unknown element 'jiont'; did you mean 'joint'"),
    ("<worldbody>", "<actuators/><worldbody>", "'actuators'; did you mean 'actuator'"),
    ('axis="0 1 0"', 'axes="0 1 0"', "unknown attribute 'axes'; did you mean 'axis'"),
    ('euler="0 0 0.3"', 'eular="0 0 0.3"', "unknown attribute 'eular'; did you mean 'euler'"),
    ('site name="grip" pos', 'site name="grip" position', "'position'; it is called 'pos' here"),
    ('geom density="500"', 'geom conafinity="0"', "did you mean 'conaffinity'"),
    ('default class="stiff"', 'default clas="stiff"', "unknown attribute 'clas'; did you mean"),
    ("compiler angle", "compiler angel", "unknown attribute 'angel'; did you mean 'angle'"),
    ('type="capsule"', 'type="capsul"', "type: invalid keyword: 'capsul'; did you mean 'capsule'"),
    ('type="capsule"', 'type="mesh"', "type: found 'mesh': type mesh needs a mesh"),
    ('size="0.02 0.1"', 'size="0.02"', "size: found '0.02': none may be missing"),
    ('size="0.02 0.1"', 'radius="0.02"', "unknown attribute 'radius'; it is called 'size' here"),
    ('size="0.02 0.1"', 'fromto="0 0 1 0 0 1" size="1"', "found '0 0 1 0 0 1': fromto points"),
    ('<geom size="0.02"', '<geom fromto="0 0 1 0 0 2" size="1"', "fromto requires capsule, cyl"),
    ('<geom size="0.02"', "<geom", "none may be missing, and each size must be"),
    ('name="r2" axis', 'name="r2" type="revolute" axis', "'revolute'; it is called 'hinge' here"),
    ('name="r2" axis', 'name="r2" type="prismatic" axis', "it is called 'slide' here"),
    ('name="r2" axis', 'name="r2" type="continuous" axis', "it is called 'hinge' here"),
    ('range="-2 2"', 'range="2 -2"', "range: found '2 -2': range[0] should be sma"),
    ('joint1="l3"', 'joint1="l33"', "joint1: unknown element 'l33' in equality"),
]  # fmt: skip
URDF = [
    ("<axis xyz", "<axis xzy", "unknown attribute 'xzy'; did you mean 'xyz'"),
    ("<axis xyz", "<axs xyz", "unknown element 'axs'; did you mean 'axis'"),
    ('<link name="base">', '<lnik/><link name="base">', "'lnik'; did you mean 'link'"),
    ("<visual>", "<colision/><visual>", "unknown element 'colision'; did you mean 'collision'"),
    ("<cylinder radius", "<cylinder raduis", "'raduis'; did you mean 'radius'"),
    ('<cylinder radius="0.02"', "<cylinder", "<cylinder>: needs radius"),
    ('<inertia ixx="0.01"', "<inertia", "<inertia>: needs ixx"),
    ('lower="', 'lowr="', "unknown attribute 'lowr'; did you mean 'lower'"),
    ('velocity="', 'velocty="', "unknown attribute 'velocty'; did you mean 'velocity'"),
    ('lower="-2"', 'lower="3"', "lower 3 is above upper 2; swap them"),
    ('type="revolute"', 'type="revolut"', "type: unknown type 'revolut'; did you mean 'revolute'"),
    ('type="revolute"', 'type="hinge"', "type: unknown type 'hinge'; it is called 'revolute' here"),
    ('parent link="rl1"', 'parent link="rll"', "of joint r2: unknown link 'rll'; did you mean 'r"),
    ('child link="rl2"', 'child link="rl1"', "link rl1 is the child of joint r1 already"),
    (
        '"r2" type="revolute">\n<parent link="rl1"/>',
        '"r2" type="revolute">',
        "needs <parent link=>",
    ),
    ('<joint name="l1"', '<link name="shelf"/><joint name="l1"', "is the child of no joint, as is"),
    ('velocity="', 'current="', "<limit>: needs velocity"),
]


@pytest.mark.parametrize(
    ("name", "old", "new", "said"),
    [("dual.xml", *fault) for fault in MJCF] + [("dual.urdf", *fault) for fault in URDF],
)
def test_what_is_misspelt_is_refused_with_its_line(
    name: str, old: str, new: str, said: str, tmp_path: Path
) -> None:
    good, path = (SEEDS / name).read_text(encoding="utf-8"), tmp_path / name
    path.write_text(good.replace(old, new, 1), encoding="utf-8")
    read: Callable[[Path], Any] = read_mjcf if name.endswith("xml") else read_urdf
    with pytest.raises(InvalidValueError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}:{good[: good.index(old)].count(chr(10)) + 1}: ")
    assert said in str(caught.value)


@pytest.mark.parametrize(("old", "new"), [fault[:2] for fault in MJCF])
def test_mujoco_refuses_the_same(old: str, new: str) -> None:
    mujoco = pytest.importorskip("mujoco")
    good = (SEEDS / "dual.xml").read_text(encoding="utf-8")
    files = {name: (SEEDS / name).read_bytes() for name in ("m.obj", "b.stl")}
    mujoco.MjModel.from_xml_string(good, files)
    with pytest.raises(ValueError, match=r"\w"):
        mujoco.MjModel.from_xml_string(good.replace(old, new, 1), files)


@needs_robots
def test_published_robots_are_not_refused() -> None:
    """With all that simulators and makers add: gazebo, transmission, ros2_control, limits."""
    read = 0
    for path in example_robot.robots().values():
        xml = read_xml(path, ["robot"], "URDF")
        if xml.find("link") is not None:
            _check_schema(xml)
            read += 1
    assert read > 50


def test_what_makers_add_is_passed_over(tmp_path: Path) -> None:
    text = (SEEDS / "dual.urdf").read_text(encoding="utf-8")
    own = '<gazebo><colision/></gazebo><transmission/><ros2_control name="x"/><drake:joint a="1"/>'
    text = text.replace('<link name="base">', f'{own}<link name="base"><contact/><self_filter/>', 1)
    text = text.replace('velocity="3"', 'velocity="3" acceleration="9" gear_velocity="7"', 1)
    path = tmp_path / "own.urdf"
    path.write_text(text, encoding="utf-8")
    assert read_urdf(path).model.njoints == read_urdf(SEEDS / "dual.urdf").model.njoints


@pytest.mark.parametrize("tag", ["replicate", "attach", "composite", "flexcomp"])
def test_what_makes_bodies_and_is_not_read_is_refused(tag: str, tmp_path: Path) -> None:
    """For pinocchio they are not there, with all the bodies in them."""
    good, path = (SEEDS / "dual.xml").read_text(encoding="utf-8"), tmp_path / "made.xml"
    path.write_text(good.replace('<body name="r0"', f'<{tag}/><body name="r0"'), encoding="utf-8")
    with pytest.raises(InvalidValueError, match=rf"made.xml:18: <{tag}>: is not read; "):
        read_mjcf(path)
