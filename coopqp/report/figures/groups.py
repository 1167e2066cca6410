"""The figures of the page in groups, the most asked for first, with the words that they need."""

from __future__ import annotations

from dataclasses import dataclass, field

from coopqp.closed_loop.screw import LENGTH
from coopqp.execution.comparison import Comparison
from coopqp.report import audit
from coopqp.report.curves import Figure
from coopqp.report.figures.chart import Chart
from coopqp.report.figures.errors import loop_errors, task_errors
from coopqp.report.figures.forces import (
    forces,
    hands,
    load_shares,
    squeeze_of_fastened,
    torques,
)
from coopqp.report.figures.freedom import freedom_figures
from coopqp.report.figures.joints import PAPER_ROBOT, joint_figures
from coopqp.report.figures.limits import limit_figures
from coopqp.report.figures.object import object_figures
from coopqp.report.figures.times import tick_times


@dataclass(frozen=True, kw_only=True)
class Group:
    """Figures that belong together, with a hint how to read them, and words explained.

    Attributes:
        folded: shown on demand, and on paper. more: what those are.
        leads: whether it stands directly below the result.
    """

    title: str
    hint: str
    words: dict[str, str] = field(default_factory=dict)
    figures: list[Figure] = field(default_factory=list)
    folded: list[Figure] = field(default_factory=list)
    more: str = ""
    leads: bool = False


def groups(comparison: Comparison) -> list[Group]:
    """Those that have figures, in the order of the page."""
    chart = Chart(comparison)
    decisive, joints = _joints(chart)
    found = [
        decisive,
        _object(chart),
        _errors(chart),
        _limits(chart),
        joints,
        _freedom(chart),
        _hands(chart),
        _torques(chart),
        _rest(chart),
    ]
    return [group for group in found if group.figures or group.folded]


def _object(chart: Chart) -> Group:
    figures, others = object_figures(chart)
    return Group(
        title="Where the object is",
        hint="Dashed black: the goal of a task, where it fixes the coordinate. Dotted: the "
        "reference, which leads from the start to the goal in the task's own time.",
        words={"Tilt": "the angle between the object's z axis and the world's."},
        figures=figures,
        folded=others,
        more="Other points of the object that tasks steer",
    )


def _errors(chart: Chart) -> Group:
    figures, others = task_errors(chart)
    return Group(
        title="How far the tasks are from done",
        hint="First to the goal itself, then to the reference that leads there: a law that follows "
        "well is near zero there all the time, long before it is at the goal.",
        figures=figures,
        folded=others,
        more="The other tasks",
    )


def _limits(chart: Chart) -> Group:
    return Group(
        title="Room to the limits",
        hint="Hatched: beyond a limit, where the robot cannot go.",
        words={
            "Margin": "distance of the joint nearest to its limit. It tells whether limits are "
            "kept.",
            "Criterion φ": "the sum over all joints of ((q - middle) / range)²: 0 with every "
            "joint in the middle of its range, a quarter for each joint at a limit. "
            "joint_centering as the null-space term Z of the paper's eq. (33) goes down its "
            "gradient. φ can fall while one joint leaves its limits: a small φ is no promise.",
            "Null-space term": "motion of the joints that neither tasks nor loops feel, so that it "
            "is free for a second purpose.",
        },
        figures=limit_figures(chart),
    )


def _joints(chart: Chart) -> tuple[Group, Group]:
    decisive, first, others = joint_figures(chart)
    paper = (
        " The paper's figures 4 to 8 are q1 to q5 of the right arm: its pseudo is pseudoinverse "
        "here, its joint limit motion pseudoinverse_null_space."
        if chart.comparison.scenario.robot_model.name == PAPER_ROBOT
        else ""
    )
    nearest = Group(
        title="The joint nearest to a limit",
        hint="The one that comes nearest to a limit or goes farthest beyond it, with the same "
        "joint of the other arm. Hatched: beyond a limit. A cross marks where a joint leaves its "
        "limits.",
        figures=decisive,
        leads=True,
    )
    others_near = "others that come near" if decisive else "ones that come nearest to"
    return nearest, Group(
        title="Joints",
        hint=f"The {others_near} a limit, with the same joint of the other arm.{paper}",
        figures=first,
        folded=others,
        more=f"The other {len(others)} joints",
    )


def _freedom(chart: Chart) -> Group:
    return Group(
        title="How freely the object can be moved",
        hint="Of the matrix M = J N: N are the joint motions that keep the loops closed, J is what "
        f"the tasks measure (angles count {LENGTH:g} m a radian), by the controller's model.",
        words={
            "Condition": "its largest singular value over its smallest: how much more the "
            "joints have to move for the hardest direction than for the easiest. It grows without "
            "bound near a singular posture, where the pseudoinverse asks for speeds without bound.",
            "Manipulability": "the product of its singular values (Yoshikawa): 0 where a direction "
            "is lost.",
        },
        figures=freedom_figures(chart),
    )


def _hands(chart: Chart) -> Group:
    figures = hands(chart)
    return Group(
        title="Hands that press",
        hint="Hatched: beyond friction, where the object slips along the hand, and beyond a pad's "
        "edge, over which it tips.",
        words={
            "Friction": "the coefficient that the hand's wrench needs, over the real one. What a "
            "controller counts on is less, by its safety factor.",
            "Pressure": "where the normal force is on the pad: 0 in the middle, 1 at the edge.",
        },
        figures=figures,
        folded=load_shares(chart) if figures else [],
        more="Share of the load by arm",
    )


def _torques(chart: Chart) -> Group:
    shares = [] if hands(chart) else load_shares(chart)
    return Group(
        title="Torques and forces",
        hint="Hatched: beyond what the motor can do.",
        words={
            "Internal force": "what the hands do to each other through the object: it squeezes "
            "the object and does not move it.",
            "Squeeze": "its part along the line between two hands: above zero they press.",
        }
        if forces(chart)
        else {},
        figures=[*squeeze_of_fastened(chart), *forces(chart)],
        folded=[*torques(chart), *shares],
        more="Torque of each motor" + (", share of the load by arm" if shares else ""),
    )


def _rest(chart: Chart) -> Group:
    active = audit.timeline(chart.traces, chart.styles)
    return Group(
        title="Loops, active limits and computing time",
        hint="",
        words={
            "Loop error": "how far apart two arms carry the object; the drift correction κ "
            "pulls it back.",
            "Active": "a limit that the QP is at, which then decides with it what is done.",
        },
        folded=[*loop_errors(chart), *([active] if active else []), *tick_times(chart)],
        more="Loop errors, active limits, time of a tick",
    )
