"""Closed chains of a few links, random states with the loops closed, and a grasp with a hinge."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import scipy.linalg

from coopqp.base.spec import Array, Vector3, spec
from coopqp.grasp import Grasp, PassiveJoint
from coopqp.grasps import Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State
from coopqp.robot import Arm, RobotModel
from coopqp.robot_files import mdh
from coopqp.robots.nao_t14 import HAND, arm_table

Walk = Callable[[ClosedChain, int], list[Array]]
Closed = tuple[Array, Array]
"""q and v with all loops closed."""
Row = mdh.MdhRow
Parameters = mdh.MdhParameters

STEP = 0.3  # size of a step of the random walk along the closed loops [rad]

#: NAO's hands beside a box, at x = 0.186, y = -/+0.104, z = 0.047 m.
HANDS = {"right": [0.7, -0.2, 1.2, 0.9, 0.1], "left": [0.7, 0.2, -1.2, -0.9, -0.1]}
#: The actuated joints of the paper: q1, q2, q3, q7.
PAPER_SCHEME = ("RShoulderPitch", "RShoulderRoll", "RElbowYaw", "LShoulderRoll")

#: A box whose weight is not in its middle.
BOX = HeldObject(
    mass=0.6, com=(0.01, -0.02, 0.03), inertia=(1.4e-3, 1e-4, -5e-5, 9e-4, 2e-4, 1.6e-3)
)


@spec
class Hinge(Grasp):
    """A passive revolute joint through the hand; about the wrist's axis as in Table 2."""

    axis: Vector3 = (1.0, 0.0, 0.0)

    def passive_joints(self, *_: Array) -> tuple[PassiveJoint, ...]:
        joint = pin.JointModelRevoluteUnaligned(np.array(self.axis))
        return (PassiveJoint(name="hinge", joint=joint, placement=pin.SE3.Identity()),)


def robot_of(name: str, arms: dict[str, list[Row]], hand: tuple[float, float, float]) -> RobotModel:
    """A robot whose arms end in tips at hand from their last joint."""
    tips = {f"{arm}_tip": mdh.Tip(parent=rows[-1].name, offset=hand) for arm, rows in arms.items()}
    rows = [row for arm in arms.values() for row in arm]
    ends = tuple(Arm(name=arm, tip=f"{arm}_tip") for arm in arms)
    return RobotModel(name=name, model=mdh.build_model(name, rows, tips), arms=ends)


def serial(arm: str, parameters: list[Parameters]) -> list[Row]:
    rows: list[Row] = []
    for i, p in enumerate(parameters):
        before = rows[-1].name if rows else None
        rows.append(
            Row(name=f"{arm}{i + 1}", antecedent=before, **vars(p), lower=-3, upper=3, velocity=5)
        )
    return rows


def planar_pair() -> ClosedChain:
    """Two arms of three parallel joints in the plane z = 0, bases 0.4 m apart."""
    arms = {
        "right": serial("r", [Parameters(), Parameters(d=0.3), Parameters(d=0.25)]),
        "left": serial("l", [Parameters(d=0.4), Parameters(d=0.3), Parameters(d=0.25)]),
    }
    robot = robot_of("planar", arms, (0.1, 0.0, 0.0))
    return ClosedChain.attach(
        robot, np.array([2.0, -0.9, -0.4, 1.1, 0.9, 0.4]), Rigid(), HeldObject()
    )


def spherical_pair() -> ClosedChain:
    """Two arms of three joints whose axes all meet in one point: the object turns about it."""
    turn = [Parameters(alpha=math.pi / 2), Parameters(alpha=-math.pi / 2)]
    arms = {
        "right": serial("r", [Parameters(alpha=0.9), *turn]),
        "left": serial("l", [Parameters(gamma=2.0, alpha=0.9), *turn]),
    }
    robot = robot_of("spherical", arms, (0.1, 0.0, 0.2))
    return ClosedChain.attach(
        robot, np.array([0.3, -0.5, 0.7, -0.2, 0.6, 0.4]), Rigid(), HeldObject()
    )


def short_pair() -> ClosedChain:
    """Two arms of two joints in space: four of six loop rows count, other ones in every pose."""
    arms = {
        "right": serial("r", [Parameters(), Parameters(alpha=1.0, d=0.2, r=0.1)]),
        "left": serial("l", [Parameters(d=0.3, alpha=0.3), Parameters(alpha=-1.2, d=0.3)]),
    }
    robot = robot_of("short", arms, (0.1, 0.05, 0.0))
    return ClosedChain.attach(robot, np.array([0.3, -0.5, 0.7, -0.2]), Rigid(), HeldObject())


