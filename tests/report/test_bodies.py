"""Shapes of a robot as they are drawn: boxes, meshes, capsules, geoms of MJCF."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

from coopqp.base.errors import UnknownNameError
from coopqp.base.spec import Array
from coopqp.report.scene.bodies import Body, robot_bodies
from coopqp.robot import Capsule, RobotModel, Shape
from coopqp.robots import Mjcf, NaoT14, PlanarPair, Several, Urdf

TETRAHEDRON = "v 0 0 0\nv 0.1 0 0\nv 0 0.2 0\nv 0 0 0.3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
#: Two arms and a head on a base; every visual is a box or a mesh, turned and moved.
LOOKS = """
  <visual><origin xyz="0.1 -0.2 0.3" rpy="0.4 0.5 -0.6"/>
    <geometry><box size="0.1 0.2 0.3"/></geometry></visual>
  <visual><origin xyz="0 0.1 0"/>
    <geometry><mesh filename="t.obj" scale="2 1 0.5"/></geometry></visual>
"""
JOINT = """
  <joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
    <origin xyz="0.2 {y} 0.1" rpy="0.3 {y} 0.2"/><axis xyz="0 0.6 0.8"/>
    <limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
"""
TREE = [("nod", "base", "head", 0.0)] + [
    (f"{side}_{i}", f"{side}{i - 1}" if i > 1 else "base", f"{side}{i}", y)
    for side, y in (("right", -0.3), ("left", 0.3))
    for i in (1, 2, 3)
]
ARMS = {"right": "right3", "left": "left3"}


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """A function that writes the robot, with its mesh or another one."""

    def write(mesh: str | None = TETRAHEDRON, looks: str = LOOKS) -> Path:
        links = "".join(f'<link name="{name}">{looks}</link>' for _, _, name, _ in TREE)
        joints = "".join(
            JOINT.format(name=name, parent=parent, child=child, y=y)
            for name, parent, child, y in TREE
        )
        path = tmp_path / "robot.urdf"
        path.write_text(
            f'<robot name="two"><link name="base">{looks}</link>{links}{joints}</robot>', "utf-8"
        )
        if mesh is not None:
            (tmp_path / "t.obj").write_text(mesh, encoding="utf-8")
        return path

    return write


def drawn(robot: RobotModel, q: Array) -> Array:
    """Vertices of all bodies in the world, shape (v, 3)."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    bodies, faults = robot_bodies(robot)
    assert not faults
    return np.concatenate([in_world(body, data) for body in bodies])


def in_world(body: Body, data: pin.Data) -> Array:
    return np.array([data.oMi[body.joint].act(point) for point in body.surface.vertices])


def by_place(points: Array) -> Array:
    """Without doubles, in an order of their own."""
    return np.unique(np.round(points, 9), axis=0)


def vertices(placed: pin.GeometryData, geometry: pin.GeometryModel) -> Array:
    """Of boxes and meshes where pinocchio places them, shape (v, 3)."""
    points = []
    for item, X in zip(geometry.geometryObjects, placed.oMg, strict=True):
        shape = item.geometry
        if isinstance(shape, coal.Box):
            corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
            points += [X.act(corner * shape.halfSide) for corner in corners]
        else:
            points += [X.act(point) for point in shape.vertices()]
    return np.array(points)


def test_boxes_and_meshes_are_where_pinocchio_has_them(
    write: Callable[..., Path], rng: np.random.Generator
) -> None:
    """Against its own reading of the file with all joints: a locked joint moves nothing."""
    path = write()
    robot = Urdf(path=path, arms=ARMS, locked={"nod": 0.7}).build()
    model = pin.buildModelFromUrdf(str(path))
    geometry = pin.buildGeomFromUrdf(
        model, str(path), pin.GeometryType.VISUAL, package_dirs=[str(path.parent)]
    )
    data, placed = model.createData(), pin.GeometryData(geometry)
    for _ in range(3):
        q = rng.uniform(-1.0, 1.0, 6)
        values = {**dict(zip(robot.joint_names, q, strict=True)), "nod": 0.7}
        whole = np.array([values[name] for name in list(model.names)[1:]])
        pin.updateGeometryPlacements(model, data, geometry, placed, whole)
        theirs, ours = by_place(vertices(placed, geometry)), by_place(drawn(robot, q))
        np.testing.assert_allclose(ours, theirs, atol=2e-9)


def test_links_belong_to_their_arm_or_to_none(write: Callable[..., Path]) -> None:
    bodies, _ = robot_bodies(Urdf(path=write(), arms=ARMS, free=["nod"]).build())
    assert [body.arm for body in sorted(bodies, key=lambda body: body.joint)] == [
        None, *(3 * [1]), None, *(3 * [0])
    ]  # fmt: skip


