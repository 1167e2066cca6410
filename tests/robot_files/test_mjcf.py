"""MJCF files as MuJoCo reads them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from coopqp.base.errors import InvalidValueError, MissingDependencyError
from coopqp.robot_files.meshes import read_mesh
from coopqp.robot_files.mjcf import read_mjcf
from coopqp.robot_files.selection import Description
from coopqp.robots import Mjcf

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
        "<body pos='0 0.3 1'><freejoint name='base'/><geom size='.1'/><body>",
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


TIPS = {"left": "l_hand", "right": "r_hand"}


def test_includes_that_are_missing_or_circular_are_refused(tmp_path: Path) -> None:
    path = write_world(tmp_path, WORLD.replace("part.xml", "no.xml"))
    with pytest.raises(
        InvalidValueError, match=r"world.xml:4: <include>: .*no.xml: cannot be read"
    ):
        Mjcf(path=path, arms=TIPS).build()
    path = write_world(tmp_path, WORLD.replace("part.xml", "world.xml"))
    with pytest.raises(InvalidValueError, match="is included already"):
        Mjcf(path=path, arms=TIPS).build()


BODY = """<mujoco>{top}<worldbody>
<body name="a"><joint name="j" {joint}/>{geom}
  <frame pos="0.1 0 0.2" euler="30 0 0">
    <body name="b" pos="0.1 0 0"><joint name="k" type="slide" axis="1 1 0" ref="0.1" range="0 1"/>
      <geom size="0.1"/><site name="tip"/></body></frame></body>