def three_arms() -> ClosedChain:
    """NAO with a third arm on its chest."""
    third = [replace(row, name=row.name.replace("R", "M", 1)) for row in arm_table("R")]
    names = [row.name for row in third]
    third = [replace(r, antecedent=a) for r, a in zip(third, [None, *names[:-1]], strict=True)]
    third[0] = replace(third[0], b=-0.1, r=0.0)
    arms = {"right": arm_table("R"), "left": arm_table("L"), "middle": third}
    right = np.array([0.7, -0.2, 1.2, 0.9, 0.1])
    q = np.concatenate([right, right * [1, -1, -1, -1, -1], [-0.3, -0.1, 0.4, 0.6, 0.2]])
    return ClosedChain.attach(robot_of("three", arms, HAND), q, Rigid(), HeldObject())


def closed_states(chain: ClosedChain, count: int, seed: int = 11) -> list[Closed]:
    """Random states inside the limits: a walk on the closed loops, velocities along them."""
    rng, state, found = np.random.default_rng(seed), State(chain), []
    while len(found) < count:
        before = state.q.copy()
        free = scipy.linalg.null_space(state.J_rel, rcond=1e-8)
        state.q += STEP * free @ (free.T @ rng.normal(size=chain.n))  # whatever the basis
        state.update()
        state.close_loops(6)
        inside = np.all((chain.lower < state.q) & (state.q < chain.upper))
        if inside and np.abs(state.loop_error).max() < 1e-13:
            free = scipy.linalg.null_space(state.J_rel, rcond=1e-8)
            found.append((state.q.copy(), free @ (free.T @ rng.normal(size=chain.n))))
        else:
            state.q[:] = before
            state.update()
    return found


def inertia_of(held: HeldObject) -> Array:
    """As given, or that of a solid box."""
    if held.inertia is None:
        squares = np.square(held.size)
        return np.asarray(held.mass / 12 * np.diag(squares.sum() - squares))
    xx, xy, xz, yy, yz, zz = held.inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def with_mass(chain: ClosedChain, shares: dict[int, float]) -> pin.Model:
    """The tree with shares of the object's mass as bodies of their own, written out."""
    model, held = chain.model.copy(), chain.held
    about_com = inertia_of(held)
    for arm, share in shares.items():
        frame = chain.model.frames[chain.frames[arm]]
        body = pin.Inertia(share * held.mass, np.array(held.com), share * about_com)
        model.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    return model


def heavy(chain: ClosedChain) -> ClosedChain:
    """The same chain with links that weigh something and a box in its hands."""
    model = chain.robot.model.copy()
    for joint in range(1, model.njoints):
        model.inertias[joint] = pin.Inertia(
            0.4 + 0.1 * joint, np.array([0.1, 0.01, 0.02]), np.diag([1e-3, 2e-3, 2.5e-3])
        )
    robot = replace(chain.robot, model=model)
    return ClosedChain.attach(robot, chain.q_start, chain.grasps, BOX)


def small_arm(name: str, base: Parameters, joints: int) -> list[Row]:
    """Alternating axes, ten centimetres between every second pair of them."""
    com, inertia = (0.02, 0.01, 0.03), (3e-4, 1e-5, 0, 2e-4, 0, 2.5e-4)
    rows: list[Row] = []
    for i in range(joints):
        turn = Parameters(alpha=(-1) ** i * math.pi / 2, r=0.1 * (i % 2))
        rows.append(
            Row(
                name=f"{name}{i + 1}", antecedent=rows[-1].name if rows else None,
                **vars(turn if rows else base), lower=-3.0, upper=3.0, velocity=5.0,
                effort=2.0, mass=0.1, com=com, inertia=inertia,
            )
        )  # fmt: skip
    return rows


def ring(arms: int, joints: int) -> ClosedChain:
    """Small arms on a circle around the object they hold."""
    names = "abcdefgh"[:arms]
    tables = {
        name: small_arm(name, Parameters(gamma=2 * math.pi * i / arms, d=0.2), joints)
        for i, name in enumerate(names)
    }
    tips = {f"{n}_tip": mdh.Tip(parent=t[-1].name, offset=(0.05, 0, 0)) for n, t in tables.items()}
    model = mdh.build_model("ring", [row for t in tables.values() for row in t], tips)
    robot = RobotModel(
        name="ring", model=model, arms=tuple(Arm(name=n, tip=f"{n}_tip") for n in names)
    )
    q = np.tile(np.linspace(0.4, 0.9, joints), arms) * np.resize([1.0, -0.7, 1.3], arms * joints)
    return ClosedChain.attach(robot, q, Rigid(), BOX)


def stretched_pair() -> ClosedChain:
    """The planar pair with its right arm stretched out."""
    robot = planar_pair().robot
    q = np.array([1.2, 0.0, 0.0, 1.1, 0.9, 0.4])
    return ClosedChain.attach(robot, q, Rigid(), HeldObject())


def held(robot: RobotModel, q: Array | None = None) -> ClosedChain:
    return ClosedChain.attach(
        robot, robot.configuration({}) if q is None else q, Rigid(), HeldObject()
    )
