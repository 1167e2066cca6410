"""A phase of a run as recorded, and rerun with wider limits, more time or another drift gain.

A rerun has only the phases up to the one that missed; the scenario itself is not changed.

By how much limits would have to be relaxed for a goal to be reached is tried in a rerun, first with
the minimal total violation of the limits with which the goal holds:

    minimise    sum s_j + 4 sum sigma_l                              [rad, and m times 4 rad/m]
    subject to  e(q) = 0,   e_loop(q) = 0
                lower - s <= q <= upper + s,   slack_k(q) >= -sigma_l,   s, sigma >= 0

with one s a joint's side and one sigma a limit in space (a wall moves as a whole), by sequential
linear programs from a configuration at the goal outside the limits; one radian counts as a quarter
of a metre. A law may stop short with it, where its path leads into a saddle; then the run is made
without position limits, and the largest violation on its path is enough.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from coopqp.assessment import assess
from coopqp.assessment.limits import audit
from coopqp.base.errors import InvalidValueError
from coopqp.base.qp import Row
from coopqp.base.spec import Array
from coopqp.controller import Controller, ControlProblem
from coopqp.execution.controller_run import controller_of, run
from coopqp.limit import Limit
from coopqp.model.closed_chain import ClosedChain
from coopqp.scenario.scenario import Scenario
from coopqp.signal import InputValues
from coopqp.solver import Status, causes_of
from coopqp.study.explanation import goal as geometry
from coopqp.study.explanation import words
from coopqp.study.explanation.diagnosis import BlockedByLimits
from coopqp.study.explanation.goal import (
    Goal,
    Missed,
    PositionLimits,
    Search,
    Share,
    parts_of,
    placed,
)
from coopqp.study.explanation.words import Needed, RunExplanation
from coopqp.task import Level, Task
from coopqp.trace import InputTrace, Trace, followed


@dataclass(frozen=True, kw_only=True)
class ExplainedPhase:
    """A phase of a run."""

    scenario: Scenario  # as the controller holds it, :meth:`Scenario.held_by`
    name: str  # of the controller
    problem: ControlProblem  # without limits where the controller supports none
    index: int  # in the schedule
    first: int  # its first tick
    q: Array  # shape (K + 1, n)
    v: Array  # shape (K, n)
    tau: Array  # shape (K, n), or empty
    causes: tuple[tuple[Status, ...], ...]
    errors: Mapping[str, float]  # at the end of each part of a task, by name [the part's unit]
    ordered: bool  # whether its law lets tasks of later levels give way
    level: Level | None  # of the first task that is missed; later ones take nothing from it
    # parts that ended outside their tolerance, with their errors, as the assessment orders them
    missed: tuple[Missed, ...]  # up to that level
    gave_way: tuple[Missed, ...]  # of later ones
    inputs: Mapping[str, InputTrace]  # values of the whole run, by name

    @property
    def controller(self) -> Controller:
        return controller_of(self.scenario, self.name)

    @property
    def t_end(self) -> float:
        """Duration [s]."""
        return len(self.v) * self.problem.dt

    @cached_property
    def bounds(self) -> PositionLimits:
        return PositionLimits(self.problem)

    @property
    def stands_still(self) -> str:
        count = sum(not causes[0].usable for causes in self.causes)
        return f"it stands still in {count} of {len(self.causes)} ticks"

    def followed(self, k: int) -> InputValues:
        """In a tick; at its end as in its last, the next is another phase's."""
        return followed(self.inputs, self.first + min(k, len(self.v) - 1))

    @property
    def counted(self) -> tuple[Task, ...]:
        """Its tasks up to the level."""
        last = self.level if self.ordered else None
        return tuple(task for task in self.problem.tasks if last is None or task.level <= last)

    def goal(self) -> Goal:
        """Of the tasks that count and have a place, at its end."""
        chain = self.problem.chain
        tasks = placed(self.counted, chain)
        return Goal(chain, tasks, self.t_end, self.followed(len(self.v)))