</worldbody>{bottom}</mujoco>"""
BALL = '<geom size="0.1"/>'


def read_body(folder: Path, **parts: str) -> tuple[Description, Path]:
    path = folder / "body.xml"
    given = {"top": "", "joint": "", "geom": BALL, "bottom": "", **parts}
    path.write_text(BODY.format(**given), encoding="utf-8")
    return read_mjcf(path), path


def test_references_and_frames_are_where_mujoco_has_them(tmp_path: Path) -> None:
    """A joint that the file draws at 30 degrees is there at 30 degrees, not at zero."""
    mujoco = pytest.importorskip("mujoco")
    joint = 'ref="30" pos="0.3 0 0.1" axis="1 2 3" range="-90 90"'
    found, path = read_body(tmp_path, joint=joint)
    theirs = mujoco.MjModel.from_xml_path(str(path))
    state, data = mujoco.MjData(theirs), found.model.createData()
    for q in (theirs.qpos0, np.zeros(2), np.array([0.3, 0.7])):
        state.qpos[:] = q
        mujoco.mj_forward(theirs, state)
        pin.framesForwardKinematics(found.model, data, np.array(q))
        X = data.oMf[found.model.getFrameId("tip")]
        np.testing.assert_allclose(X.translation, state.site("tip").xpos, atol=1e-12)
        np.testing.assert_allclose(X.rotation.ravel(), state.site("tip").xmat, atol=1e-12)
    np.testing.assert_allclose(found.model.lowerPositionLimit, theirs.jnt_range[:, 0])


MOTORS = [
    ('<motor joint="j" ctrlrange="-2 2" gear="3"/>', 6.0),
    ('<motor joint="j" ctrllimited="false" ctrlrange="-2 2"/>', np.inf),
    ('<motor joint="j" ctrlrange="-2 3" gear="-3"/>', 6.0),
    ('<motor joint="j" ctrlrange="-2 2"/><motor joint="j" forcerange="-1 5"/>', 3.0),
    ('<motor joint="j" ctrlrange="-2 2"/><motor joint="j"/>', np.inf),
    ('<position joint="j" kp="100" forcerange="-7 8" gear="2" ctrlrange="-1 1"/>', 14.0),
    ('<position joint="j" kp="100" ctrlrange="-1 1"/>', np.inf),
    ('<general joint="j" gainprm="4" ctrlrange="-1 1" forcerange="-9 9"/>', 4.0),
    ('<motor joint="k" ctrlrange="-2 2"/><plugin joint="j" plugin="mine"/>', np.inf),
    ("", np.inf),
]


@pytest.mark.parametrize(("motors", "most"), MOTORS)
def test_motors_say_what_a_joint_can_give(tmp_path: Path, motors: str, most: float) -> None:
    bottom = f"<actuator>{motors}</actuator>"
    assert read_body(tmp_path, bottom=bottom)[0].model.effortLimit[0] == most
    ours = 'actuatorfrcrange="-5 9"'
    found, _ = read_body(tmp_path, bottom=bottom, joint=ours)
    assert found.model.effortLimit[0] == min(most, 5.0)


CUBE = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + "".join(
    f"f {face}\n" for face in ("1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4")
)


def test_a_body_weighs_what_its_mesh_does(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    (tmp_path / "cube.obj").write_text(CUBE, encoding="utf-8")
    mesh = '<asset><mesh file="cube.obj" scale="0.1 0.2 0.3" refpos="0.5 0 0"/></asset>'
    geom = '<geom type="mesh" mesh="cube" pos="1 2 3" euler="10 20 30"/>'
    found, path = read_body(tmp_path, top=mesh, geom=geom)
    theirs = mujoco.MjModel.from_xml_path(str(path))
    assert found.model.inertias[1].mass == pytest.approx(6.0, rel=1e-6)
    np.testing.assert_allclose(found.model.inertias[1].lever, theirs.body_ipos[1], atol=1e-6)
    data = mujoco.MjData(theirs)
    mujoco.mj_forward(theirs, data)
    corners = data.geom_xpos[0] + theirs.mesh_vert @ data.geom_xmat[0].reshape(3, 3).T
    shape = found.shapes[0]
    drawn = read_mesh(tmp_path / "cube.obj", shape.size).vertices
    drawn = drawn @ shape.placement.rotation.T + shape.placement.translation
    np.testing.assert_allclose(np.sort(drawn, axis=0), np.sort(corners, axis=0), atol=1e-6)
    (tmp_path / "cube.obj").unlink()
    found = read_mjcf(path)
    assert found.model.inertias[1].mass < 1e-6
    assert "body.xml: 1 bodies lack the mass of meshes that are not read" in found.warnings[1]


def test_sections_stand_in_any_order(tmp_path: Path) -> None:
    """A body before the defaults was "unordered_map::at"."""
    text = WORLD.replace("<include", "<worldbody><body name='shelf'/></worldbody><include", 1)
    start, end = text.index("<default>"), text.index("<worldbody>")
    path = write_world(tmp_path, text[:start] + text[end:])
    path.write_text(path.read_text().replace("</mujoco>", text[start:end] + "</mujoco>"))
    found = read_mjcf(path).model
    np.testing.assert_allclose(found.upperPositionLimit[2], np.radians(80))


def test_without_mujoco_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'coopqp\[mujoco\]'"):
        read_mjcf(write_world(tmp_path))


def test_what_comes_to_more_than_anybody_builds_is_refused(tmp_path: Path) -> None:
    for geom, said in (
        ('<geom size="0.1" pos="0 0 1e5"/>', r"<geom> pos: comes to 100000, needs sizes of at"),
        ('<geom size="0.1" mass="1e9"/>', r"<body name=.a.> mass: comes to 1e\+09, needs sizes"),
        ('<geom size="nan"/>', r"<geom> size: found 'nan', needs finite numbers"),
    ):
        with pytest.raises(InvalidValueError, match=rf"body.xml:2: {said}"):
            read_body(tmp_path, geom=geom)


def test_a_long_word_is_refused_with_its_line(tmp_path: Path) -> None:
    """MuJoCo cuts its message before the line."""
    with pytest.raises(InvalidValueError, match=r"body.xml:2: found '1 1 1 .*more than 250 lett"):
        read_body(tmp_path, geom=f'<geom size="0.1" class="{"1 " * 400}"/>')
