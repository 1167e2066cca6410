"""A task that gives way to a push: what its springs bear where the run ends, F = K e.

In the end a steady force moves it by F/K, so it is no goal that was missed but what was asked for.
"""

from __future__ import annotations

import numpy as np

from coopqp.assessment.thresholds import rests
from coopqp.checked import Array
from coopqp.closed_chain import AXES
from coopqp.closed_loop.screw import LENGTH
from coopqp.scenario.scenario import Scenario
from coopqp.study.explanation import words
from coopqp.study.explanation.goal import Goal
from coopqp.study.explanation.leg import Leg

#: A spring that bears less than this share of the strongest is not told of.
WORTH_TELLING = 0.02


def pushed(scenario: Scenario, leg: Leg, goal: Goal) -> str:
    """What pushes a task that gives way at the end; empty where none does, or it still moves.

    Args:
        scenario: as the controller holds it.
        leg: that missed.
        goal: of its tasks, looked at where the leg ends.
    """
    task = leg.missed[0][0].task
    springs = task.impedance
    if springs is None:
        return ""
    push = scenario.disturbance.push
    since = leg.first * leg.problem.dt
    lasts = push is not None and push.wrench(since + leg.t_end - leg.problem.dt) is not None
    if not (lasts or rests(leg.v[-1])):
        return ""
    rows = goal.stack.slices[goal.tasks.index(task)]
    forces = springs.stiffness * goal.stack.e[rows]
    said = _said(tuple(AXES[axis] for axis in springs.axes), forces)
    text = f"it gives way as asked: its springs bear {said} there, and move by F/K"
    if push is not None and lasts:
        until = push.start + push.duration
        return f"{text}; the scenario's push lasts until {until:.3g} s, the run {_end(leg):.3g} s"
    return f"{text}; that is a push, a weight that is wrong, or another task that pulls"


def _end(leg: Leg) -> float:
    """When the leg ends, since the run began [s]."""
    return leg.first * leg.problem.dt + leg.t_end


def _said(axes: tuple[str, ...], forces: Array) -> str:
    """Forces and torques by axis, without what is next to nothing."""
    turns = np.array([axis.startswith("rot") for axis in axes])
    sizes = np.abs(forces) / np.where(turns, LENGTH, 1.0)
    told = []
    for i in np.flatnonzero(sizes > WORTH_TELLING * sizes.max()):
        unit, way = ("N m", "about") if turns[i] else ("N", "along")
        told.append(f"{forces[i]:.3g} {unit} {way} {axes[i].removeprefix('rot_')}")
    return words.listed(told)