def explained_phases(
    scenario: Scenario, trace: Trace, level: Level | None = None
) -> Iterator[ExplainedPhase]:
    """The phases of a run of a scenario as the controller holds it, each with its own chain.

    ``level`` is the last that counts, if not that of the first task that a phase misses.
    """
    controller = controller_of(scenario, trace.controller)
    result = assess(trace)
    errors = {task.name: task.error for task in result.tasks}
    tau = trace.signals.get("tau", trace.v[:0])
    ends = pairwise((*scenario.first_ticks, scenario.ticks))
    problems = scenario.problems(lambda first: trace.q[first])
    phases = zip(problems, scenario.schedule, ends, strict=True)
    for i, (problem, phase, (first, end)) in enumerate(phases):
        begin = f"{phase.name}." if scenario.phases else ""
        named = {begin + part.name: part for part in parts_of(phase.tasks, problem.chain)}
        if strange := [name for name in named if name not in errors]:
            why = "the trace is of another scenario than the one beside it"
            raise InvalidValueError(f"no error of '{strange[0]}' in the trace; {why}")
        own = [of for of in result.missed if of.name in named]
        missed = tuple((named[of.name], of.error) for of in own)
        last = level or next((of.level for of in own), None)
        count, ticks = sum(last is None or of.level <= last for of in own), slice(first, end)
        yield ExplainedPhase(
            scenario=scenario, name=trace.controller, index=i, first=first,
            problem=problem if "limits" in controller.supports else replace(problem, limits=()),
            q=trace.q[first : end + 1], v=trace.v[ticks], tau=tau[ticks],
            causes=tuple(causes_of(word) for word in trace.status[ticks]),
            errors={part.name: errors[name] for name, part in named.items()}, inputs=trace.inputs,
            ordered=trace.orders_tasks, level=last, missed=missed[:count], gave_way=missed[count:],
        )  # fmt: skip


#: A longer run has so many times the time more, and so much [s].
TIMES, SECONDS = 2.0, 2.0


def rerun(
    phase: ExplainedPhase,
    *,
    longer: bool = False,
    wider: Mapping[Row, float] | None = None,
    tasks: Sequence[Task] = (),
    **changed: Any,
) -> ExplainedPhase:
    """A phase rerun with other tasks or fields of its scenario, perhaps for longer.

    ``wider`` says, by the row of a position limit's side, how much wider it is [rad, m].
    """
    end = phase.scenario.schedule[phase.index]
    end = replace(end, tasks=tuple(tasks) or end.tasks)
    if longer:
        end = replace(end, duration=end.duration + TIMES * phase.t_end + SECONDS)
    if phase.scenario.phases:
        changed["phases"] = (*phase.scenario.phases[: phase.index], end)
    else:
        changed |= {"duration": end.duration, "tasks": end.tasks}
    other = replace(phase.scenario, grasp_of={}, **changed)
    if wider:
        widen(other, wider)
    again = run(other, controller=phase.name, timed=False)
    return list(explained_phases(other, again, phase.level))[phase.index]


def arrival(goal: Goal, phase: ExplainedPhase) -> float:
    """When a phase that reached a goal arrived there for good, its references too [s]."""
    dt, end = phase.problem.dt, max((task.end for task in goal.tasks), default=0.0)
    for k in range(len(phase.v), 0, -1):
        goal.state.t = k * dt
        goal.look(phase.q[k])
        if goal.miss > 1.0 or k * dt < min(end, phase.t_end):
            return (k + 1) * dt
    return dt


def widen(scenario: Scenario, wider: Mapping[Row, float]) -> None:
    """Let the chain have other position limits; passive joints have theirs in the grasp."""
    hold = scenario.chain.hold
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
    other = replace(hold, robot=replace(hold.robot, model=model), passive=passive)
    vars(scenario)["chain"] = ClosedChain(other)  # what is cached there is not built again


#: Cost of a metre [rad], and of what the equalities are off by.
METRE, OFF = 4.0, 100.0
#: Steps, farthest that a joint goes in one [rad, m], how it shrinks, and where that ends.
STEPS, STEP, SHRINK, SMALLEST = 60, 0.3, 0.6, 1e-5
#: Newton steps after each, and the smallest decrease of the sum that is accepted.
NEWTON, ENOUGH = 2, 1e-6
#: Smallest singular value of the equalities that counts.
CUT = 1e-5
#: A violation below this is not named [rad, m].
NOTHING = 1e-4
#: A relaxation is suggested larger than the minimum by this share and amount [rad, m], rounded up.
SHARE, MORE = 1.05, 5e-4
#: Digits of an amount.
DIGITS = 2
#: Starts of the minimisation.
STARTS = 5


@dataclass(frozen=True)
class Violation:
    """By how much one limit is violated [rad or m]."""

    row: Row  # its most violated one
    amount: float
    limit: Limit | None = None  # in space; None for a joint's


