"""Robots that can hit themselves, and their distances as pinocchio and coal find them.

Nothing here uses how coopqp reads collision geometry: pinocchio reads the URDF file with all its
joints, coal makes the meshes' convex hulls (with the qhull it was built with) and measures.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import coal
import numpy as np
import pinocchio as pin

from coopqp.base.qp import names_of
from coopqp.base.spec import Array
from coopqp.grasps import Rigid
from coopqp.limit import Limit
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.robot import Robot
from coopqp.robot_files.selection import ArmJoints
from coopqp.robots import Several
from coopqp.robots.example_robot import ExampleRobot, robots
from coopqp.robots.several import Placed

UR5 = ExampleRobot(name="ur5_robot", arms={"arm": ArmJoints(tip="ee_link")})
BAXTER = ExampleRobot(
    name="baxter",
    arms={side: ArmJoints(tip=f"{side}_gripper") for side in ("right", "left")},
)
PR2 = ExampleRobot(
    name="pr2",
    arms={side: ArmJoints(tip=f"{side[0]}_gripper_tool_frame") for side in ("right", "left")},
    locked={"torso_lift_joint": None},
)
TURNED = (0.0, 0.0, math.pi)


@dataclass(frozen=True)
class Case:
    """A robot with something in its hands.

    Attributes:
        robot: as coopqp has it.
        files: of the URDF files it is made of, by the prefix of its names: name and pose.
        start: by arm [rad].
        ignore: pairs of the file whose hulls are in each other, or all but, at the start.
    """

    robot: Robot
    files: Mapping[str, tuple[str, pin.SE3]]
    start: Mapping[str, list[float]]
    ignore: tuple[tuple[str, str], ...] = ()
    held: HeldObject = field(default_factory=lambda: HeldObject(size=(0.1, 0.1, 0.1)))

    def chain(self) -> ClosedChain:
        """The closed chain at the start."""
        robot = self.robot.build()
        q = robot.configuration(self.start)
        return ClosedChain.attach(robot, q, Rigid(), self.held)


HERE = pin.SE3.Identity()
OPPOSITE = pin.SE3(pin.rpy.rpyToMatrix(*TURNED), np.array([1.0, 0.0, 0.0]))
CASES = {
    "two UR5": Case(
        Several(
            robots={
                "left": Placed(robot=UR5),
                "right": Placed(robot=UR5, position=(1.0, 0.0, 0.0), rpy=TURNED),
            }
        ),
        {"left/": ("ur5_robot", HERE), "right/": ("ur5_robot", OPPOSITE)},
        {
            "left/arm": [0.3, -1.9, 2.2, -0.3, 1.9, 0.0],
            "right/arm": [0.3, -1.9, 2.2, -0.3, 1.9, 0.0],
        },
    ),
    "Baxter": Case(
        BAXTER,
        {"": ("baxter", HERE)},
        {
            "right": [-0.138, 0.397, 1.405, 0.688, -0.208, 1.73, 2.73],
            "left": [-0.012, 0.084, -0.687, 0.728, -0.553, 1.76, -2.516],
        },
        ignore=(
            ("left_upper_forearm_visual", "left_wrist"),
            ("right_upper_forearm_visual", "right_wrist"),
            ("right_upper_shoulder", "right_upper_elbow"),
            ("left_upper_shoulder", "left_upper_elbow"),
            ("left_upper_elbow_visual", "left_upper_forearm"),
            ("right_upper_elbow_visual", "right_upper_forearm"),
        ),
    ),
    "PR2": Case(
        PR2,
        {"": ("pr2", HERE)},
        {
            "right": [-0.5, 0.2, -1.0, -1.3, 0.0, -0.7, 0.0],
            "left": [0.5, 0.2, 1.0, -1.3, 0.0, -0.7, 0.0],
        },
    ),
}


class Oracle:
    """Distances of a case's bodies and things, by coal from pinocchio's own reading.

    Args:
        case: which.
        chain: its chain, for the names and the order of the joints.
        things: in the world by name, geometry and pose.
    """

    def __init__(
        self,
        case: Case,
        chain: ClosedChain,
        things: Mapping[str, tuple[coal.CollisionGeometry, pin.SE3]] | None = None,
    ) -> None:
        self.chain, self.data = chain, chain.model.createData()
        self.parts = [_Part(prefix, *file) for prefix, file in case.files.items()]
        self.things = dict(things or {})
        self._request = coal.DistanceRequest()

    def place(self, q: Array) -> None:
        """Put everything where it is at q."""
        by_name = dict(zip(self.chain.joint_names, q.tolist(), strict=True))
        self.bodies: dict[str, tuple[coal.CollisionGeometry, pin.SE3]] = {}
        for part in self.parts:
            part.place(by_name, self.bodies)
        pin.framesForwardKinematics(self.chain.model, self.data, q)
        box = coal.Box(*self.chain.held.size)
        self.bodies["object"] = (box, self.data.oMf[self.chain.frames[0]])
        self.bodies |= self.things

    def distance(self, one: str, other: str) -> float:
        """Of two bodies [m]."""
        result = coal.DistanceResult()
        (A, X_A), (B, X_B) = self.bodies[one], self.bodies[other]
        return float(coal.distance(A, _transform(X_A), B, _transform(X_B), self._request, result))


class _Part:
    """One URDF file, with all joints; those that coopqp has not are at zero."""

    def __init__(self, prefix: str, name: str, X_WB: pin.SE3) -> None:
        path = robots()[name]
        self.prefix, self.X_WB = prefix, X_WB
        self.model = pin.buildModelFromUrdf(str(path))
        share = str(path.parents[4])
        self.geometry = pin.buildGeomFromUrdf(
            self.model, str(path), pin.GeometryType.COLLISION, package_dirs=share
        )
        self.data, self.placed = self.model.createData(), pin.GeometryData(self.geometry)
        self.convex = [_convex(geom.geometry) for geom in self.geometry.geometryObjects]

    def place(
        self,
        values: Mapping[str, float],
        bodies: dict[str, tuple[coal.CollisionGeometry, pin.SE3]],
    ) -> None:
        model, q, count = self.model, pin.neutral(self.model), Counter[str]()
        lower, upper = model.lowerPositionLimit, model.upperPositionLimit
        for j in range(1, model.njoints):
            joint, i = model.joints[j], model.idx_qs[j]
            if joint.nv != 1:
                continue
            value = values.get(self.prefix + model.names[j])
            if joint.nq == 2:
                q[i : i + 2] = math.cos(value or 0.0), math.sin(value or 0.0)
            else:
                q[i] = min(max(0.0, lower[i]), upper[i]) if value is None else value
        pin.updateGeometryPlacements(model, self.data, self.geometry, self.placed, q)
        for i, geom in enumerate(self.geometry.geometryObjects):
            link = self.prefix + model.frames[geom.parentFrame].name
            count[link] += 1
            name = f"{link}[{count[link]}]" if count[link] > 1 else link
            bodies[name] = (self.convex[i], self.X_WB * self.placed.oMg[i])


def _convex(geometry: coal.CollisionGeometry) -> coal.CollisionGeometry:
    """A mesh's hull, primitives as they are."""
    if not isinstance(geometry, coal.BVHModelBase):
        return geometry
    geometry.buildConvexHull(False, "Qt")
    return geometry.convex


def _transform(X: pin.SE3) -> coal.Transform3s:
    return coal.Transform3s(X.rotation, X.translation)


def bodies_of_rows(limit: Limit, chain: ClosedChain) -> list[tuple[str, str]]:
    """The two names in "limit.self_collision[A|B]"."""
    names = [name for name in names_of(limit.rows(chain)) if ".corner[" not in name]
    inside = [name.split("[", 1)[1][:-1] for name in names]
    return [(one, other) for one, _, other in (name.partition("|") for name in inside)]
