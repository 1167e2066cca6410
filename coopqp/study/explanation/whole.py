"""Why a whole run did not reach its goal, and what would do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from coopqp.assessment import Assessment
from coopqp.assessment.verdict import loop_words, not_followed, saturation_words
from coopqp.checked import Array
from coopqp.controller_run import controller_of
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status
from coopqp.study.explanation import late, velocity, words
from coopqp.study.explanation.contradiction import Contradiction
from coopqp.study.explanation.cure import Cure, cure
from coopqp.study.explanation.diagnosis import (
    BlockedByLimits,
    Diagnosis,
    Elsewhere,
    NotBlocked,
    OutOfReach,
    TooFewFreedoms,
    diagnose,
)
from coopqp.study.explanation.goal import Goal, placed
from coopqp.study.explanation.leg import Leg, Recording, assessed, legs
from coopqp.study.explanation.lost import lost
from coopqp.study.explanation.room import Room
from coopqp.study.explanation.shares import Share
from coopqp.study.explanation.unmet import Relaxed, relaxed

Report = Callable[[float], None]


@dataclass(frozen=True, kw_only=True)
class Missed:
    """A part of a task that ended outside its tolerance."""

    task: str
    error: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class HeldBack:
    """A limit that holds back, with its share of the force."""

    limit: str
    words: str
    share: float


@dataclass(frozen=True, kw_only=True)
class Needed:
    """What a limit would have to give [rad or m]."""

    limit: str
    words: str
    amount: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class RunExplanation:
    """Why a run did not reach its goal.

    Attributes:
        controller: whose run.
        phase: that missed, empty where there is one only.
        tick: its last.
        kind: reached, broken, open, input, lost, limits, elsewhere, reach, contradiction,
            freedom, speed, budget, short, rest, model, motors, springs, way, failed or unplaced.
        missed: what ended outside its tolerance, hard and scaled tasks first, then the worst.
        held_back: limits by their share of the force.
        needed: what limits would have to give.
        tried: whether a rerun with all of that, or with the time needed, reached the goal; None
            where nothing was tried.
        tasks: that contradict each other, or are out of reach.
        any_robot: whether they would on any other robot.
        distance: out of reach by so much, in the unit of what is missed most.
        way: unit vector to the goal from the nearest point, where that is one of the world's.
        time: that would do, or at which the object was lost [s].
        relaxed: hard and scaled tasks that were not met in full on the way.
        sentence: all of it in words.
    """

    controller: str
    phase: str
    tick: int
    kind: str
    sentence: str
    missed: tuple[Missed, ...] = ()
    held_back: tuple[HeldBack, ...] = ()
    needed: tuple[Needed, ...] = ()
    tried: bool | None = None
    tasks: tuple[str, ...] = ()
    any_robot: bool = False
    distance: float | None = None
    way: tuple[float, ...] = ()
    time: float | None = None
    relaxed: tuple[Relaxed, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """For machines."""
        return asdict(self)


def explain_run(
    scenario: Scenario, run: Recording, report: Report = lambda share: None
) -> RunExplanation:
    """Say why a run did not reach its goals.

    Args:
        scenario: that was run.
        run: of one of its controllers.
        report: called now and then with the share that is done.

    Raises:
        CoopqpError: no such controller, or the scenario cannot be run again.
    """
    held = scenario.held_by(run.controller)
    found, phases = assessed(held, run), list(legs(held, run))
    leg = next((leg for leg in phases if leg.missed), phases[-1])
    explained = _explained(held, run, found, phases, leg, report)
    saturated = saturation_words(found)
    if not saturated or explained.kind == "motors":
        return explained
    return replace(explained, sentence=f"{explained.sentence}; it saturates {saturated}")


def _explained(
    held: Scenario,
    run: Recording,
    found: Assessment,
    phases: Sequence[Leg],
    leg: Leg,
    report: Report,
) -> RunExplanation:
    base, torn = _base(run, leg), any(task.torn for task in found.tasks)
    suspect = leg.missed or torn or found.held is False
    if suspect and (gone := lost(held, run.controller, leg)):
        return replace(base, kind="lost", sentence=gone.sentence, tried=gone.tried, time=gone.time)
    if unheard := not_followed(found):
        return replace(base, kind="input", sentence=f"no goal counts as reached: {unheard}")
    if torn and not leg.missed:
        said = f"no goal counts as reached: the loop came open by {loop_words(found)} on the way"
        return replace(base, kind="open", sentence=said)
    failed = _failed(leg) if leg.missed or not found.reached else ""
    if failed:
        said = f"{words.stops(leg)}; {failed}" if leg.missed else failed
        return replace(base, kind="failed", sentence=said)
    relaxed_by = [leg] if leg.missed else phases
    base = replace(base, relaxed=_relaxed(held, run.controller, relaxed_by))
    if not leg.missed:
        return _kept(found, phases, base)
    answer = _Whole(held, run, leg, base, report).explained()
    said = "; ".join([answer.sentence, *(task.words for task in base.relaxed)])
    return replace(answer, sentence=said)


def _relaxed(scenario: Scenario, controller: str, phases: Sequence[Leg]) -> tuple[Relaxed, ...]:
    """Of a law that commands velocities, in whose ticks they can be seen."""
    return () if controller_of(scenario, controller).commands_torques else relaxed(phases)


def _base(run: Recording, leg: Leg) -> RunExplanation:
    missed = tuple(
        Missed(task=part.name, error=error, unit=part.part.unit) for part, error in leg.missed
    )
    return RunExplanation(
        controller=run.controller,
        phase=leg.name,
        tick=leg.first + len(leg.v) - 1,
        kind="",
        sentence="",
        missed=missed,
    )


def _kept(found: Assessment, phases: Sequence[Leg], base: RunExplanation) -> RunExplanation:
    """Of a run that got there, but perhaps not as it should."""
    said, kind = [], "reached"
    if not found.succeeds:
        kind = "broken" if found.loop_closed else "open"
        said = [text for text in (_opened(found, phases[0]), words.broken(found)) if text]
    said += [task.words for task in base.relaxed]
    count = sum(Status.TASKS_RELAXED in causes for leg in phases for causes in leg.causes)
    if base.relaxed:
        said.append("--tick says why")
    elif count:
        said.append(f"in {count} ticks hard tasks are not met in full")
    goals = "every goal is reached" if found.succeeds else "the goals are reached"
    return replace(base, kind=kind, sentence=f"{goals}{', but ' if said else ''}{'; '.join(said)}")


def _opened(found: Assessment, leg: Leg) -> str:
    """How far the loop came open, and what corrects it; empty where it was closed."""
    if found.loop_closed:
        return ""
    kappa = leg.problem.kappa
    why = f"with kappa: {kappa:g} 1/s" if kappa else "kappa: 0 corrects no drift"
    return f"the loop came open by {loop_words(found)} ({why})"


def _failed(leg: Leg) -> str:
    """Why the last tick stood still, where that is no answer of geometry's."""
    last = leg.causes[-1][0]
    if last.usable or last in (Status.INFEASIBLE, Status.LOOP_BUDGET):
        return "" if np.isfinite(leg.q[-1]).all() else "the joints are no finite numbers any more"
    count = sum(not causes[0].usable for causes in leg.causes)
    why = last.value.removeprefix("stands still: ")
    return f"it stands still in {count} of {len(leg.causes)} ticks: {why}"