def violations_along(bounds: PositionLimits, qs: Array) -> list[Violation]:
    """The largest violation of each limit along configurations, shape (T, n)."""
    slack, violations = np.array([bounds.slack(q) for q in qs]), []
    for owner in np.unique(bounds.owners).tolist():
        own = np.flatnonzero(bounds.owners == owner)
        row = bounds.all_rows[own[slack[-1, own].argmin()]]
        limit = bounds.limits[owner - len(bounds.sides)] if owner >= len(bounds.sides) else None
        violations.append(Violation(row, float(-slack[:, own].min()), limit))
    return [violation for violation in violations if violation.amount > NOTHING]


def _cost(row: Row) -> float:
    return METRE if row.unit == "m" else 1.0


class _Programs:
    """The linear programs whose steps lead to a minimal violation."""

    def __init__(self, goal: Goal, bounds: PositionLimits) -> None:
        self._goal, self._bounds = goal, bounds
        costs = dict(zip(bounds.owners.tolist(), map(_cost, bounds.all_rows), strict=True))
        self._costs = list(costs.values())

    def shrink(self, start: Array) -> list[Violation] | None:
        """A local minimum near a start; None where the goal is lost."""
        q, step = self._back(start), STEP
        merit, off = self._merit(q)
        if off >= 1.0:
            return None
        for _ in range(STEPS):
            d = self._step(q, step)
            if d is None or step < SMALLEST:
                break
            trial = self._back(q + d)
            trial_merit, off = self._merit(trial)
            if off < 1.0 and trial_merit < merit - ENOUGH:
                q, merit, step = trial, trial_merit, min(STEP, step / SHRINK)
            else:
                step *= SHRINK
        return violations_along(self._bounds, q[None])

    def _step(self, q: Array, max_step: float) -> Array | None:
        bounds, (C, r) = self._bounds, self._equalities(q)
        U, values, Vt = np.linalg.svd(C, full_matrices=False)
        kept = int((values > CUT).sum())
        equal = Vt[:kept], -(U[:, :kept].T @ r) / values[:kept]
        limits = bounds.ways(q), bounds.slack(q)
        relaxed = geometry.least_relaxation(equal, limits, bounds.owners, self._costs, max_step)
        return relaxed and relaxed[0]

    def _back(self, q: Array) -> Array:
        """Newton steps to where the equalities hold again, so that steps may be long."""
        for _ in range(NEWTON):
            C, r = self._equalities(q)
            q = q - np.linalg.lstsq(C, r, rcond=CUT)[0]
        return q

    def _equalities(self, q: Array) -> tuple[Array, Array]:
        goal = self._goal
        goal.look(q)
        C = np.vstack([goal.state.J_loop, goal.stack.J])
        return C, np.concatenate([goal.state.e_loop, goal.stack.e])

    def _merit(self, q: Array) -> tuple[float, float]:
        """Violation and residual of the equalities; the latter in tolerances as well."""
        off, goal = np.abs(self._equalities(q)[1]).sum(), self._goal
        violations = np.zeros(len(self._costs))
        np.maximum.at(violations, self._bounds.owners, -self._bounds.slack(q))
        return float(violations @ self._costs + OFF * off), max(goal.miss, goal.open / 1e-4)


@dataclass(frozen=True)
class SuggestedRelaxation:
    """Relaxations of limits, the largest first, and the rerun with them."""

    needs: tuple[Violation, ...]
    after: ExplainedPhase | None  # the rerun; None where a limit cannot be relaxed so far
    time: float | None = None  # that it takes, where that is more than the run has [s]
    untried: str = ""  # name of a limit that has no method for it; else no setting gives so much

    @property
    def reached(self) -> bool | None:
        return None if self.after is None else not self.after.missed


def by_geometry(
    phase: ExplainedPhase, goal: Goal, blocked: BlockedByLimits, report: Callable[[float], None]
) -> SuggestedRelaxation | None:
    """Relaxations where limits keep a phase from its goal; None where none were found."""
    needs = minimal_relaxations(goal, phase.bounds, blocked)
    report(0.5)
    first = _tried(phase, needs, goal)
    if first and first.reached:
        return first
    report(0.7)
    return by_rerun(phase, goal) or first


def by_rerun(phase: ExplainedPhase, goal: Goal | None) -> SuggestedRelaxation | None:
    """The violations of a run without position limits; with a goal more time is tried as well."""
    chain = phase.scenario.chain
    q, v = np.vstack([chain.q_start] * 2), np.zeros((1, chain.n))
    limits = tuple(  # without those of position, which braking before an end stop is as well
        limit
        for limit in phase.scenario.limits
        if all(
            row.unit not in geometry.PLACE_UNITS
            for row in audit([limit], chain, q, v, 0.01).margins
        )
    )
    free = rerun(phase, limits=limits)
    if free.missed and goal:
        free = rerun(phase, longer=True, limits=limits)
    if free.missed:
        return None
    return _tried(phase, _rounded(violations_along(phase.bounds, free.q)), goal)


