"""The job that every peer does, and its robots as URDF so that all have the same arms.

The object's point goes to a target that is set anew in every tick. N - 1 loops are hard equalities;
joint positions and velocities are bounded. Only coopqp has a second level, joint centring, and
verifies what it is about to command.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from xml.etree import ElementTree as Xml

import numpy as np
import pinocchio as pin
from test_scaling import job as ring_job

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.robot import axis_of
from coopqp.scenario.loader import load
from coopqp.signals import Input
from coopqp.tasks import JointCentering, PointOnPoint

TICKS, ARRIVED = 300, 200  # of a motion; from then on the target rests
ARMS = (2, 3, 4, 8)
LIFT = np.array([0.05, 0.0, 0.08])  # what Baxter does [m]
TARGET = "target"


@dataclass(frozen=True)
class Job:
    """A motion.

    Attributes:
        name: of the robot.
        problem: for coopqp; its only task follows the input ``TARGET``.
        targets: of the object's point, shape (TICKS, 3) [m].
        urdf: of the arms, with links object0, object1, ... where each carries the object.
    """

    name: str
    problem: ControlProblem
    targets: Array
    urdf: str

    @property
    def gain(self) -> float:
        """Of the task [1/s]."""
        return float(self.problem.tasks[0].gain)

    def flat(self) -> dict[str, object]:
        """What a peer in another environment needs, as JSON has it."""
        chain = self.problem.chain
        return {
            "name": self.name,
            "urdf": self.urdf,
            "joints": list(chain.joint_names),
            "q": chain.q_start.tolist(),
            "arms": len(chain.arms),
            "dt": self.problem.dt,
            "targets": self.targets.tolist(),
        }


def jobs() -> Iterator[Job]:
    """NAO as in its shipped scenario, arms of seven joints in a ring, and Baxter."""
    nao = load("point_on_point").problem()
    goal = nao.tasks[0].goal
    yield _job("NAO", nao, np.array(goal) - nao.chain.start_position)
    for count in ARMS:
        problem = ring_job(count)
        goal = problem.tasks[0].goal
        yield _job(f"{count} arms", problem, np.array(goal) - problem.chain.start_position)
    yield _job("Baxter", load("baxter_tray").problem(), LIFT)


def _job(name: str, problem: ControlProblem, way: Array) -> Job:
    share = np.minimum(np.arange(1, TICKS + 1) / ARRIVED, 1.0)
    smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    asked = replace(
        problem,
        tasks=[PointOnPoint(name="reach", gain=problem.tasks[0].gain, goal=Input(name=TARGET))],
        secondary=[JointCentering(gain=0.5)],
        limits=[JointPosition(), JointVelocity()],
    )
    targets = problem.chain.start_position + np.outer(smooth, way)
    return Job(name, asked, targets, urdf(problem.chain))


def urdf(chain: ClosedChain) -> str:
    """The arms as a file; masses only because some readers refuse links without.

    Args:
        chain: whose joints have limits of position and speed.
    """
    model = chain.model
    robot = Xml.Element("robot", name="arms")
    compiler = {"fusestatic": "false", "discardvisual": "true", "inertiafromgeom": "false"}
    Xml.SubElement(Xml.SubElement(robot, "mujoco"), "compiler", compiler)
    Xml.SubElement(robot, "link", name="universe")
    for j in range(1, model.njoints):
        axis = axis_of(model.joints[j])
        assert axis is not None
        slides = bool(axis[:3].any())
        kind = "prismatic" if slides else "revolute"
        joint = _hung(robot, model, str(model.names[j]), kind, int(model.parents[j]),
                      model.jointPlacements[j], _link(j))  # fmt: skip
        Xml.SubElement(joint, "axis", xyz=_numbers(axis[:3] if slides else axis[3:]))
        bounds = zip(
            ("lower", "upper", "velocity", "effort"),
            (chain.lower[j - 1], chain.upper[j - 1], chain.velocity[j - 1], 1e3),
            strict=True,
        )
        Xml.SubElement(joint, "limit", {name: _number(x) for name, x in bounds})
    for i, frame in enumerate(model.frames[f] for f in chain.frames):
        name = f"object{i}"
        _hung(robot, model, f"{name}_joint", "fixed", frame.parentJoint, frame.placement, name)
    return Xml.tostring(robot, encoding="unicode")


def _hung(
    robot: Xml.Element, model: pin.Model, name: str, kind: str, parent: int, at: pin.SE3, link: str
) -> Xml.Element:
    """A joint, and the link that it carries."""
    body = Xml.SubElement(Xml.SubElement(robot, "link", name=link), "inertial")
    Xml.SubElement(body, "mass", value="0.1")
    turns = dict.fromkeys(("ixx", "iyy", "izz"), "0.001")
    Xml.SubElement(body, "inertia", {**turns, **dict.fromkeys(("ixy", "ixz", "iyz"), "0")})
    joint = Xml.SubElement(robot, "joint", name=name, type=kind)
    xyz, rpy = _numbers(at.translation), _numbers(pin.rpy.matrixToRpy(at.rotation))
    Xml.SubElement(joint, "origin", xyz=xyz, rpy=rpy)
    Xml.SubElement(joint, "parent", link="universe" if parent == 0 else _link(parent))
    Xml.SubElement(joint, "child", link=link)
    return joint


def _link(joint: int) -> str:
    return f"link{joint}"


def _numbers(values: Array) -> str:
    return " ".join(_number(x) for x in values)


def _number(x: float) -> str:
    return f"{x:.17g}"
