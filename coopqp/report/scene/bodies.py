"""What a robot looks like: the triangles that each of its joints carries.

A joint's surface is that of its links' shapes; without any, that of the robot's capsules; and
without those, capsules from the joint to the next ones, so that every robot can be drawn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp.base.errors import InvalidValueError
from coopqp.model.marker import SolidMarker
from coopqp.report.scene.triangles import (
    NOTHING,
    Triangles,
    count_thinned,
    joined,
    moved,
    of_capsule,
    of_mesh,
    of_shape,
    thinned,
)
from coopqp.robot import Capsule, RobotModel, Shape
from coopqp.robot_files.meshes import version
from coopqp.trace import Trace

MOST_TRIANGLES = 2000  # of each arm, and of all that belongs to none
READ = 1 / 64  # cell in which a shape is thinned when it is read, in its sizes
FINEST, TRIALS = 1 / 500, 5  # first cell, in the sizes of all that is thinned; halvings
THICKNESS = 0.04  # radius of a link's capsule, in lengths of the longest arm
SHORT = 1e-3  # links below are not drawn, in lengths of the longest arm


@dataclass(frozen=True)
class Body:
    """What a joint carries, in its frame.

    Attributes:
        joint: its index in the robot's model; 0 is the base.
        arm: number of the arm that alone is moved by it; None for the base and what arms share.
    """

    joint: int
    arm: int | None
    surface: Triangles


def robot_bodies(robot: RobotModel) -> tuple[tuple[Body, ...], tuple[str, ...]]:
    """The bodies that can be seen, and one sentence for each mesh that cannot be read."""
    surfaces, faults = _surfaces_of_shapes(robot)
    for capsules in (robot.capsules, _links(robot)):
        bare = set(range(robot.model.njoints)) - set(surfaces)
        for capsule in capsules:
            joint = robot.model.getJointId(capsule.joint) if capsule.joint else 0
            if joint in bare:
                surfaces.setdefault(joint, []).append(of_capsule(capsule))
    arm_of = {joint: _arm_of(robot, joint) for joint in sorted(surfaces)}
    bodies = []
    for arms in ([None], range(len(robot.arms))):
        joints = [joint for joint, arm in arm_of.items() if arm in arms]
        few = _within([joined(surfaces[j]) for j in joints], len(arms) * MOST_TRIANGLES)
        bodies += [Body(j, arm_of[j], part) for j, part in zip(joints, few, strict=True)]
    return tuple(bodies), faults


def solid_body(solid: SolidMarker) -> Body:
    """What stands in the world, as a body of the base."""
    shape = Shape(
        frame="universe",
        placement=pin.SE3(solid.rotation, solid.position),
        kind=solid.kind,
        size=solid.size,
        mesh=solid.mesh,
    )
    surface, _ = _read(shape)
    (few,) = _within([moved(surface, shape.placement)], MOST_TRIANGLES)
    return Body(0, None, few)


def body_places(
    robot: RobotModel, bodies: Sequence[Body], trace: Trace, rows: NDArray[np.int64]
) -> list[list[pin.SE3]]:
    """Pose of each body's joint in the world, for each of the rows of a trace, shape (r,)."""
    model, data = robot.model, robot.model.createData()
    # The joints of grasps come after the hands and move no body of the robot.
    columns = [trace.joints.index(name) for name in robot.joint_names]
    places = []
    for q in trace.q[rows][:, columns]:
        pin.forwardKinematics(model, data, q)
        places.append([data.oMi[body.joint].copy() for body in bodies])
    return places


def _surfaces_of_shapes(
    robot: RobotModel,
) -> tuple[dict[int, list[Triangles]], tuple[str, ...]]:
    """Surfaces of the links' shapes by joint, and what cannot be read."""
    surfaces: dict[int, list[Triangles]] = {}
    read: dict[tuple[str, tuple[float, ...], Path | None], tuple[Triangles, str]] = {}
    for shape in robot.shapes:
        look = (shape.kind, shape.size, shape.mesh)
        if look not in read:
            read[look] = _read(shape)
        surface, wrong = read[look]
        if not wrong:
            frame = robot.model.frames[robot.model.getFrameId(shape.frame)]
            placed = moved(surface, frame.placement * shape.placement)
            surfaces.setdefault(frame.parentJoint, []).append(placed)
    faults = {f"{wrong}; not drawn" for _, wrong in read.values() if wrong}
    return surfaces, tuple(sorted(faults))


def _read(shape: Shape) -> tuple[Triangles, str]:
    """As fine as may be seen, so that large meshes do not slow what follows; and what is wrong."""
    if shape.kind != "mesh":
        return of_shape(shape), ""
    assert shape.mesh is not None
    return _read_mesh(*version(shape.mesh), shape.size)


@lru_cache(maxsize=256)
def _read_mesh(
    path: Path, changed: int, size: int, scale: tuple[float, ...]
) -> tuple[Triangles, str]:
    """The same for a file; what has changed in it is read anew."""
    try:
        surface = of_mesh(path, scale)
    except InvalidValueError as error:
        return NOTHING, str(error)
    return thinned(surface, READ * _size([surface])), ""


def _size(surfaces: Sequence[Triangles]) -> float:
    """The longest edge of the boxes round each [m]."""
    return max(float(np.ptp(surface.vertices, axis=0).max()) for surface in surfaces)


def _arm_of(robot: RobotModel, joint: int) -> int | None:
    name = robot.model.names[joint]
    arms = [i for i, arm in enumerate(robot.arms) if name in robot.arm_joints(arm)]
    return arms[0] if len(arms) == 1 else None


def _links(robot: RobotModel) -> list[Capsule]:
    """Capsules from every joint to the next ones and to the hand."""
    model, ends = robot.model, []
    for arm in robot.arms:
        tip = model.frames[model.getFrameId(arm.tip)]
        joints = [model.getJointId(name) for name in robot.arm_joints(arm)]
        places = [model.jointPlacements[j] for j in joints[1:]] + [tip.placement]
        ends.append([(j, X.translation.copy()) for j, X in zip(joints, places, strict=True)])
    reach = max(sum(float(np.linalg.norm(end)) for _, end in arm) for arm in ends)
    look: Any = {"name": "link", "start": (0.0, 0.0, 0.0), "radius": THICKNESS * reach}
    links = (
        Capsule(joint=model.names[joint], end=tuple(end.tolist()), **look)
        for arm in ends
        for joint, end in arm
        if np.linalg.norm(end) > SHORT * reach
    )
    return list(dict.fromkeys(links))  # arms share those of a torso


def _within(surfaces: Sequence[Triangles], most: int) -> list[Triangles]:
    """All thinned by one grid, about as fine as the number of triangles allows."""
    if sum(len(surface.corners) for surface in surfaces) <= most:
        return list(surfaces)

    def fits(cell: float) -> bool:
        return sum(count_thinned(surface, cell) for surface in surfaces) <= most

    fine = FINEST * _size(surfaces)
    coarse = 4.0 * fine
    while not fits(coarse):
        fine, coarse = coarse, 4.0 * coarse
    for _ in range(TRIALS):
        cell = math.sqrt(fine * coarse)
        fine, coarse = (fine, cell) if fits(cell) else (cell, coarse)
    return [thinned(surface, coarse) for surface in surfaces]
