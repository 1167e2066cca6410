"""The same robot, grasp and object in MuJoCo, an engine that coopqp did not write.

Each joint of the chain is a body, the object is a free body, and a weld holds it in each hand
(behind the grasp's passive joints, where there are some). Welds are springs: the loop opens by
some tenths of a millimetre under load, as with a real grasp; spring hands yield further, which is
not counted as an open loop. Where a hand presses there is no weld but a contact with friction, and
nothing else holds the object.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError, MissingDependencyError
from coopqp.base.spec import Array, Positive, spec
from coopqp.closed_loop.forces import OFF_FACE, overhang
from coopqp.closed_loop.grasp_matrix import moved
from coopqp.closed_loop.hands import in_axes, into_contacts
from coopqp.closed_loop.hands import points as contact_points
from coopqp.controller import ControlProblem
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.plant import Disturbance, Plant, PlantModel
from coopqp.plants._dynamic import DynamicModel
from coopqp.plants._mjcf import OBJECT, Firmness, SpringHand, free_joints, hand_name, mjcf
from coopqp.plants._servo import Servo

#: A contact's time constant is at least so many steps, or MuJoCo makes it so.
MIN_STEPS = 2.0


class MujocoModel(DynamicModel):
    """A MuJoCo model made from a closed chain.

    Args:
        problem, settings, seed, disturbance: as for :class:`DynamicModel`.

    Attributes:
        signals: also ``gap`` (1,), the largest distance between the object and where a hand holds
            it [m], ``internal_wrench`` (6 N,), the part of the hands' wrenches that cancels, arm
            by arm [N, N m], world axes, and those of :class:`HandSignals`.

    Raises:
        MissingDependencyError: mujoco is not installed.
        InvalidValueError: a hand presses where the object has no face.
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
        self._firm = Firmness(
            weld=settings.stiffness_time,
            contact=max(settings.contact_time, MIN_STEPS * self.h),
            end_stops=settings.end_stops,
            mass=disturbance.object_mass,
            friction=disturbance.friction,
            spring=settings.spring_hands,
        )
        if settings.spring_hands and (fault := settings.spring_hands.fault(self.h)):
            raise InvalidValueError(f"plant mujoco: {fault}")
        self._require_faces()
        self._open()
        self._data.qpos[self._q] = self.true.q[self._moved]
        mujoco.mj_forward(self._model, self._data)
        self.signals["gap"] = np.zeros(1)
        self.signals["internal_wrench"] = np.zeros(6 * len(problem.chain.robot.arms))
        self.signals |= self.hand_signals.signals

    def _require_faces(self) -> None:
        """Refuse contacts that do not touch the box that the object is."""
        half = 0.5 * np.array(self.true.chain.held.size)
        for hand in self.hand_signals.hands:
            if hand.contact and abs(overhang(hand, half)[0]) > OFF_FACE:
                raise InvalidValueError(
                    f"plant mujoco: the contact of {hand.arm} is "
                    f"{1e3 * abs(overhang(hand, half)[0]):.1f} mm from the object's face; change "
                    "object.size, or the contact's position"
                )
            if hand.contact and self._firm.spring:
                raise InvalidValueError(
                    f"plant mujoco: {hand.arm} presses, and spring_hands are fastened to the "
                    "object; use another grasp, or leave spring_hands out"
                )

    def truth(self, state: State) -> State:
        """Before noise; where hands press or yield, the object is a free body."""
        truth = super().truth(state)
        if self._yielding:
            places = self._data.xpos[self._yielding]
            yielded = truth.loop_error.reshape(-1, 6)[: len(places) - 1, :3]
            truth.gap.reshape(-1, 6)[: len(places) - 1, :3] = yielded - (places[1:] - places[0])
            truth.update_drift()
        if self.hand_signals.pressing or self._yielding:
            truth.p_WO[:] = self._data.xpos[self._object]
            truth.R_WO[:] = self._data.xmat[self._object].reshape(3, 3)
        return truth

    def attach(self, before: PlantModel) -> None:
        """Motion goes on; the welds stop hands that move otherwise."""
        assert isinstance(before, MujocoModel)
        self._go_on(before._data)

    def grip(self) -> None:
        """The welds pull the object to where it is held now."""
        self._go_on(self._data)

    def _go_on(self, before: Any) -> None:
        """Rebuild for the true chain, with the same bodies and joints in the same order."""
        self._open()
        self._data.qpos[:], self._data.qvel[:] = before.qpos, before.qvel
        self._mujoco.mj_forward(self._model, self._data)

    def _open(self) -> None:
        """Make MuJoCo's model of the true chain."""
        chain, mujoco = self.true.chain, self._mujoco
        self._model = mujoco.MjModel.from_xml_string(mjcf(chain, self.h, self._firm))
        self._data = mujoco.MjData(self._model)
        left_out = free_joints(chain)
        moved = [i for i, name in enumerate(chain.joint_names) if name not in left_out]
        joints = [self._model.joint(chain.joint_names[i]) for i in moved]
        self._moved = np.array(moved)
        self._q = np.array([joint.qposadr[0] for joint in joints])
        self._v = np.array([joint.dofadr[0] for joint in joints])
        self._object = self._model.body(OBJECT).id
        self._object_v = self._model.joint(OBJECT).dofadr[0] + np.arange(6)
        held = self.hand_signals.hands
        self._ends = [self._model.site(f"end[{hand.arm}]").id for hand in held]
        self._pads = {
            self._model.geom(f"pad[{hand.arm}]").id: i
            for i, hand in enumerate(held)
            if hand.contact
        }
        self._balls = list(_balls(chain))
        yielding = held if self._firm.spring else ()
        self._yielding = [self._model.body(hand_name(hand.arm)).id for hand in yielding]

    def integrate(self) -> None:
        """One step of MuJoCo with the servos' torques."""
        true, data = self.true, self._data
        data.qfrc_applied[self._v] = self.servo.torque(true.q, true.v)[self._moved]
        push = self.disturbance.wrench(true.t)
        data.xfrc_applied[self._object] = 0.0
        if push is not None:
            lever = data.xipos[self._object] - data.xpos[self._object]
            data.xfrc_applied[self._object, :3] = push[:3]
            data.xfrc_applied[self._object, 3:] = push[3:] - pin.skew(lever) @ push[:3]
        self._mujoco.mj_step(self._model, data)
        true.t += self.h
        true.q[self._moved], true.v[self._moved] = data.qpos[self._q], data.qvel[self._v]

    def energy(self) -> tuple[float, float]:
        """Kinetic and potential energy by MuJoCo; updates the gap and wrench signals too."""
        data = self._data
        place = data.xpos[self._object]
        R_WO = data.xmat[self._object].reshape(3, 3)
        self._follow_balls(R_WO)
        wrenches, borne = self._wrenches()
        signals = self.hand_signals
        self.signals["gap"][0] = self._gap(place)
        internal = self.signals["internal_wrench"].reshape(-1, 6)
        internal[:] = 0.0
        alpha = self.true.chain.alpha[: len(wrenches)]
        internal[signals.at] = wrenches - np.outer(alpha, wrenches.sum(axis=0))
        points = contact_points(signals.hands, place, R_WO)
        at_hands = [moved(h, place, p) for h, p in zip(wrenches, points, strict=True)]
        signals.write(np.array(at_hands), points, self._in_contacts(at_hands, points, R_WO), borne)
        if signals.pressing:
            self._write_slip(points)
            signals.touch(self._dt)
            self.lost = signals.lost
        self._mujoco.mj_energyPos(self._model, data)
        self._mujoco.mj_energyVel(self._model, data)
        return float(data.energy[1]), float(data.energy[0])

    def _gap(self, place: Array) -> float:
        """Largest distance between the object and where a fastened hand holds it [m]."""
        held = zip(self._ends, self.hand_signals.hands, strict=True)
        fastened = [self._data.site_xpos[k] - place for k, hand in held if not hand.contact]
        return max((float(np.linalg.norm(way)) for way in fastened), default=0.0)

    def _in_contacts(self, at_hands: Sequence[Array], points: Array, R_WO: Array) -> Array:
        """The hands' wrenches in their contacts' frames, shape (holding, 6).

        A pad's frame is in front of the pad, along which the object may have slipped, and on the
        object's face, from which the pad may have tilted. A fingertip's stays at its place.
        """
        data, found = self._data, []
        hands, turned = self.hand_signals.hands, into_contacts(self.hand_signals.hands, R_WO)
        for hand, site, h, p, R in zip(hands, self._ends, at_hands, points, turned, strict=True):
            if not hand.contact or min(hand.contact.half_lengths) <= 0.0:
                found.append(in_axes(h, R))
                continue
            normal, along = R[2], data.site_xmat[site].reshape(3, 3)[:, 0]
            x = along - normal.dot(along) * normal
            x /= np.linalg.norm(x)
            on_face = np.array([x, np.cross(normal, x), normal])
            middle = data.site_xpos[site]
            middle = middle + normal.dot(p - middle) * normal
            found.append(in_axes(moved(h, p, middle), on_face))
        return np.array(found)

    def _write_slip(self, points: Array) -> None:
        """How far the object's points of contact have moved along the pads."""
        data, signals = self._data, self.hand_signals
        for i, (site, hand) in enumerate(zip(self._ends, signals.hands, strict=True)):
            if hand.contact:
                along = data.site_xmat[site].reshape(3, 3)[:, :2]
                away = along.T @ (points[i] - data.site_xpos[site])
                signals.signals["slip"][signals.at[i]] = np.hypot(away[0], away[1])

    def _follow_balls(self, R_WO: Array) -> None:
        """Angles of the joints that stand for a fingertip, from the object's rotation."""
        true = self.true
        for index, X_JT, R_EO, joint in self._balls:
            R_WT = self._data.xmat[self._model.body(joint).id].reshape(3, 3) @ X_JT
            R = R_WT.T @ R_WO @ R_EO.T
            before = true.q[index].copy()
            true.q[index] = angles_xyz(R)
            true.v[index] = (true.q[index] - before) / self._dt

    def _wrenches(self) -> tuple[Array, Array]:
        """Each hand's wrench on the object, at its origin in world axes, shape (holding, 6).

        And the sum of the friction forces' sizes over all points of each contact, shape (holding,)
        [N], which is at most friction times normal force.
        """
        data, mujoco = self._data, self._mujoco
        by_arm, generalised = np.zeros((len(self._ends), 6)), np.zeros(self._model.nv)
        welds = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        fastened = [i for i, h in enumerate(self.hand_signals.hands) if not h.contact]
        R_WO = data.xmat[self._object].reshape(3, 3)
        for weld, i in enumerate(fastened):
            force = np.where(welds & (data.efc_id == weld), data.efc_force, 0.0)
            mujoco.mj_mulJacTVec(self._model, data, generalised, force)
            # A free body's angular velocity, and so its torque, is in the body's own axes.
            by_arm[i] = generalised[self._object_v]
            by_arm[i, 3:] = R_WO @ by_arm[i, 3:]
        found, borne = np.zeros(6), np.zeros(len(self._ends))
        for k in range(data.ncon if self._pads else 0):
            contact = data.contact[k]
            pad = self._pads.get(contact.geom1, self._pads.get(contact.geom2))
            if pad is None:
                continue
            mujoco.mj_contactForce(self._model, data, k, found)
            sign = -1.0 if contact.geom2 in self._pads else 1.0  # it acts on the second body
            frame = sign * contact.frame.reshape(3, 3).T
            at = np.concatenate([frame @ found[:3], frame @ found[3:]])
            by_arm[pad] += moved(at, contact.pos, data.xpos[self._object])
            borne[pad] += np.hypot(found[1], found[2])
        return by_arm, borne


