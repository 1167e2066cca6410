"""MJCF files as MuJoCo reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from coopqp.base.errors import InvalidValueError
from coopqp.robot_files.mjcf import read_mjcf
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
