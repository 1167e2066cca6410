"""Two SO-101 as pinocchio and coal have them, to judge what a filter of actions gives back.

Nothing here uses coopqp's kinematics, collision geometry or units: pinocchio reads the URDF twice
and puts the arms where ``two_so101`` has them, coal makes the meshes' hulls and looks whether two
are nearer than they may be.
"""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp.base.spec import Array
from coopqp.robots.example_robot import robots

JOINTS = "shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"
SIDES = "left", "right"
#: As in the scenario: the right arm's base, the jaws' opening, the start [m, rad].
RIGHT = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, np.pi), np.array([0.72, 0.0, 0.0]))
JAW, START = 0.5, np.array([0.0, -0.9, 1.35, -0.45, 0.0487] * 2)
#: The servos' speed; tables of ranges in the URDF, by joint [rad/s, rad].
SPEED = 4.7
HALF = np.array([1.91986, 1.74533, 1.69, 1.65806])
LOWER = np.array([*-HALF, -2.74385] * 2)
UPPER = np.array([*HALF, 2.84121] * 2)


class Oracle:
    """Judges joints of the arms (10,), left before right [rad].

    Args:
        pairs: of links that are watched, such as ("left/gripper_link", "right/base_link").
        distance: that they keep [m].
    """

    def __init__(self, pairs: Sequence[tuple[str, ...]], distance: float) -> None:
        path = robots()["so101"]
        one, share = pin.buildModelFromUrdf(str(path)), str(path.parents[4])
        shapes = pin.buildGeomFromUrdf(one, str(path), pin.COLLISION, package_dirs=share)
        both = [_named(one, shapes, side) for side in SIDES]
        (left, left_shapes), (right, right_shapes) = both
        self.model, empty = pin.Model(), pin.GeometryModel()
        base = pin.SE3.Identity()
        self.model, self.shapes = pin.appendModel(self.model, left, empty, left_shapes, 0, base)
        self.model, self.shapes = pin.appendModel(
            self.model, right, self.shapes, right_shapes, 0, RIGHT
        )
        self._watch(pairs)
        self.data, self.placed = self.model.createData(), pin.GeometryData(self.shapes)
        for request in self.placed.collisionRequests:
            request.security_margin = distance
        self.hands = [self.model.getFrameId(f"{side}/gripper_frame_link") for side in SIDES]
        self.at = [
            self.model.idx_qs[self.model.getJointId(f"{side}/{joint}")]
            for side in SIDES for joint in JOINTS
        ]  # fmt: skip
        X_L, X_R = self.placed_hands(START)
        self.middle = X_L.actInv(pin.SE3(np.eye(3), 0.5 * (X_L.translation + X_R.translation)))

    def _watch(self, pairs: Sequence[tuple[str, ...]]) -> None:
        """One hull round all meshes of a link."""
        links: dict[str, list[pin.GeometryObject]] = {}
        for shape in self.shapes.geometryObjects:
            links.setdefault(self.model.frames[shape.parentFrame].name, []).append(shape)
        self.shapes, at = pin.GeometryModel(), {}
        for link, parts in links.items():
            points = [part.geometry.vertices() @ part.placement.rotation.T
                      + part.placement.translation for part in parts]  # fmt: skip
            mesh = coal.BVHModelOBBRSS()
            mesh.beginModel(0, sum(map(len, points)))
            mesh.addVertices(np.concatenate(points))
            mesh.endModel()
            mesh.buildConvexHull(False, "Qt")
            mesh.convex.computeLocalAABB()
            joint = parts[0].parentJoint
            body = pin.GeometryObject(link, joint, pin.SE3.Identity(), mesh.convex)
            at[link] = self.shapes.addGeometryObject(body)
        for one, other in pairs:
            self.shapes.addCollisionPair(pin.CollisionPair(at[one], at[other]))

    def _q(self, q: Array) -> Array:
        whole = pin.neutral(self.model)
        whole[self.at] = q
        for side in SIDES:
            whole[self.model.idx_qs[self.model.getJointId(f"{side}/gripper")]] = JAW
        return np.asarray(whole)

    def too_near(self, q: Array) -> bool:
        """Whether two watched bodies are nearer than the distance."""
        return bool(pin.computeCollisions(
            self.model, self.data, self.shapes, self.placed, self._q(q), True
        ))  # fmt: skip

    def placed_hands(self, q: Array) -> list[pin.SE3]:
        """Both hands in the world."""
        pin.framesForwardKinematics(self.model, self.data, self._q(q))
        return [self.data.oMf[hand].copy() for hand in self.hands]

    def in_each_other(self, q: Array) -> pin.SE3:
        """The right hand in the left one."""
        X_L, X_R = self.placed_hands(q)
        return X_L.actInv(X_R)

    def loop_slope(self, q: Array) -> Array:
        """By how much each joint moves one hand in the other, shape (6, 10), by differences."""
        here = self.in_each_other(q)
        moved = [self.in_each_other(q + 1e-6 * row) for row in np.eye(10)]
        return np.array([pin.log6(here.actInv(X)).vector for X in moved]).T / 1e-6

    def opened(self, q: Array, taken: pin.SE3) -> tuple[float, float]:
        """How far the hands are off from how they held an object in their middle [m], [rad]."""
        X_L, X_R = self.placed_hands(q)
        X_LO = self.middle
        carried = X_R * taken.inverse() * X_LO
        off = carried.translation - X_L.act(X_LO.translation)
        turned = pin.log3(carried.rotation @ (X_L * X_LO).rotation.T)
        return float(np.linalg.norm(off)), float(np.linalg.norm(turned))


def _named(
    one: pin.Model, shapes: pin.GeometryModel, side: str
) -> tuple[pin.Model, pin.GeometryModel]:
    model, own = one.copy(), shapes.copy()
    for j in range(1, model.njoints):
        model.names[j] = f"{side}/{model.names[j]}"
    for frame in model.frames:
        frame.name = f"{side}/{frame.name}"
    for shape in own.geometryObjects:
        shape.name = f"{side}/{shape.name}"
    return model, own


def broken(
    oracle: Oracle, q: Array, start: Array, holding: NDArray[np.bool_], fps: float,
    most: tuple[float, float] = (1e-3, 1e-2), taken: pin.SE3 | None = None,
) -> list[str]:  # fmt: skip
    """What a chunk's joints (N, 10) break, one sentence each."""
    found, before = list[str](), start
    for k, now in enumerate(q):
        if (now < LOWER - 1e-8).any() or (now > UPPER + 1e-8).any():
            found.append(f"frame {k}: range")
        if (np.abs(now - before) > SPEED / fps + 1e-8).any():
            found.append(f"frame {k}: speed")
        if oracle.too_near(now):
            found.append(f"frame {k}: distance")
        if holding[k]:
            taken = taken or oracle.in_each_other(before)
            off, turned = oracle.opened(now, taken)
            if off > most[0] + 1e-6 or turned > most[1] + 1e-6:
                found.append(f"frame {k}: loop, {1e3 * off:.3f} mm, {1e3 * turned:.2f} mrad")
        else:
            taken = None
        before = now
    return found
