"""The same robot, grasp and object in MuJoCo, an engine that coopqp did not write.

Each joint of the chain is a body, the object is a free body, and a weld holds it in each hand
(behind the grasp's passive joints, where there are some). Welds are springs: the loop opens by
some tenths of a millimetre under load, as with a real grasp; spring hands yield further, which is
not counted as an open loop. Where a hand presses there is no weld but a contact with friction, and
nothing else holds the object.

Contacts are as hard as the measurements of ``docs/forces.md`` ask: an elliptic cone, and friction a
hundred times as stiff as the normal direction, so that what creeps is not taken for slip. Nothing
but a hand's contact and the object touch. Behind a fingertip the object turns by itself, so that
the passive joints that stand for that have no bodies here.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError, needs
from coopqp.base.spec import Array, NonNegative, Positive, spec
from coopqp.closed_loop.forces import OFF_FACE, overhang
from coopqp.closed_loop.grasp_matrix import moved
from coopqp.closed_loop.hands import in_axes, into_contacts
from coopqp.closed_loop.hands import points as contact_points
from coopqp.controller import ControlProblem
from coopqp.grasp import Contact
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.plant import Disturbance, Plant, PlantModel
from coopqp.plants._dynamic import DynamicModel, Servo, ServoLaw
from coopqp.robot import axis_of

#: A link without mass gets this much, because MuJoCo moves no massless body [kg], [kg m2].
LEAST_MASS, LEAST_INERTIA = 2e-3, 2e-6
#: How much of a weld's or a stop's acceleration MuJoCo's solver brings about.
FIRM = "0.99 0.999 0.0001"
#: The same of a contact.
FIRM_CONTACT = f"{FIRM} 0.5 2"
#: The stop of a joint that has none on one side [rad, m].
NO_STOP = 1e3
#: How thick a pad is, and the radius of a fingertip [m].
PAD, FINGERTIP = 5e-3, 5e-3
#: How deep contacts are pressed in at the start, as under some ten newtons [m].
PRESSED = 2e-6
#: What moves with the object in front of a hand's spring [kg], [m]; its weight is left out, because
#: no servo knows of it. Much lighter, and the spring outruns the integration.
HAND_MASS, HAND_RADIUS = 0.05, 0.03
#: Damping of such a spring, over mass and step, with which MuJoCo has been seen to go well.
MOST_DAMPING = 5.0
#: Friction about the normal at each point of a pad and of a fingertip [m].
POINT_TORSION = 5e-4

OBJECT = "object"
#: Of shapes without mass that touch nothing but in a pair.
UNTOUCHED = 'mass="0" contype="0" conaffinity="0"'


@spec
class SpringHand:
    """What yields between the arm and the object, such as rubber pads or bellows."""

    stiffness: Positive
    """Of each hand, along all three axes [N/m]; it does not turn."""
    damping: NonNegative = 50.0
    """[N s/m]"""

    def require_step(self, time_step: float) -> None:
        """Refuse what an integration with this step [s] cannot follow."""
        stiffness, damping = HAND_MASS / time_step**2, MOST_DAMPING * HAND_MASS / time_step
        for name, limit in (("stiffness", stiffness), ("damping", damping)):
            if getattr(self, name) > limit:
                raise InvalidValueError(
                    f"plant mujoco: spring_hands.{name}: found {getattr(self, name):g}, and steps "
                    f"of {time_step:g} s follow at most {limit:g}; make time_step shorter, or "
                    "leave spring_hands out for hands that hardly yield"
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


def mjcf(chain: ClosedChain, time_step: float, settings: Mujoco, disturbance: Disturbance) -> str:
    """The true chain as MJCF text, for steps of an integration [s]."""
    spring, weld = settings.spring_hands, f"{settings.stiffness_time} 1"
    contact_time = max(settings.contact_time, MIN_STEPS * time_step)
    model, data = chain.model, chain.model.createData()
    pin.framesForwardKinematics(model, data, chain.q_start)
    left_out = free_joints(chain)
    children: dict[int, list[int]] = {}
    for joint in range(1, model.njoints):
        if model.names[joint] not in left_out:
            children.setdefault(model.parents[joint], []).append(joint)
    ends: dict[int, list[str]] = {}
    welds, pairs = [], []
    for arm, index in zip(chain.arms[: chain.holding], chain.frames, strict=False):
        frame = model.frames[index]
        grasp = chain.grasps.get(arm.name)
        if grasp and (contact := grasp.contact):
            tip = model.frames[model.getFrameId(arm.tip)]
            mu = disturbance.friction * contact.friction
            geom, pair = _contact(arm.name, contact, tip.placement, mu, contact_time)
            ends.setdefault(tip.parentJoint, []).append(geom)
            pairs.append(pair)
            continue
        body, X = model.names[frame.parentJoint], frame.placement
        if not grasp:
            body = "world"
        elif spring:
            body, X = f"hand[{arm.name}]", pin.SE3.Identity()
        else:
            ends.setdefault(frame.parentJoint, []).append(_end(arm.name, X))
        place = f"{_numbers(X.translation)} {_quaternion(X)}"
        welds.append(
            f'<weld body1="{body}" body2="{OBJECT}" relpose="{place}" solref="{weld}" '
            f'solimp="{FIRM}"/>'
        )
    if spring:  # of all arms, so that the bodies are the same whoever holds the object
        for arm, index in list(zip(chain.arms, chain.frames, strict=True))[chain.standing :]:
            frame = model.frames[index]
            hand = _spring_hand(arm.name, frame.placement, spring)
            ends.setdefault(frame.parentJoint, []).append(hand)
    stops = _stops(chain, weld) if settings.end_stops else {}
    arms = "".join(_body(model, joint, children, ends, stops) for joint in children.get(0, []))
    held, mass = chain.held.body(), disturbance.object_mass
    scaled = pin.Inertia(mass * held.mass, held.lever, mass * held.inertia)
    flags = "" if pairs else ' contact="disable"'
    gravity, half = _numbers(model.gravity.linear), _numbers(0.5 * np.array(chain.held.size))
    box = f'<geom name="{OBJECT}" type="box" size="{half}" {UNTOUCHED}/>' if pairs else ""
    return f"""<mujoco>