def _balls(chain: ClosedChain) -> Iterator[tuple[Any, Array, Array, str]]:
    """Joints that stand for a fingertip: indices, rotation of the tip, object, and their body."""
    model = chain.model
    for arm in chain.arms[: chain.holding]:
        passive = chain.hold.passive[arm.name]
        if chain.grasps[arm.name].contact and passive:
            names = [f"{arm.name}.{joint.name}" for joint in passive]
            index = np.array([chain.joint_names.index(name) for name in names])
            tip = model.frames[model.getFrameId(arm.tip)]
            X_EO = chain.hold.X_EO[arm.name]
            yield index, tip.placement.rotation, X_EO.rotation, model.names[tip.parentJoint]


def angles_xyz(R: Array) -> Array:
    """The angles of successive turns about x, y and z, R = Rx Ry Rz, shape (3,) [rad]."""
    return np.array(
        [
            np.arctan2(-R[1, 2], R[2, 2]),
            np.arcsin(np.clip(R[0, 2], -1.0, 1.0)),
            np.arctan2(-R[0, 1], R[0, 0]),
        ]
    )


@spec
class Mujoco(Plant):
    """The same in MuJoCo: a free object, welded to the hands or pressed (extra coopqp[mujoco])."""

    time_step: Positive = 0.0005
    """Integration step; must divide the control period [s]."""
    stiffness_time: Positive = 0.002
    """Time constant of the welds [s]; at least two time steps."""
    contact_time: Positive = 0.005
    """Time constant of contacts [s]; at least two time steps."""
    servo: Servo = Servo()
    """How the joints follow velocity commands."""
    end_stops: bool = True
    """Whether joints stop at their position limits, as stiff as the welds."""
    spring_hands: SpringHand | None = None
    """What yields between each arm and the object; nothing but the welds if omitted."""

    def build(self, problem: ControlProblem, seed: int, disturbance: Disturbance) -> PlantModel:
        return MujocoModel(problem, self, seed, disturbance)
