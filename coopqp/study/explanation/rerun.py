"""The run again with something changed: wider limits, more time, another drift gain.

Only phases up to the one that missed are run. Nothing of the scenario itself is touched.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from coopqp.closed_chain import ClosedChain
from coopqp.controller import ControlProblem
from coopqp.controller_run import run
from coopqp.disturbance import Disturbance
from coopqp.hold import Hold
from coopqp.limit import Limit
from coopqp.row import Row
from coopqp.scenario.scenario import Phase, Scenario
from coopqp.study.explanation.goal import Goal
from coopqp.study.explanation.leg import Leg, legs, recording_of
from coopqp.study.explanation.room import PLACE_UNITS
from coopqp.task import Task

#: A longer run has so many times the time more, and so much [s].
TIMES, MORE = 2.0, 2.0


@dataclass(frozen=True)
class Change:
    """What a rerun changes.

    Attributes:
        joints: wider position limits, by the row of the side [rad, m].
        limits: each with the one instead.
        without_places: leave out every limit that bounds a place.
        longer: more time for the last phase [s].
        tasks: tasks instead of others, by name, in the last phase.
        kappa: another drift gain [1/s]; the scenario's where None.
        leave_out: limits.
        perfect: whether the controller knows all: no disturbance.
    """

    joints: Mapping[Row, float] = field(default_factory=dict)
    limits: tuple[tuple[Limit, Limit], ...] = ()
    without_places: bool = False
    longer: float = 0.0
    tasks: Mapping[str, Task] = field(default_factory=dict)
    kappa: float | None = None
    leave_out: tuple[Limit, ...] = ()
    perfect: bool = False


@dataclass(frozen=True, kw_only=True)
class _Wider(Scenario):
    """A scenario whose joints have wider limits."""

    wider: Mapping[Row, float] = field(default_factory=dict)

    def problem(
        self, phase: Phase | None = None, chain: ClosedChain | None = None
    ) -> ControlProblem:
        return super().problem(phase, ClosedChain(_widened((chain or self.chain).hold, self.wider)))


def rerun(scenario: Scenario, controller: str, phase: int, change: Change) -> Leg:
    """What becomes of a phase when something is changed.

    Args:
        scenario: as the controller holds it.
        controller: its name.
        phase: index of the last phase to run.
        change: of what.
    """
    other = _changed(scenario, phase, change)
    trace = run(other, controller=controller, timed=False)
    return list(legs(other, recording_of(trace)))[phase]


def longer(leg: Leg) -> float:
    """How much more time a longer run gets [s]."""
    return TIMES * leg.t_end + MORE


def arrival(goal: Goal, leg: Leg) -> float:
    """From when on all tasks with a place are within their tolerances [s].

    Args:
        goal: of these tasks.
        leg: that reached it.
    """
    dt = leg.problem.dt
    for k in range(len(leg.v), 0, -1):
        goal.state.t = k * dt
        goal.look(leg.q[k])
        if goal.miss > 1.0:
            return (k + 1) * dt
    return dt


def _changed(scenario: Scenario, phase: int, change: Change) -> Scenario:
    """The scenario to be run."""
    kept = [limit for limit in scenario.limits if limit not in change.leave_out]
    limits = [_instead(limit, change) for limit in kept]
    if change.without_places:
        limits = [limit for limit in limits if not bounds_places(limit, scenario.chain)]
    known = {name: getattr(scenario, name) for name in Scenario.__dataclass_fields__}
    known |= _times(scenario, phase, change)
    known |= {"limits": tuple(limits), "grasp_of": {}}
    if change.perfect:
        known["disturbance"] = Disturbance()
    if change.kappa is not None:
        known["kappa"] = change.kappa
    return _Wider(**known, wider=change.joints) if change.joints else Scenario(**known)


def _times(scenario: Scenario, phase: int, change: Change) -> dict[str, object]:
    """Phases up to the one that counts, or the tasks and the duration where there are none."""
    last = scenario.schedule[phase]
    tasks = tuple(change.tasks.get(task.name, task) for task in last.tasks)
    duration = last.duration + change.longer
    if not scenario.phases:
        return {"tasks": tasks, "duration": duration}
    end = replace(last, tasks=tasks, duration=duration)
    return {"phases": (*scenario.phases[:phase], end)}


def _instead(limit: Limit, change: Change) -> Limit:
    return next((other for one, other in change.limits if one is limit), limit)


def bounds_places(limit: Limit, chain: ClosedChain) -> bool:
    """Whether a limit says where joints or points may be, as braking before a stop does."""
    q, v = np.vstack([chain.q_start] * 2), np.zeros((1, chain.n))
    return any(row.unit in PLACE_UNITS for row in limit.margins(chain, q, v, 0.01))


def _widened(hold: Hold, wider: Mapping[Row, float]) -> Hold:
    """The hold with other position limits; passive joints have theirs in the grasp."""
    model = hold.robot.model.copy()
    own = {name: i for i, name in enumerate(hold.robot.joint_names)}
    passive = {arm: list(joints) for arm, joints in hold.passive.items()}
    for row, amount in wider.items():
        if row.joint in own:
            side = model.lowerPositionLimit if row.side == "lower" else model.upperPositionLimit
            side[own[row.joint]] += -amount if row.side == "lower" else amount
            continue
        arm, _, name = row.joint.partition(".")
        for i, joint in enumerate(passive[arm]):
            if joint.name == name and row.side == "lower":
                passive[arm][i] = replace(joint, lower=joint.lower - amount)
            elif joint.name == name:
                passive[arm][i] = replace(joint, upper=joint.upper + amount)
    return replace(
        hold,
        robot=replace(hold.robot, model=model),
        passive={arm: tuple(joints) for arm, joints in passive.items()},
    )