<compiler angle="radian" autolimits="false" balanceinertia="false"/>
<option timestep="{time_step!r}" gravity="{gravity}" integrator="implicitfast" iterations="200"
 tolerance="1e-12" cone="elliptic" impratio="100"><flag energy="enable"{flags}/></option>
<worldbody>{arms}
<body name="{OBJECT}" {_pose(data.oMf[chain.frames[0]])}>
<freejoint name="{OBJECT}"/>{_inertial(scaled)}{box}</body>
</worldbody>
<equality>{"".join(welds)}</equality>
<contact>{"".join(pairs)}</contact>
</mujoco>"""


def free_joints(chain: ClosedChain) -> frozenset[str]:
    """Passive joints that stand for a contact about which the object turns by itself."""
    return frozenset(
        f"{name}.{joint.name}"
        for name, grasp in chain.grasps.items()
        if grasp.contact
        for joint in chain.hold.passive[name]
    )


def _end(arm: str, X: pin.SE3) -> str:
    return f'<site name="end[{arm}]" {_pose(X)}/>'


def _spring_hand(arm: str, X_JO: pin.SE3, spring: SpringHand) -> str:
    """A body that yields along the axes of the object, and the object's place in it."""
    axes = "".join(
        f'<joint type="slide" axis="{axis}" stiffness="{spring.stiffness!r}" '
        f'damping="{spring.damping!r}"/>'
        for axis in ("1 0 0", "0 1 0", "0 0 1")
    )
    ball = pin.Inertia.FromSphere(HAND_MASS, HAND_RADIUS)
    body = f'<body name="hand[{arm}]" gravcomp="1" {_pose(X_JO)}>{axes}{_inertial(ball)}'
    return f"{body}{_end(arm, pin.SE3.Identity())}</body>"