def test_robots_side_by_side_are_drawn_where_they_stand(write: Callable[..., Path]) -> None:
    alone = Urdf(path=write(), arms=ARMS).build()
    place = {"position": (1.0, 2.0, 3.0), "rpy": (0.1, 0.2, 0.3)}
    both = Several(
        robots={
            "a": {"robot": Urdf(path=write(), arms=ARMS)},
            "b": {"robot": Urdf(path=write(), arms=ARMS), **place},
        }
    ).build()
    X = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([1.0, 2.0, 3.0]))
    one = drawn(alone, np.zeros(6))
    expected = by_place(np.concatenate([one, [X.act(point) for point in one]]))
    np.testing.assert_allclose(by_place(drawn(both, np.zeros(12))), expected, atol=2e-9)


# ---- capsules --------------------------------------------------------------------------------


def off_capsule(points: Array, capsule: Capsule) -> Array:
    """Distance of points from the capsule's surface, shape (v,)."""
    start, along = np.array(capsule.start), np.subtract(capsule.end, capsule.start)
    share = np.clip((points - start) @ along / max(along @ along, 1e-12), 0.0, 1.0)
    return np.linalg.norm(points - start - share[:, None] * along, axis=1) - capsule.radius


def test_a_robot_with_capsules_is_drawn_with_them() -> None:
    robot = NaoT14().build()
    bodies, _ = robot_bodies(robot)
    assert len(bodies) == len(robot.capsules) == 7
    for body in bodies:
        name = robot.model.names[body.joint] if body.joint else None
        (capsule,) = (capsule for capsule in robot.capsules if capsule.joint == name)
        np.testing.assert_allclose(off_capsule(body.surface.vertices, capsule), 0.0, atol=1e-12)


def test_links_without_any_geometry_are_capsules() -> None:
    robot = PlanarPair(lengths=(0.3, 0.2, 0.1)).build()
    bodies, _ = robot_bodies(robot)
    assert [robot.model.names[body.joint] for body in bodies] == list(robot.joint_names)
    radius = 0.04 * 0.6
    for body, length in zip(bodies, 2 * (0.3, 0.2, 0.1), strict=True):
        low, high = body.surface.vertices.min(axis=0), body.surface.vertices.max(axis=0)
        np.testing.assert_allclose([low[0], high[0]], [-radius, length + radius], atol=1e-12)
        assert np.abs(body.surface.vertices[:, 1:]).max() == pytest.approx(radius)


ONLY_MESH = '<visual><geometry><mesh filename="t.obj"/></geometry></visual>'


def test_missing_meshes_are_told_and_make_way_for_capsules(write: Callable[..., Path]) -> None:
    robot = Urdf(path=write(mesh=None, looks=ONLY_MESH), arms=ARMS).build()
    assert robot.warnings == (
        "robot.urdf: 8 of 8 meshes cannot be found (t.obj, t.obj, ...); "
        "links left without geometry are drawn as capsules",
    )
    bodies, faults = robot_bodies(robot)
    assert not faults
    # The base has no next joint of an arm to reach for, the last links end at their tip.
    assert [robot.model.names[body.joint] for body in bodies] == [
        "left_1", "left_2", "right_1", "right_2"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("mesh", "why"),
    [
        ("", ": has no surface"),
        ("this is no mesh", ": has no surface"),
        ("v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n", ": has no surface"),
        ("v 0 0 0\nv 0 nan 0\n", ":2: found '0 nan 0', needs 3 numbers"),
    ],
)
def test_meshes_that_cannot_be_read_are_told(
    write: Callable[..., Path], mesh: str, why: str
) -> None:
    path = write(mesh=mesh, looks=ONLY_MESH)
    robot = Urdf(path=path, arms=ARMS).build()
    assert not robot.warnings  # the file is there; it is read when it is drawn
    bodies, faults = robot_bodies(robot)
    assert len(bodies) == 4
    assert faults == (f"mesh {path.parent / 't.obj'}{why}; not drawn",)


def test_a_shape_needs_its_frame() -> None:
    robot = PlanarPair().build()
    shape = Shape(frame="right_hnd", placement=pin.SE3.Identity(), kind="sphere", size=(0.1,))
    with pytest.raises(UnknownNameError, match="unknown frame 'right_hnd'; did you mean 'right_h"):
        replace(robot, shapes=(shape,))
    drawn = replace(shape, frame="right_hand")
    body = robot_bodies(replace(robot, shapes=(drawn,)))[0][2]
    assert robot.model.names[body.joint] == "right_3"
    off = np.linalg.norm(body.surface.vertices - [0.1, 0.0, 0.0], axis=1)
    np.testing.assert_allclose(off, 0.1)


# ---- MJCF ------------------------------------------------------------------------------------


