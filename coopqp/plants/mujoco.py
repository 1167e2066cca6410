"""The same robot, grasp and object in MuJoCo, an engine that coopqp did not write.

Each joint of the chain is a body, the object is a free body, and a weld holds it in each hand
(behind the grasp's passive joints, where there are some). Welds are springs: the loop opens by
some tenths of a millimetre under load, as a real grasp does.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.checked import Array, Positive, spec
from coopqp.closed_chain import ClosedChain
from coopqp.controller import ControlProblem
from coopqp.disturbance import Disturbance
from coopqp.errors import MissingDependencyError
from coopqp.plant import Plant, PlantModel
from coopqp.plants._dynamic import DynamicModel
from coopqp.plants._servo import Servo

#: A link without mass gets this much, because MuJoCo moves no massless body [kg], [kg m2].
LEAST_MASS, LEAST_INERTIA = 2e-3, 2e-6
#: How much of a weld's or a stop's acceleration MuJoCo's solver brings about.
FIRM = "0.99 0.999 0.0001"
#: The stop of a joint that has none on one side [rad, m].
NO_STOP = 1e3


class MujocoModel(DynamicModel):
    """A MuJoCo model made from a closed chain.

    Args:
        problem, settings, seed, disturbance: as for :class:`DynamicModel`.

    Attributes:
        signals: also ``gap`` (1,), the largest distance between the object and where a hand holds
            it [m], and ``internal_wrench`` (6 N,), what the hands do to the object that cancels,
            arm by arm [N, N m], world axes.

    Raises:
        MissingDependencyError: mujoco is not installed.
    """

    def __init__(
        self, problem: ControlProblem, settings: Mujoco, seed: int, disturbance: Disturbance
    ) -> None:
        super().__init__(problem, settings.servo, settings.time_step, seed, disturbance)
        try:
            import mujoco
        except ImportError:
            raise MissingDependencyError("plant 'mujoco'", "mujoco") from None
        self._mujoco: Any = mujoco
        self._settings, chain = settings, problem.chain
        self._open()
        self._data.qpos[self._q] = self.true.q
        mujoco.mj_forward(self._model, self._data)
        self.signals["gap"] = np.zeros(1)
        self.signals["internal_wrench"] = np.zeros(6 * len(chain.robot.arms))

    def take_hold(self, before: PlantModel) -> None:
        """Everything moves on as it did; the welds stop hands that move otherwise."""
        assert isinstance(before, MujocoModel)
        self._go_on(before._data)

    def grip(self) -> None:
        """The welds pull the object to where it is held now."""
        self._go_on(self._data)

    def _go_on(self, before: Any) -> None:
        """Weld as the true chain says. The same bodies and joints are in the same order."""
        self._open()
        self._data.qpos[:], self._data.qvel[:] = before.qpos, before.qvel
        self._mujoco.mj_forward(self._model, self._data)

    def _open(self) -> None:
        """Make MuJoCo's model of the true chain."""
        chain, mujoco = self.true.chain, self._mujoco
        text = mjcf(chain, self.h, self._settings, self.disturbance.object_mass)
        self._model = mujoco.MjModel.from_xml_string(text)
        self._data = mujoco.MjData(self._model)
        joints = [self._model.joint(name) for name in chain.joint_names]
        self._q = np.array([joint.qposadr[0] for joint in joints])
        self._v = np.array([joint.dofadr[0] for joint in joints])
        self._object = self._model.body(OBJECT).id
        self._object_v = self._model.joint(OBJECT).dofadr[0] + np.arange(6)
        names = [arm.name for arm in chain.arms[: chain.holding]]
        self._ends = [self._model.site(f"end[{name}]").id for name in names]
        robots = [arm.name for arm in chain.robot.arms]
        self._held_by = [robots.index(name) for name in names]

    def integrate(self) -> None:
        """One step of MuJoCo with the servos' torques."""
        true, data = self.true, self._data
        data.qfrc_applied[self._v] = self.servo.torque(true.q, true.v)
        push = self.disturbance.wrench(true.t)
        data.xfrc_applied[self._object] = 0.0
        if push is not None:
            lever = data.xipos[self._object] - data.xpos[self._object]
            data.xfrc_applied[self._object, :3] = push[:3]
            data.xfrc_applied[self._object, 3:] = push[3:] - pin.skew(lever) @ push[:3]
        self._mujoco.mj_step(self._model, data)
        true.t += self.h
        true.q[:], true.v[:] = data.qpos[self._q], data.qvel[self._v]

    def energy(self) -> tuple[float, float]:
        """Kinetic and potential energy by MuJoCo; keeps gap and wrenches of this instant too."""
        data = self._data
        place = data.xpos[self._object]
        self.signals["gap"][0] = max(np.linalg.norm(data.site_xpos[k] - place) for k in self._ends)
        internal = self.signals["internal_wrench"].reshape(-1, 6)
        internal[:] = 0.0
        internal[self._held_by] = self._internal()
        self._mujoco.mj_energyPos(self._model, data)
        self._mujoco.mj_energyVel(self._model, data)
        return float(data.energy[1]), float(data.energy[0])

    def _internal(self) -> Array:
        """What the welds do to the object that cancels, arm by arm, shape (holding, 6)."""
        data, generalised = self._data, np.zeros(self._model.nv)
        welds = data.efc_type == self._mujoco.mjtConstraint.mjCNSTR_EQUALITY
        by_arm = np.zeros((len(self._ends), 6))
        for i, wrench in enumerate(by_arm):
            force = np.where(welds & (data.efc_id == i), data.efc_force, 0.0)
            self._mujoco.mj_mulJacTVec(self._model, data, generalised, force)
            # A free body's angular velocity, and so its torque, is in the body's own axes.
            wrench[:] = generalised[self._object_v]
            wrench[3:] = data.xmat[self._object].reshape(3, 3) @ wrench[3:]
        alpha = self.true.chain.alpha[: len(by_arm)]
        return np.asarray(by_arm - np.outer(alpha, by_arm.sum(axis=0)), float)


