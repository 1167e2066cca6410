"""The run again with something changed: wider limits, more time, another drift gain.

Only phases up to the one that missed are run. Nothing of the scenario itself is touched.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from coopqp.assessment.limits import audit
from coopqp.base.qp import Row
from coopqp.execution.controller_run import run
from coopqp.grasp import PassiveJoint
from coopqp.limit import Limit
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import GraspConfiguration
from coopqp.scenario.scenario import Scenario
from coopqp.study.explanation.explained_phase import ExplainedPhase, legs
from coopqp.study.explanation.goal import Goal
from coopqp.study.explanation.room import PLACE_UNITS

#: A longer run has so many times the time more, and so much [s].
TIMES, MORE = 2.0, 2.0


@dataclass(frozen=True, kw_only=True)
class _Wider(Scenario):
    """A scenario whose joints have wider limits."""

    wider: Mapping[Row, float] = field(default_factory=dict)

    @cached_property
    def chain(self) -> ClosedChain:
        """As the scenario's; later phases take its limits over."""
        return ClosedChain(_widened(super().chain.hold, self.wider))


def rerun(
    leg: ExplainedPhase,
    *,
    longer: bool = False,
    wider: Mapping[Row, float] | None = None,
    **changed: Any,
) -> ExplainedPhase:
    """What becomes of a phase when something is changed.

    Args:
        leg: the phase as it was.
        longer: whether it gets more time.
        wider: position limits, by the row of the side, and how much wider they are [rad, m].
        changed: fields of the scenario.
    """
    end = leg.scenario.schedule[leg.index]
    if longer:
        end = replace(end, duration=end.duration + TIMES * leg.t_end + MORE)
    if leg.scenario.phases:
        changed["phases"] = (*leg.scenario.phases[: leg.index], end)
    else:
        changed["duration"] = end.duration
    other = replace(leg.scenario, grasp_of={}, **changed)
    if wider:
        known = {name: getattr(other, name) for name in Scenario.__dataclass_fields__}
        other = _Wider(**known, wider=wider)
    return list(legs(other, run(other, controller=leg.name, timed=False)))[leg.index]


def arrival(goal: Goal, leg: ExplainedPhase) -> float:
    """From when on a leg that reached a goal is there [s]."""
    dt = leg.problem.dt
    for k in range(len(leg.v), 0, -1):
        goal.state.t = k * dt
        goal.look(leg.q[k])
        if goal.miss > 1.0:
            return (k + 1) * dt
    return dt


def without_places(scenario: Scenario) -> tuple[Limit, ...]:
    """Limits that do not say where joints or points may be, as braking before a stop does."""
    chain = scenario.chain
    q, v = np.vstack([chain.q_start] * 2), np.zeros((1, chain.n))
    return tuple(
        limit
        for limit in scenario.limits
        if all(row.unit not in PLACE_UNITS for row in audit([limit], chain, q, v, 0.01).margins)
    )


def _widened(hold: GraspConfiguration, wider: Mapping[Row, float]) -> GraspConfiguration:
    """The hold with other position limits; passive joints have theirs in the grasp."""
    model, own = hold.robot.model.copy(), hold.robot.joint_names
    passive = dict(hold.passive)
    for row, amount in wider.items():
        if row.joint in own:
            side = model.lowerPositionLimit if row.side == "lower" else model.upperPositionLimit
            side[own.index(row.joint)] += -amount if row.side == "lower" else amount
            continue
        arm, _, name = row.joint.partition(".")
        passive[arm] = tuple(
            _wider(joint, row, amount) if joint.name == name else joint for joint in passive[arm]
        )
    return replace(hold, robot=replace(hold.robot, model=model), passive=passive)


def _wider(joint: PassiveJoint, row: Row, amount: float) -> PassiveJoint:
    if row.side == "lower":
        return replace(joint, lower=joint.lower - amount)
    return replace(joint, upper=joint.upper + amount)
