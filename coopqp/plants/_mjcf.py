"""A closed chain as MJCF text: welds where hands are fastened, pads where they press.

Contacts are as hard as the measurements of ``docs/forces.md`` ask: an elliptic cone, and friction a
hundred times as stiff as the normal direction, so that what creeps is not taken for slip. Nothing
but a hand's contact and the object touch. Behind a fingertip the object turns by itself, so that
the passive joints that stand for that have no bodies here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array, NonNegative, Positive, spec
from coopqp.model.closed_chain import ClosedChain

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


@spec
class SpringHand:
    """What yields between the arm and the object, such as rubber pads or bellows."""

    stiffness: Positive
    """Of each hand, along all three axes [N/m]; it does not turn."""
    damping: NonNegative = 50.0
    """[N s/m]"""

    def fault(self, time_step: float) -> str:
        """What of it steps of this length cannot follow; empty if nothing.

        Args:
            time_step: of the integration [s].
        """
        most = {
            "stiffness": HAND_MASS / time_step**2,
            "damping": MOST_DAMPING * HAND_MASS / time_step,
        }
        for name, limit in most.items():
            if getattr(self, name) > limit:
                return (
                    f"spring_hands.{name}: found {getattr(self, name):g}, and steps of "
                    f"{time_step:g} s follow at most {limit:g}; make time_step shorter, or leave "
                    "spring_hands out for hands that hardly yield"
                )
        return ""


@dataclass(frozen=True)
class Firmness:
    """How firm what holds is.

    Attributes:
        weld: time constant of welds and end stops [s].
        contact: of contacts [s].
        end_stops: whether joints have some.
        mass: of the real object over the modelled one.
        friction: of the real contacts over the modelled one.
        spring: of hands that are fastened; None where only the welds yield.
    """

    weld: float
    contact: float
    end_stops: bool
    mass: float
    friction: float
    spring: SpringHand | None


def mjcf(chain: ClosedChain, time_step: float, firm: Firmness) -> str:
    """The closed chain as MJCF text.

    Args:
        chain: arms, grasps and object.
        time_step: [s].
        firm: how firm welds, contacts and end stops are.
    """
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
        if chain.grasps[arm.name].contact:
            tip = model.frames[model.getFrameId(arm.tip)]
            geom, pair = _contact(chain, arm.name, tip.placement, firm)
            ends.setdefault(tip.parentJoint, []).append(geom)
            pairs.append(pair)
            continue
        body, X = model.names[frame.parentJoint], frame.placement
        if firm.spring:
            body, X = hand_name(arm.name), pin.SE3.Identity()
        else:
            ends.setdefault(frame.parentJoint, []).append(_end(arm.name, X))
        welds.append(
            f'<weld body1="{body}" body2="{OBJECT}" relpose="{_relpose(X)}" '
            f'solref="{firm.weld} 1" solimp="{FIRM}"/>'
        )
    if firm.spring:  # of all arms, so that the bodies are the same whoever holds the object
        for arm, index in zip(chain.arms, chain.frames, strict=True):
            frame = model.frames[index]
            hand = _spring_hand(arm.name, frame.placement, firm.spring)
            ends.setdefault(frame.parentJoint, []).append(hand)
    stops = _stops(chain, firm) if firm.end_stops else {}
    arms = "".join(_body(model, joint, children, ends, stops) for joint in children.get(0, []))
    held = chain.held.body()
    scaled = pin.Inertia(firm.mass * held.mass, held.lever, firm.mass * held.inertia)
    gravity = " ".join(repr(float(g)) for g in model.gravity.linear)
    contact = "" if pairs else '<flag energy="enable" contact="disable"/>'
    contact = contact or '<flag energy="enable"/>'
    shape = _box(0.5 * np.array(chain.held.size)) if pairs else ""
    return f"""<mujoco>
<compiler angle="radian" autolimits="false" balanceinertia="false"/>
<option timestep="{time_step!r}" gravity="{gravity}" integrator="implicitfast" iterations="200"
 tolerance="1e-12" cone="elliptic" impratio="100">{contact}</option>
<worldbody>{arms}
<body name="{OBJECT}" {_pose(data.oMf[chain.frames[0]])}>
<freejoint name="{OBJECT}"/>{_inertial(scaled)}{shape}</body>
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


def hand_name(arm: str) -> str:
    """Of the body that a spring holds at an arm's end, where the object is."""
    return f"hand[{arm}]"


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
    body = f'<body name="{hand_name(arm)}" gravcomp="1" {_pose(X_JO)}>{axes}{_inertial(ball)}'
    return f"{body}{_end(arm, pin.SE3.Identity())}</body>"


def _contact(chain: ClosedChain, arm: str, X_JT: pin.SE3, firm: Firmness) -> tuple[str, str]:
    """The body that presses, with a site at its face, and its friction on the object."""
    contact = chain.grasps[arm].contact
    assert contact
    X = X_JT * contact.placement
    half, flat = contact.half_lengths, min(contact.half_lengths) > 0.0
    back = pin.SE3(np.eye(3), np.array([0.0, 0.0, PRESSED - (PAD if flat else FINGERTIP)]))
    shape = f'type="box" size="{half[0]!r} {half[1]!r} {PAD!r}"'
    shape = shape if flat else f'type="sphere" size="{FINGERTIP!r}"'
    mu = firm.friction * contact.friction
    geom = (
        f'<geom name="pad[{arm}]" {shape} {_pose(X * back)} mass="0" contype="0" conaffinity="0"/>'
        f'<site name="end[{arm}]" {_pose(X)}/>'
    )
    # MuJoCo takes the larger friction of two bodies; a pair says its own.
    friction = _numbers([mu, mu, POINT_TORSION, 1e-4, 1e-4])
    pair = (
        f'<pair geom1="pad[{arm}]" geom2="{OBJECT}" condim="{4 if flat else 3}" '
        f'friction="{friction}" solref="{firm.contact!r} 1" solimp="{FIRM_CONTACT}"/>'
    )
    return geom, pair


def _box(half: Array) -> str:
    size = _numbers(half)
    return f'<geom name="{OBJECT}" type="box" size="{size}" mass="0" contype="0" conaffinity="0"/>'


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


def _stops(chain: ClosedChain, firm: Firmness) -> dict[str, str]:
    """Attributes of the joints that have a stop; one that starts beyond a limit has it there."""
    lower = np.minimum(chain.lower, chain.q_start)
    upper = np.maximum(chain.upper, chain.q_start)
    return {
        name: f' limited="true" range="{_numbers([max(low, -NO_STOP), min(high, NO_STOP)])}" '
        f'solreflimit="{firm.weld} 1" solimplimit="{FIRM}"'
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