MJCF = """
<mujoco model="two">
  <compiler angle="radian" meshdir="meshes"/>
  <default>
    <default class="look"><geom contype="0" conaffinity="0" group="2"/></default>
    <default class="hit"><geom group="3"/></default>
    <default class="rod"><geom type="capsule" size="0.03"/></default>
  </default>
  <asset><mesh name="tet" file="t.obj" scale="2 1 0.5"/></asset>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <geom name="table" type="box" size="0.1 0.2 0.3" pos="1 0 0" euler="0.1 0.2 0.3"/>
    ARMS
  </worldbody>
</mujoco>
"""
MJCF_ARM = """
    <body name="SIDE1" pos="0 Y 0" euler="0.1 0 0">
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <joint name="SIDEa" axis="0 0 1"/>
      <geom name="SIDErod" class="rod" fromto="0 0 0 0.3 0.1 0"/>
      <body name="SIDE2" pos="0.3 0.1 0">
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        <joint name="SIDEb" axis="0 1 0"/><joint name="SIDEc" axis="1 0 0"/>
        <geom name="SIDEbox" class="look" type="box" size="0.02 0.03 0.04" quat="0.8 0 0.6 0"/>
        <geom name="SIDEball" type="ellipsoid" size="0.02 0.03 0.04" pos="0.1 0 0"/>
        <geom name="SIDEtin" type="cylinder" size="0.02 0.05" pos="0 0.1 0"/>
        <geom class="look" type="mesh" mesh="tet"/>
        <geom class="hit" size="0.5"/>
      </body>
    </body>
"""


@pytest.fixture
def mjcf(tmp_path: Path) -> Path:
    arms = (MJCF_ARM.replace("SIDE", side).replace("Y", y) for side, y in (("r", "-1"), ("l", "1")))
    path = tmp_path / "two.xml"
    path.write_text(MJCF.replace("ARMS", "".join(arms)), encoding="utf-8")
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "t.obj").write_text(TETRAHEDRON, encoding="utf-8")
    return path


def test_geoms_are_where_mujoco_has_them(mjcf: Path, rng: np.random.Generator) -> None:
    mujoco = pytest.importorskip("mujoco")
    robot = Mjcf(path=mjcf, arms={"right": "r2", "left": "l2"}).build()
    assert not robot.warnings
    theirs = mujoco.MjModel.from_xml_path(str(mjcf))
    state, data = mujoco.MjData(theirs), robot.model.createData()
    q = rng.uniform(-1.0, 1.0, 6)
    for name, value in zip(robot.joint_names, q, strict=True):
        state.qpos[theirs.joint(name).qposadr[0]] = value
    mujoco.mj_forward(theirs, state)
    pin.framesForwardKinematics(robot.model, data, q)
    placed = []
    for shape in robot.shapes:
        X = data.oMf[robot.model.getFrameId(shape.frame)] * shape.placement
        placed.append((shape.kind, X.translation, X.rotation, shape.size))
    kinds = sorted(kind for kind, *_ in placed)
    assert kinds == sorted(["box"] + 2 * ["box", "capsule", "cylinder", "ellipsoid", "mesh"])
    halves = {"capsule": (1.0, 0.5), "cylinder": (1.0, 0.5), "box": (0.5, 0.5, 0.5)}
    for name in ("table", *(f"{s}{what}" for s in "rl" for what in ("rod", "box", "ball", "tin"))):
        geom, at = theirs.geom(name), state.geom(name)
        kind, p, R, size = min(placed, key=lambda item: float(np.linalg.norm(item[1] - at.xpos)))
        np.testing.assert_allclose(p, at.xpos, atol=1e-9)
        # How far they reach in every direction, since a capsule may be turned end to end.
        reach = np.diag(geom.size if kind in ("box", "ellipsoid") else (0.0, 0.0, 1.0))
        turned = at.xmat.reshape(3, 3) @ reach
        np.testing.assert_allclose(R @ reach @ reach @ R.T, turned @ turned.T, atol=1e-9)
        own = np.multiply(size, halves.get(kind, (1.0, 1.0, 1.0)))
        np.testing.assert_allclose(own, geom.size[: len(size)], atol=1e-9)


def test_meshes_of_mjcf_are_drawn_in_their_body(mjcf: Path) -> None:
    robot = Mjcf(path=mjcf, arms={"right": "r2", "left": "l2"}).build()
    mesh = next(shape for shape in robot.shapes if shape.kind == "mesh")
    assert mesh.mesh == mjcf.parent / "meshes" / "t.obj"
    assert mesh.size == (2.0, 1.0, 0.5)
    bodies, faults = robot_bodies(replace(robot, shapes=(mesh,)))
    assert not faults
    (body,) = (body for body in bodies if robot.model.names[body.joint] == "rc")
    expected = [[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0, 0, 0.15]]
    np.testing.assert_allclose(by_place(body.surface.vertices), by_place(np.array(expected)))
