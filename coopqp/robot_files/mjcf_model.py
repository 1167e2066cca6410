"""From a model that MuJoCo has compiled to what we say of a robot.

MuJoCo's joint frames turn with the body, and a body may have several joints: each is a joint of
pinocchio at its anchor, one after another, and the body's frame is behind the last of them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array
from coopqp.robot_files.description import Follower

#: Added in front of a geom's name that a body has already; names in files may have it, too.
WORLD = "world/"
#: Numbers of MuJoCo's kinds of joints, motors and equalities.
FREE, BALL, SLIDE, HINGE = 0, 1, 2, 3
AT_JOINT, FIXED_GAIN, NO_BIAS, OF_CONTROL, JOINT_TIE = (0, 1), 0, 0, (0, 2, 3), 2
#: Joints about and along the axes of their body, which pinocchio moves faster.
ALIGNED = {
    (SLIDE, (1.0, 0.0, 0.0)): pin.JointModelPX,
    (SLIDE, (0.0, 1.0, 0.0)): pin.JointModelPY,
    (SLIDE, (0.0, 0.0, 1.0)): pin.JointModelPZ,
    (HINGE, (1.0, 0.0, 0.0)): pin.JointModelRX,
    (HINGE, (0.0, 1.0, 0.0)): pin.JointModelRY,
    (HINGE, (0.0, 0.0, 1.0)): pin.JointModelRZ,
}
UNALIGNED = {SLIDE: pin.JointModelPrismaticUnaligned, HINGE: pin.JointModelRevoluteUnaligned}


class Named:
    """Names of what a model has, in its order; what has none is called after its place.

    Attributes:
        bodies: the world's first, which is pinocchio's.
        joints: a body's after it, "upper_joint_2".
        geoms: of the frames that they are fixed to: their bodies', or their own, such as "geom_3",
            in the world.
        sites: empty where they have none.
    """

    def __init__(self, model: Any) -> None:
        self.bodies = ["universe"]
        self.bodies += [model.body(i).name or f"body_{i}" for i in range(1, model.nbody)]
        first = model.body_jntadr[model.jnt_bodyid]
        self.joints = [
            model.joint(i).name or f"{self.bodies[model.jnt_bodyid[i]]}_joint_{i - first[i] + 1}"
            for i in range(model.njnt)
        ]
        self.sites = [model.site(i).name for i in range(model.nsite)]
        self.geoms = [self.bodies[body] for body in model.geom_bodyid]
        taken = {*self.bodies, *self.joints, *self.sites}
        for i in np.flatnonzero(model.geom_bodyid == 0):
            name = model.geom(i).name or f"geom_{i + 1}"
            self.geoms[i] = f"{WORLD}{name}" if name in taken else name


def pinocchio_model(model: Any, named: Named) -> pin.Model:
    """All joints but the free ones, with frames of bodies, sites, joints and the world's geoms."""
    made = pin.Model()
    at = [(0, pin.SE3.Identity())]  # joint of each body, and its pose in that joint
    for body in range(1, model.nbody):
        parent, X = at[model.body_parentid[body]]
        X = X * pose(model.body_pos[body], model.body_quat[body])
        first = model.body_jntadr[body]
        for joint in range(first, first + model.body_jntnum[body]):
            if model.jnt_type[joint] != FREE:
                anchor = pin.SE3(np.eye(3), np.array(model.jnt_pos[joint]))
                at_anchor = X * anchor * _back_to_zero(model, joint)
                parent = _add_joint(made, model, joint, parent, at_anchor, named.joints[joint])
                X = anchor.inverse()
        made.appendBodyToJoint(parent, _inertia(model, body), X)
        made.addBodyFrame(named.bodies[body], parent, X, 0)
        at.append((parent, X))
    turned = [dof for dof in range(model.nv) if model.jnt_type[model.dof_jntid[dof]] != FREE]
    made.armature, made.damping = model.dof_armature[turned], model.dof_damping[turned]
    for site, name in enumerate(named.sites):
        if name:
            joint, X = at[model.site_bodyid[site]]
            X = X * pose(model.site_pos[site], model.site_quat[site])
            made.addFrame(pin.Frame(name, joint, X, pin.FrameType.OP_FRAME), False)
    for geom in np.flatnonzero(model.geom_bodyid == 0):
        made.addBodyFrame(named.geoms[geom], 0, pin.SE3.Identity(), 0)
    return made