OBJECT = "object"


def mjcf(chain: ClosedChain, time_step: float, settings: Mujoco, object_mass: float) -> str:
    """The closed chain as MJCF text.

    Args:
        chain: arms, grasps and object.
        time_step: [s].
        settings: of welds and end stops.
        object_mass: of the real object over the modelled one.
    """
    model, data = chain.model, chain.model.createData()
    pin.framesForwardKinematics(model, data, chain.q_start)
    children: dict[int, list[int]] = {}
    for joint in range(1, model.njoints):
        children.setdefault(model.parents[joint], []).append(joint)
    ends: dict[int, list[str]] = {}
    welds = []
    for arm, index in zip(chain.arms[: chain.holding], chain.frames, strict=False):
        frame = model.frames[index]
        body = model.names[frame.parentJoint]
        ends.setdefault(frame.parentJoint, []).append(
            f'<site name="end[{arm.name}]" {_pose(frame.placement)}/>'
        )
        welds.append(
            f'<weld body1="{body}" body2="{OBJECT}" relpose="{_relpose(frame.placement)}" '
            f'solref="{settings.stiffness_time} 1" solimp="{FIRM}"/>'
        )
    stops = _stops(chain, settings) if settings.end_stops else {}
    arms = "".join(_body(model, joint, children, ends, stops) for joint in children.get(0, []))
    held = chain.held.body()
    scaled = pin.Inertia(object_mass * held.mass, held.lever, object_mass * held.inertia)
    gravity = " ".join(repr(float(g)) for g in model.gravity.linear)
    return f"""<mujoco>
<compiler angle="radian" autolimits="false" balanceinertia="false"/>
<option timestep="{time_step!r}" gravity="{gravity}" integrator="implicitfast" iterations="200"
 tolerance="1e-12"><flag energy="enable" contact="disable"/></option>
<worldbody>{arms}
<body name="{OBJECT}" {_pose(data.oMf[chain.frames[0]])}>
<freejoint name="{OBJECT}"/>{_inertial(scaled)}</body>
</worldbody>
<equality>{"".join(welds)}</equality>
</mujoco>"""