def _contact(arm: str, contact: Contact, X_JT: pin.SE3, mu: float, time: float) -> tuple[str, str]:
    """The body that presses, with a site at its face, and its friction on the object."""
    X = X_JT * contact.placement
    half, flat = contact.half_lengths, min(contact.half_lengths) > 0.0
    back = pin.SE3(np.eye(3), np.array([0.0, 0.0, PRESSED - (PAD if flat else FINGERTIP)]))
    shape = f'type="box" size="{half[0]!r} {half[1]!r} {PAD!r}"'
    shape = shape if flat else f'type="sphere" size="{FINGERTIP!r}"'
    geom = f'<geom name="pad[{arm}]" {shape} {_pose(X * back)} {UNTOUCHED}/>{_end(arm, X)}'
    # MuJoCo takes the larger friction of two bodies; a pair says its own.
    of_pair = _numbers([mu, mu, POINT_TORSION, 1e-4, 1e-4])
    pair = (
        f'<pair geom1="pad[{arm}]" geom2="{OBJECT}" condim="{4 if flat else 3}" '
        f'friction="{of_pair}" solref="{time!r} 1" solimp="{FIRM_CONTACT}"/>'
    )
    return geom, pair


def _body(
    model: pin.Model,
    joint: int,
    children: dict[int, list[int]],
    ends: dict[int, list[str]],
    stops: dict[str, str],
) -> str:
    below = children.get(joint, [])
    inside = "".join(_body(model, child, children, ends, stops) for child in below)
    name, axis = model.names[joint], axis_of(model.joints[joint])
    assert axis is not None  # robots have no others
    turns = np.linalg.norm(axis[3:]) > 0.5
    kind, axis = ("hinge", axis[3:]) if turns else ("slide", axis[:3])
    return (
        f'<body name="{name}" {_pose(model.jointPlacements[joint])}>'
        f'<joint name="{name}" type="{kind}" axis="{_numbers(axis)}"{stops.get(name, "")}/>'
        f"{_inertial(model.inertias[joint])}{''.join(ends.get(joint, []))}{inside}</body>"
    )


def _stops(chain: ClosedChain, weld: str) -> dict[str, str]:
    """Attributes of the joints that have a stop; one that starts beyond a limit has it there."""
    lower = np.minimum(chain.lower, chain.q_start)
    upper = np.maximum(chain.upper, chain.q_start)
    return {
        name: f' limited="true" range="{_numbers([max(low, -NO_STOP), min(high, NO_STOP)])}" '
        f'solreflimit="{weld}" solimplimit="{FIRM}"'
        for name, low, high in zip(chain.joint_names, lower, upper, strict=True)
        if np.isfinite(low) or np.isfinite(high)
    }


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
    return f'pos="{_numbers(X.translation)}" quat="{_quaternion(X)}"'


def _quaternion(X: pin.SE3) -> str:
    x, y, z, w = pin.Quaternion(X.rotation).coeffs()
    return _numbers([w, x, y, z])


def _numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


#: A contact's time constant is at least so many steps, or MuJoCo makes it so.
MIN_STEPS = 2.0