class _Whole:
    """One explanation on its way."""

    def __init__(
        self, scenario: Scenario, run: Recording, leg: Leg, base: RunExplanation, report: Report
    ) -> None:
        self._scenario, self._name, self._leg = scenario, run.controller, leg
        self._base, self._report = base, report
        problem = leg.problem
        tasks = placed(problem.tasks, problem.chain)
        self._goal = Goal(problem.chain, tasks, leg.t_end, leg.followed(len(leg.v)))
        self._room = Room(problem.chain, problem.limits, problem.dt)

    def explained(self) -> RunExplanation:
        """The answer."""
        leg, base = self._leg, self._base
        places = [part for part, _ in leg.missed if part.task in self._goal.tasks]
        velocities = [part for part, _ in leg.missed if part.task.asks_velocity]
        if velocities and (not places or velocity.contradicting(leg)):
            return self._velocity()
        if not places and Status.SQUEEZE_GIVEN_UP in leg.causes[-1]:
            said = (
                "the hands stand at admittance.most_way; raise it, unless the force sensor is dead"
            )
            return replace(base, kind="way", sentence=f"{words.stops(leg)}; {said}")
        if not places:
            said = f"{words.stops(leg)}; it asks for no place"
            return replace(base, kind="unplaced", sentence=said)
        found = self._diagnosed(leg.q[-1])
        self._report(0.4)
        if velocities and isinstance(found, NotBlocked):
            return self._velocity()
        return self._said(found)

    def _diagnosed(self, q: Array) -> Diagnosis:
        """Of hard and scaled tasks alone where geometry keeps them already from their goals."""
        modes = {part.task.mode for part, _ in self._leg.missed} if self._ordered() else {"soft"}
        heeded = {"hard"} if "hard" in modes else {"hard", "scaled"}
        first = [task for task in self._goal.tasks if task.mode in heeded]
        if first and modes != {"soft"}:
            goal = self._goal.only(first)
            found = diagnose(goal, self._room, q)
            if not isinstance(found, NotBlocked):
                self._goal = goal
                return found
        return diagnose(self._goal, self._room, q)

    def _said(self, found: Diagnosis) -> RunExplanation:
        """What geometry says, in words."""
        leg, base = self._leg, self._base
        if isinstance(found, NotBlocked):
            return self._late(found)
        if isinstance(found, BlockedByLimits):
            return self._limits(found)
        if isinstance(found, Elsewhere):
            said = f"{self._held(found.shares)}; {words.elsewhere(found.place, leg.problem.chain)}"
            return replace(
                base, kind="elsewhere", sentence=said, held_back=_held_back(found.shares)
            )
        if isinstance(found, Contradiction):
            return replace(
                base,
                kind="contradiction",
                sentence=words.contradiction(found, leg.missed, ordered=self._ordered()),
                tasks=tuple(task.name for task in found.tasks),
                any_robot=found.any_robot,
            )
        if isinstance(found, TooFewFreedoms):
            said = f"{words.stops(leg)}; {words.freedoms(found)}"
            tasks = (found.goal.tasks[0].name,)
            return replace(base, kind="freedom", sentence=said, tasks=tasks)
        return self._reach(found)

    def _ordered(self) -> bool:
        """Whether the law heeds which task comes first."""
        return {"modes", "priorities"} <= controller_of(self._scenario, self._name).heeds

    def _held(self, shares: tuple[Share, ...]) -> str:
        return f"{words.stops(self._leg)}; {words.holding(shares)}"

    def _limits(self, found: BlockedByLimits) -> RunExplanation:
        cured = cure(
            self._scenario, self._name, self._leg, self._goal, self._room, found, self._report
        )
        said = f"{self._held(found.shares)}; {words.cure(cured, found.shares)}"
        if found.elsewhere:
            said += f"; {words.elsewhere(found.elsewhere, self._leg.problem.chain)}"
        return self._with(cured, found.shares, said)

    def _with(self, cured: Cure | None, shares: tuple[Share, ...], said: str) -> RunExplanation:
        needed = tuple(
            Needed(limit=n.row.name, words=n.row.words, amount=n.amount, unit=n.row.unit)
            for n in (cured.needs if cured else ())
        )
        return replace(
            self._base,
            kind="limits",
            sentence=said,
            held_back=_held_back(shares),
            needed=needed,
            tried=cured.reached if cured else None,
            time=cured.time if cured else None,
        )

    def _reach(self, found: OutOfReach) -> RunExplanation:
        said = words.reach(found)
        way = found.gap / max(found.distance, 1e-300)
        return replace(
            self._base,
            kind="reach",
            sentence=said,
            held_back=_held_back(found.shares),
            tasks=(found.part.task.name,),
            distance=found.distance,
            way=tuple(way.tolist()) if found.in_world else (),
        )

    def _late(self, found: NotBlocked) -> RunExplanation:
        torques = controller_of(self._scenario, self._name).commands_torques
        answer = late.explain(
            self._scenario,
            self._name,
            self._leg,
            self._goal,
            self._room,
            torques=torques,
            place=found.place,
        )
        return replace(
            self._base,
            kind=answer.kind,
            sentence=f"{words.stops(self._leg)}; {answer.sentence}",
            held_back=_held_back(answer.shares),
            tried=answer.tried,
            time=answer.time,
        )

    def _velocity(self) -> RunExplanation:
        answer = velocity.explain(self._scenario, self._name, self._leg, self._room)
        if answer.kind == "limits":
            said = f"{words.stops(self._leg)}; {answer.sentence}"
            return self._with(answer.cure, answer.shares, said)
        return replace(
            self._base,
            kind=answer.kind,
            sentence=f"{words.stops(self._leg)}; {answer.sentence}",
            held_back=_held_back(answer.shares),
            tasks=answer.tasks,
            way=answer.way,
        )


def _held_back(shares: tuple[Share, ...]) -> tuple[HeldBack, ...]:
    return tuple(HeldBack(limit=s.row.name, words=s.row.words, share=s.share) for s in shares)