def _body(
    model: pin.Model,
    joint: int,
    children: dict[int, list[int]],
    ends: dict[int, list[str]],
    stops: dict[str, str],
) -> str:
    below = children.get(joint, [])
    inside = "".join(_body(model, child, children, ends, stops) for child in below)
    kind, axis = _axis(model, joint)
    name = model.names[joint]
    return (
        f'<body name="{name}" {_pose(model.jointPlacements[joint])}>'
        f'<joint name="{name}" type="{kind}" axis="{_numbers(axis)}"{stops.get(name, "")}/>'
        f"{_inertial(model.inertias[joint])}{''.join(ends.get(joint, []))}{inside}</body>"
    )


def _stops(chain: ClosedChain, settings: Mujoco) -> dict[str, str]:
    """Attributes of the joints that have a stop; one that starts beyond a limit has it there."""
    lower = np.minimum(chain.lower, chain.q_start)
    upper = np.maximum(chain.upper, chain.q_start)
    return {
        name: f' limited="true" range="{_numbers([max(low, -NO_STOP), min(high, NO_STOP)])}" '
        f'solreflimit="{settings.stiffness_time} 1" solimplimit="{FIRM}"'
        for name, low, high in zip(chain.joint_names, lower, upper, strict=True)
        if np.isfinite(low) or np.isfinite(high)
    }


def _axis(model: pin.Model, joint: int) -> tuple[str, Array]:
    """MuJoCo's joint type and axis of a joint with one coordinate."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    column = pin.getJointJacobian(model, data, joint, pin.LOCAL)[:, model.idx_vs[joint]]
    turning = np.linalg.norm(column[3:]) > 0.5
    return ("hinge", column[3:]) if turning else ("slide", column[:3])


def _inertial(body: pin.Inertia) -> str:
    mass = max(float(body.mass), LEAST_MASS)
    moments = np.array(body.inertia)
    if np.linalg.eigvalsh(moments)[0] < LEAST_INERTIA:
        moments = moments + LEAST_INERTIA * np.eye(3)
    xx, yy, zz, xy, xz, yz = moments[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return (
        f'<inertial mass="{mass!r}" pos="{_numbers(body.lever)}" '
        f'fullinertia="{_numbers([xx, yy, zz, xy, xz, yz])}"/>'
    )


def _pose(X: pin.SE3) -> str:
    return f'pos="{_numbers(X.translation)}" quat="{_numbers(_quaternion(X))}"'


def _relpose(X: pin.SE3) -> str:
    return f"{_numbers(X.translation)} {_numbers(_quaternion(X))}"


def _quaternion(X: pin.SE3) -> Array:
    x, y, z, w = pin.Quaternion(X.rotation).coeffs()
    return np.array([w, x, y, z])


def _numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


@spec
class Mujoco(Plant):
    """The same system in MuJoCo: a free object welded to the hands (extra coopqp[mujoco])."""

    time_step: Positive = 0.0005
    """Integration step; must divide the control period [s]."""
    stiffness_time: Positive = 0.002
    """Time constant of the welds [s]; at least two time steps."""
    servo: Servo = Servo()
    """How the joints follow velocity commands."""
    end_stops: bool = True
    """Whether joints stop at their position limits, as stiff as the welds."""

    def build(self, problem: ControlProblem, seed: int, disturbance: Disturbance) -> PlantModel:
        """At rest at the chain's start."""
        return MujocoModel(problem, self, seed, disturbance)