def minimal_relaxations(
    goal: Goal, bounds: PositionLimits, blocked: BlockedByLimits
) -> tuple[Violation, ...]:
    """The smallest found from the configuration at the goal, and from others near by."""
    search, rng = Search(goal), np.random.default_rng(2)
    starts = [blocked.start]
    for _ in range(STARTS - 1):
        other = search.from_(blocked.start + rng.normal(scale=geometry.NEAR, size=goal.chain.n))
        if other.reached:
            starts.append(other.q)
    programs = _Programs(goal, bounds)
    minima = [minimum for q in starts if (minimum := programs.shrink(q)) is not None]
    fewest = min(
        minima, key=lambda all_: sum(one.amount * _cost(one.row) for one in all_), default=[]
    )
    return _rounded(fewest)  # nothing where all starts lose the goal


def _tried(
    phase: ExplainedPhase, needs: tuple[Violation, ...], goal: Goal | None
) -> SuggestedRelaxation | None:
    if not needs:
        return None
    limits = phase.scenario.limits
    for need in needs:
        if need.limit is not None:
            relaxed = need.limit.relaxed(need.amount)
            if relaxed is None:
                own = type(need.limit).relaxed is not Limit.relaxed
                return SuggestedRelaxation(needs, None, untried="" if own else need.row.owner)
            limits = tuple(relaxed if other is need.limit else other for other in limits)
    wider = {need.row: need.amount for need in needs if need.limit is None}
    after = rerun(phase, wider=wider, limits=limits)
    if after.missed and goal:
        late = rerun(phase, longer=True, wider=wider, limits=limits)
        if not late.missed:
            return SuggestedRelaxation(needs, late, arrival(goal, late))
    return SuggestedRelaxation(needs, after)


def _rounded(violations: Sequence[Violation]) -> tuple[Violation, ...]:
    """A little more than the minimum, rounded up to two digits, the largest first."""
    needs = []
    for violation in violations:
        more = SHARE * violation.amount + MORE
        step = 10.0 ** (math.floor(math.log10(more)) - DIGITS + 1)
        needs.append(replace(violation, amount=round(math.ceil(more / step - 1e-9) * step, 9)))
    return tuple(sorted(needs, key=lambda need: -need.amount))


def with_suggestion(
    base: RunExplanation,
    shares: Sequence[Share],
    suggestion: SuggestedRelaxation | None,
    *more: str,
) -> RunExplanation:
    """That limits hold a run back, and which relaxation would do."""
    sentence = "; ".join([words.holding(shares), _suggested(suggestion, shares), *more])
    if suggestion is None:
        return base.because("limits", sentence, shares)
    needs = tuple(
        Needed(limit=n.row.name, words=n.row.label, amount=n.amount, unit=n.row.unit)
        for n in suggestion.needs
    )
    tried, time = suggestion.reached, suggestion.time
    return base.because("limits", sentence, shares, needed=needs, tried=tried, time=time)


def _suggested(suggestion: SuggestedRelaxation | None, shares: Sequence[Share]) -> str:
    if suggestion is None:
        return "even without position limits the controller does not reach the goal"
    now = {geometry.thing_of(share.row) for share in shares}
    first = [need for need in suggestion.needs if geometry.thing_of(need.row) in now]
    later = [need for need in suggestion.needs if geometry.thing_of(need.row) not in now]
    text = f"to reach the goal, relax {needed(first or later)}"
    if first and later:
        text += f", and then {needed(later)}, inactive now"
    if suggestion.after is None:
        why = "no setting gives so much"
        if name := suggestion.untried:
            method = "no method relaxed(by), which returns it `by` metres farther out"
            why = f"limit '{name}' has {method}"
        return f"{text} (not tried: {why})"
    if suggestion.after.missed:
        return f"{text}; tried, but then {words.stops_short(*suggestion.after.missed[0])}"
    time = "" if suggestion.time is None else f", with a duration of {suggestion.time:g} s"
    others = [f"; {words.stops_short(*late)}" for late in suggestion.after.gave_way[:1]]
    return f"{text}{time} (tried: reached{''.join(others)})"


def needed(needs: Sequence[Violation]) -> str:
    """Limits with their relaxations."""
    clauses = []
    for need in needs:
        name = need.row.label if need.limit is None else need.row.owner.replace("_", " ")
        clauses.append(f"{name} by {words.size(need.amount, need.row.unit)}")
    return words.listed(clauses)