def _add_joint(made: pin.Model, model: Any, joint: int, parent: int, X: pin.SE3, name: str) -> int:
    kind, axis = int(model.jnt_type[joint]), np.array(model.jnt_axis[joint])
    if (aligned := ALIGNED.get((kind, tuple(axis.tolist())))) is not None:
        new: Any = aligned()
    else:
        new = UNALIGNED[kind](axis) if kind in UNALIGNED else pin.JointModelSpherical()
    lower, upper = np.full(new.nq, -np.inf), np.full(new.nq, np.inf)
    if model.jnt_limited[joint] and new.nq == 1:
        lower[0], upper[0] = model.jnt_range[joint]
    effort, velocity = np.full(new.nv, _effort(model, joint)), np.full(new.nv, np.inf)
    index = int(made.addJoint(parent, new, X, name, effort, velocity, lower, upper))
    made.addJointFrame(index)
    return index


def _back_to_zero(model: Any, joint: int) -> pin.SE3:
    """From where the file draws a joint, at its reference, to where it is at zero."""
    axis, back = np.array(model.jnt_axis[joint]), -float(model.qpos0[model.jnt_qposadr[joint]])
    if model.jnt_type[joint] == BALL or not back:
        return pin.SE3.Identity()
    if model.jnt_type[joint] == SLIDE:
        return pin.SE3(np.eye(3), back * axis)
    return pin.SE3(pin.exp3(back * axis), np.zeros(3))


def pose(p: Array, quaternion: Array) -> pin.SE3:
    """As MuJoCo has it: w first."""
    return pin.SE3(pin.Quaternion(*map(float, quaternion)).matrix(), np.array(p))


def _inertia(model: Any, body: int) -> pin.Inertia:
    X = pose(model.body_ipos[body], model.body_iquat[body])
    moments = X.rotation @ np.diag(model.body_inertia[body]) @ X.rotation.T
    return pin.Inertia(float(model.body_mass[body]), X.translation, moments)


def _effort(model: Any, joint: int) -> float:
    """What a joint's motors give at most, both ways [N m or N]; infinite where nothing says so."""
    motors = np.flatnonzero(
        (model.actuator_trnid[:, 0] == joint) & np.isin(model.actuator_trntype, AT_JOINT)
    )
    low, high = -np.inf, np.inf
    if len(motors):
        low, high = np.sum([_motor(model, motor) for motor in motors], axis=0)
    if model.jnt_actfrclimited[joint]:
        low, high = (
            max(low, model.jnt_actfrcrange[joint, 0]),
            min(high, model.jnt_actfrcrange[joint, 1]),
        )
    return float(min(-low, high))


def _motor(model: Any, motor: Any) -> tuple[float, float]:
    """Least and most force of a motor at its joint."""
    low, high = -np.inf, np.inf
    gain, gear = float(model.actuator_gainprm[motor, 0]), float(model.actuator_gear[motor, 0])
    linear = model.actuator_gaintype[motor] == FIXED_GAIN and (
        model.actuator_biastype[motor] == NO_BIAS and model.actuator_dyntype[motor] in OF_CONTROL
    )
    if linear and model.actuator_ctrllimited[motor] and gain:
        low, high = sorted(gain * model.actuator_ctrlrange[motor])
    if model.actuator_forcelimited[motor]:
        least, most = model.actuator_forcerange[motor]
        low, high = max(low, least), min(high, most)
    low, high = sorted((gear * low, gear * high)) if gear else (0.0, 0.0)
    return low, high


def followers(model: Any, named: Named) -> dict[str, Follower]:
    """Joints that an equality ties to another one."""
    found = {}
    for tie in np.flatnonzero((model.eq_type == JOINT_TIE) & (model.eq_active0 != 0)):
        leader = model.eq_obj2id[tie]
        offset, ratio = map(float, model.eq_data[tie, :2])
        found[named.joints[model.eq_obj1id[tie]]] = Follower(
            leader=named.joints[leader] if leader >= 0 else "", ratio=ratio, offset=offset
        )
    return found


def floating(model: Any, named: Named) -> dict[str, frozenset[str]]:
    """Free joints, and the names of all that each moves."""
    root, found = model.body_rootid, {}
    for joint in np.flatnonzero(model.jnt_type == FREE):
        body, moved = model.jnt_bodyid[joint], set[str]()
        for names, bodies in (
            (named.bodies, np.arange(model.nbody)),
            (named.joints, model.jnt_bodyid),
            (named.sites, model.site_bodyid),
        ):
            moved.update(names[i] for i in np.flatnonzero(root[bodies] == body))
        found[named.joints[joint]] = frozenset(moved)
    return found
