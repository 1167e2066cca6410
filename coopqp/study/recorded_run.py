"""The measured joints of a recorded run, as far as the arms hold the object as at its start."""

from __future__ import annotations

import math
from pathlib import Path

from coopqp.checked import Array
from coopqp.errors import InvalidValueError, UnknownNameError
from coopqp.plants import Kinematic
from coopqp.recordings.known import controllers_of
from coopqp.scenario.scenario import Scenario
from coopqp.study.trace_file import measured_joints


def measured_run(
    path: Path, scenario: Scenario, controller: str | None = None
) -> tuple[str, Array]:
    """Where the sensors said that the joints are, with the real loops closed.

    An arm that has let go takes hold otherwise than before, so that what comes after is of another
    grasp. On the plant ``kinematic`` nothing holds the hands together: only the first tick counts.

    Args:
        path: of ``trace.csv``, or of a run in another format.
        scenario: that it was written for.
        controller: whose; the first of the trace for which sensors said something when None.

    Returns:
        The controller's name, and the joints, shape (T, n) [rad, m].

    Raises:
        CoopqpError: no such file or controller, or no measured joints in it.
    """
    names = controllers_of(path)
    if controller is not None and controller not in names:
        raise UnknownNameError("controller", controller, names, f"{path}: ")
    for name in names if controller is None else (controller,):
        joints = scenario.held_by(name).chain.joint_names
        q = measured_joints(path, name, joints, _ticks(scenario))
        if len(q):
            return name, q[:1] if isinstance(scenario.plant, Kinematic) else q
    raise InvalidValueError(
        f"{path}: nothing to calibrate: no sensors say where the joints are; joints of the plant "
        "kinematic do exactly as told unless the scenario has a disturbance"
    )


def _ticks(scenario: Scenario) -> float:
    """Ticks before the first phase in which other arms hold than at the start."""
    phases, firsts = scenario.schedule, scenario.first_ticks
    for phase, first in zip(phases, firsts, strict=True):
        if set(phase.released) != set(phases[0].released):
            return first
    return math.inf
