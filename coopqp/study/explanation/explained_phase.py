"""A phase of a run as it was: what was asked in it, and what became of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

from coopqp.assessment import assess
from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.controller import Controller, ControlProblem
from coopqp.execution.controller_run import controller_of
from coopqp.scenario.scenario import Scenario
from coopqp.signal import InputValues
from coopqp.solver import Status, causes_of
from coopqp.study.explanation.goal import Goal, Missed, PartOfTask, parts_of, placed
from coopqp.study.explanation.room import Room
from coopqp.trace import InputTrace, Trace, followed


@dataclass(frozen=True, kw_only=True)
class ExplainedPhase:
    """A phase of a run.

    Attributes:
        scenario: as the controller holds it, :meth:`Scenario.held_by`. name: the controller's.
        problem: what it was built for; without limits where it supports none.
        index: in the schedule. phase: its name, empty where there is one only.
        first: its first tick.
        q: shape (K + 1, n). v: shape (K, n). tau: shape (K, n), or empty.
        causes: of each tick.
        inputs: what was followed in the whole run, by name.
        parts: of all tasks. errors: at the end, by the parts' order [the part's unit].
        missed: parts that ended outside their tolerance, with their errors, as the assessment
            orders them. gave_way: those of them that come after the first.
        ordered: whether its law lets tasks of later levels give way.
    """

    scenario: Scenario
    name: str
    problem: ControlProblem
    index: int
    phase: str
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
        """Settings of the controller."""
        return controller_of(self.scenario, self.name)

    @property
    def t_end(self) -> float:
        """Since the phase began [s]."""
        return len(self.v) * self.problem.dt

    @cached_property
    def room(self) -> Room:
        """What its limits leave."""
        return Room(self.problem)

    @property
    def stands_still(self) -> str:
        """In how many ticks it does."""
        count = sum(not causes[0].usable for causes in self.causes)
        return f"it stands still in {count} of {len(self.causes)} ticks"

    def followed(self, k: int) -> InputValues:
        """What was made of the inputs in a tick of the leg."""
        return followed(self.inputs, self.first + k)

    def goal(self) -> Goal:
        """Of its tasks with a place, when it ends."""
        chain = self.problem.chain
        tasks = placed(self.problem.tasks, chain)
        return Goal(chain, tasks, self.t_end, self.followed(len(self.v)))


def legs(scenario: Scenario, trace: Trace) -> Iterator[ExplainedPhase]:
    """The phases of a run, each with its own chain.

    Args:
        scenario: as the controller holds it, :meth:`Scenario.held_by`.
        trace: of the controller.

    Raises:
        InvalidValueError: the trace is of another scenario.
    """
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
            scenario=scenario, name=trace.controller, index=i, phase=phase.name, first=first,
            problem=problem if "limits" in controller.supports else replace(problem, limits=()),
            q=trace.q[first : end + 1], v=trace.v[ticks], tau=tau[ticks],
            causes=tuple(causes_of(word) for word in trace.status[ticks]),
            parts=parts, errors=tuple(errors[name] for name in named), inputs=trace.inputs,
            missed=tuple((named[of.name], of.error) for of in found.missed if of.name in named),
            gave_way=tuple((named[of.name], of.error) for of in found.gave_way if of.name in named),
            ordered=trace.orders_tasks,
        )  # fmt: skip
