"""A phase of a run as recorded, and rerun with wider limits, more time or another drift gain.

A rerun has only the phases up to the one that missed; the scenario itself is not changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

from coopqp.assessment import assess
from coopqp.base.errors import InvalidValueError
from coopqp.base.qp import Row
from coopqp.base.spec import Array
from coopqp.controller import Controller, ControlProblem
from coopqp.execution.controller_run import controller_of, run
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import GraspConfiguration
from coopqp.scenario.scenario import Scenario
from coopqp.signal import InputValues
from coopqp.solver import Status, causes_of
from coopqp.study.explanation.goal import Goal, Missed, PartOfTask, Room, parts_of, placed
from coopqp.trace import InputTrace, Trace, followed


@dataclass(frozen=True, kw_only=True)
class ExplainedPhase:
    """A phase of a run.

    Attributes:
        scenario: as the controller holds it, :meth:`Scenario.held_by`. name: the controller's.
        problem: without limits where the controller supports none.
        index, first: in the schedule; its first tick. phase_name: empty if it is the only one.
        q: shape (K + 1, n). v: shape (K, n). tau: shape (K, n), or empty.
        inputs: values of the whole run, by name.
        parts, errors: of all tasks; at the end [the part's unit].
        missed: parts that ended outside their tolerance, with their errors, as the assessment
            orders them. gave_way: those of them that come after the first.
        ordered: whether its law lets tasks of later levels give way.
    """

    scenario: Scenario
    name: str
    problem: ControlProblem
    index: int
    phase_name: str
    first: int
    q: Array
    v: Array
    tau: Array
    causes: tuple[tuple[Status, ...], ...]
    parts: tuple[PartOfTask, ...]
    errors: tuple[float, ...]
    missed: tuple[Missed, ...]
    gave_way: tuple[Missed, ...]
    ordered: bool
    inputs: Mapping[str, InputTrace]

    @property
    def controller(self) -> Controller:
        return controller_of(self.scenario, self.name)

    @property
    def t_end(self) -> float:
        """Duration [s]."""
        return len(self.v) * self.problem.dt

    @cached_property
    def room(self) -> Room:
        return Room(self.problem)

    @property
    def stands_still(self) -> str:
        """In how many ticks it stands still, in words."""
        count = sum(not causes[0].usable for causes in self.causes)
        return f"it stands still in {count} of {len(self.causes)} ticks"

    def followed(self, k: int) -> InputValues:
        """In a tick; at its end as in its last, the next is another phase's."""
        return followed(self.inputs, self.first + min(k, len(self.v) - 1))

    def goal(self) -> Goal:
        """Of its tasks with a place, at its end."""
        chain = self.problem.chain
        tasks = placed(self.problem.tasks, chain)
        return Goal(chain, tasks, self.t_end, self.followed(len(self.v)))


def explained_phases(scenario: Scenario, trace: Trace) -> Iterator[ExplainedPhase]:
    """The phases of a run of a scenario as the controller holds it, each with its own chain."""
    controller = controller_of(scenario, trace.controller)
    found = assess(trace)
    errors = {task.name: task.error for task in found.tasks}
    tau = trace.signals.get("tau", trace.v[:0])
    ends = pairwise((*scenario.first_ticks, scenario.ticks))
    problems = scenario.problems(lambda first: trace.q[first])
    phases = zip(problems, scenario.schedule, ends, strict=True)
    for i, (problem, phase, (first, end)) in enumerate(phases):
        parts = tuple(parts_of(phase.tasks, problem.chain))
        named = {f"{phase.name}.{p.name}" if scenario.phases else p.name: p for p in parts}
        if strange := [name for name in named if name not in errors]:
            words = "the trace is of another scenario than the one beside it"
            raise InvalidValueError(f"no error of '{strange[0]}' in the trace; {words}")
        ticks = slice(first, end)
        yield ExplainedPhase(
            scenario=scenario, name=trace.controller, index=i, phase_name=phase.name, first=first,
            problem=problem if "limits" in controller.supports else replace(problem, limits=()),
            q=trace.q[first : end + 1], v=trace.v[ticks], tau=tau[ticks],
            causes=tuple(causes_of(word) for word in trace.status[ticks]),
            parts=parts, errors=tuple(errors[name] for name in named), inputs=trace.inputs,
            missed=tuple((named[of.name], of.error) for of in found.missed if of.name in named),
            gave_way=tuple((named[of.name], of.error) for of in found.gave_way if of.name in named),
            ordered=trace.orders_tasks,
        )  # fmt: skip


#: A longer run has so many times the time more, and so much [s].
TIMES, MORE = 2.0, 2.0


@dataclass(frozen=True, kw_only=True)
class _Wider(Scenario):
    """A scenario whose joints have wider limits."""

    wider: Mapping[Row, float] = field(default_factory=dict)

    @cached_property
    def chain(self) -> ClosedChain:
        return ClosedChain(_widened(super().chain.hold, self.wider))


def rerun(
    phase: ExplainedPhase,
    *,
    longer: bool = False,
    wider: Mapping[Row, float] | None = None,
    **changed: Any,
) -> ExplainedPhase:
    """A phase rerun with other fields of its scenario, perhaps for longer.

    ``wider`` says, by the row of a position limit's side, how much wider it is [rad, m].
    """
    end = phase.scenario.schedule[phase.index]
    if longer:
        end = replace(end, duration=end.duration + TIMES * phase.t_end + MORE)
    if phase.scenario.phases:
        changed["phases"] = (*phase.scenario.phases[: phase.index], end)
    else:
        changed["duration"] = end.duration
    other = replace(phase.scenario, grasp_of={}, **changed)
    if wider:
        known = {name: getattr(other, name) for name in Scenario.__dataclass_fields__}
        other = _Wider(**known, wider=wider)
    again = run(other, controller=phase.name, timed=False)
    return list(explained_phases(other, again))[phase.index]


def arrival(goal: Goal, phase: ExplainedPhase) -> float:
    """When a phase that reached a goal arrived there for good [s]."""
    dt = phase.problem.dt
    for k in range(len(phase.v), 0, -1):
        goal.state.t = k * dt
        goal.look(phase.q[k])
        if goal.miss > 1.0:
            return (k + 1) * dt
    return dt


def _widened(hold: GraspConfiguration, wider: Mapping[Row, float]) -> GraspConfiguration:
    """With other position limits; passive joints have theirs in the grasp."""
    model, own = hold.robot.model.copy(), hold.robot.joint_names
    passive = dict(hold.passive)
    for row, amount in wider.items():
        side = str(row.side)
        outward = -amount if side == "lower" else amount
        if row.joint in own:
            limits = model.lowerPositionLimit if side == "lower" else model.upperPositionLimit
            limits[own.index(row.joint)] += outward
            continue
        arm, _, name = row.joint.partition(".")
        passive[arm] = tuple(
            j if j.name != name else replace(j, **{side: getattr(j, side) + outward})
            for j in passive[arm]
        )
    return replace(hold, robot=replace(hold.robot, model=model), passive=passive)