class MujocoModel(DynamicModel):
    """A MuJoCo model made from a closed chain.

    Attributes:
        signals: also ``gap`` (1,), the largest distance between the object and where a hand holds
            it [m], and those of :class:`HandSignals`.
    """

    _data: Any

    def __init__(
        self, problem: ControlProblem, settings: Mujoco, seed: int, disturbance: Disturbance
    ) -> None:
        servo = ServoLaw(problem.chain, settings.servo)
        super().__init__(problem, servo, settings.time_step, seed, disturbance)
        with needs("plant 'mujoco'", "mujoco"):
            import mujoco
        self._mujoco: Any = mujoco
        self._settings = settings
        if settings.spring_hands:
            settings.spring_hands.require_step(self.h)
        self._require_faces()
        self._open()
        self._data.qpos[self._q] = self.true.q[self._moved]
        mujoco.mj_forward(self._model, self._data)
        self.signals["gap"] = np.zeros(1)
        self.signals |= self.hand_signals.signals

    def _require_faces(self) -> None:
        """Refuse contacts that do not touch the box that the object is."""
        half = 0.5 * np.array(self.true.chain.held.size)
        for hand in self.hand_signals.hands:
            if not hand.contact:
                continue
            if (off := abs(overhang(hand, half)[0])) > OFF_FACE:
                raise InvalidValueError(
                    f"plant mujoco: the contact of {hand.arm} is {1e3 * off:.1f} mm from the "
                    "object's face; change object.size, or the contact's position"
                ).at("object")
            if self._settings.spring_hands:
                raise InvalidValueError(
                    f"plant mujoco: {hand.arm} presses, and spring_hands are fastened to the "
                    "object; use another grasp, or leave spring_hands out"
                )

    def truth(self, state: State) -> State:
        """Before noise; where hands press or yield, the object is a free body."""
        truth = super().truth(state)
        if self._yielding:
            places = self._data.xpos[self._yielding]
            offset = truth.loop_offset.reshape(-1, 6)[: len(places) - 1, :3]
            yielded = truth.loop_error.reshape(-1, 6)[: len(offset), :3]
            offset[:] = yielded - (places[1:] - places[0])
            truth.update_drift()
        if self.hand_signals.pressing or self._yielding:
            truth.p_WO[:] = self._data.xpos[self._object]
            truth.R_WO[:] = self._data.xmat[self._object].reshape(3, 3)
        return truth

    def attach(self, before: PlantModel) -> None:
        """Motion goes on; the welds stop hands that move otherwise."""
        assert isinstance(before, MujocoModel)
        self._data = before._data
        self.grip()

    def grip(self) -> None:
        """Rebuild for the true chain, the same bodies and joints in the same order; welds pull."""
        before = self._data
        self._open()
        self._data.qpos[:], self._data.qvel[:] = before.qpos, before.qvel
        self._mujoco.mj_forward(self._model, self._data)

    def _open(self) -> None:
        chain, mujoco = self.true.chain, self._mujoco
        text = mjcf(chain, self.h, self._settings, self.disturbance)
        self._model = mujoco.MjModel.from_xml_string(text)
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
        pressing = [(i, hand.arm) for i, hand in enumerate(held) if hand.contact]
        self._pads = {self._model.geom(f"pad[{arm}]").id: i for i, arm in pressing}
        self._balls = list(_balls(chain))
        yielding = held if self._settings.spring_hands else ()
        self._yielding = [self._model.body(f"hand[{hand.arm}]").id for hand in yielding]

    def integrate(self) -> None:
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
        held = zip(self._ends, self.hand_signals.hands, strict=True)
        fastened = [data.site_xpos[k] - place for k, hand in held if not hand.contact]
        gaps = (float(np.linalg.norm(way)) for way in fastened)
        self.signals["gap"][0] = max(gaps, default=0.0)
        points = contact_points(signals.hands, place, R_WO)
        at_hands = [moved(h, place, p) for h, p in zip(wrenches, points, strict=True)]
        signals.write(np.array(at_hands), points, self._in_contacts(at_hands, points, R_WO), borne)
        signals.split(wrenches, self.true.chain.alpha)
        if signals.pressing:
            self._write_slip(points)
            signals.touch(self._dt)
            self.lost = signals.lost
        self._mujoco.mj_energyPos(self._model, data)
        self._mujoco.mj_energyVel(self._model, data)
        return float(data.energy[1]), float(data.energy[0])

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
            true.q[index] = -pin.rpy.matrixToRpy(R.T)  # successive turns about x, y and z
            true.v[index] = (true.q[index] - before) / self._dt

    def _wrenches(self) -> tuple[Array, Array]:
        """The hands' wrenches on the object, at its origin in world axes; their friction [N]."""
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
            w = in_axes(found, sign * contact.frame.reshape(3, 3).T)
            by_arm[pad] += moved(w, contact.pos, data.xpos[self._object])
            borne[pad] += np.hypot(found[1], found[2])
        return by_arm, borne


def _balls(chain: ClosedChain) -> Iterator[tuple[Any, Array, Array, str]]:
    """Joints that stand for a fingertip: indices, rotation of the tip, object, and their body."""
    model = chain.model
    for arm in chain.arms[: len(chain.hold.holders)]:
        passive = chain.hold.passive[arm.name]
        if chain.grasps[arm.name].contact and passive:
            names = [f"{arm.name}.{joint.name}" for joint in passive]
            index = np.array([chain.joint_names.index(name) for name in names])
            tip = model.frames[model.getFrameId(arm.tip)]
            X_EO = chain.hold.X_EO[arm.name]
            yield index, tip.placement.rotation, X_EO.rotation, model.names[tip.parentJoint]
