"""Why a run did not reach its goal and what would do; the same of arms at one instant.

Where pressing hands have lost the object, the run is made again, because a recorded one has no
forces. The hands are named whose contacts were the first at their limit without a break until
something had slipped: at the pad's edge, or else at the friction limit. Tried are more friction,
and more of what the controller presses with.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from coopqp.assessment import Assessment, assess
from coopqp.assessment.thresholds import SLIPPED
from coopqp.assessment.verdict import listed_limits, loop_words, not_followed, saturation_words
from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.closed_loop.hands import hands
from coopqp.controller import ControlProblem
from coopqp.execution.controller_run import run
from coopqp.metrics.friction_margin import FrictionMargin
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status
from coopqp.study.explanation import diagnosis, explained_phase, insufficient_time, words
from coopqp.study.explanation.explained_phase import ExplainedPhase
from coopqp.study.explanation.goal import Goal, PositionLimits, Search, placed
from coopqp.study.explanation.tick import relaxed
from coopqp.study.explanation.words import MissedPart, RunExplanation, listed
from coopqp.task import Task
from coopqp.trace import Trace

Report = Callable[[float], None]
TIMED = 100  # ticks by which the rows that Python fills are timed


def explain_run(
    scenario: Scenario, trace: Trace, report: Report = lambda share: None
) -> RunExplanation:
    """Say why a run of one of a scenario's controllers did not reach its goals.

    ``report`` is called now and then with the share that is done.
    """
    held = scenario.held_by(trace.controller)
    result, phases = assess(trace), list(explained_phase.explained_phases(held, trace))
    phase = next((phase for phase in phases if phase.missed), phases[-1])
    explained = _explained(result, phases, phase, report)
    more = saturation_words(result, "it saturates ") if explained.kind != "motors" else ""
    return _sentence(explained, explained.sentence, more, _rows_in_python(phase))


def _sentence(base: RunExplanation, *clauses: str) -> RunExplanation:
    return replace(base, sentence="; ".join(filter(None, dict.fromkeys(clauses))))


def _rows_in_python(phase: ExplainedPhase) -> str:
    """Tasks and limits whose rows Python fills for the kernel, with what that takes of a tick."""
    law = phase.controller.unprepared(phase.problem)
    if not law.rows_in_python:
        return ""
    state, times = law.start(phase.q[0]), []
    for k in range(min(len(phase.v), TIMED)):
        state.q[:], state.t, state.inputs = phase.q[k], k * law.problem.dt, phase.followed(k)
        law.tick(state)
        times.append(law.rows_us)
    return (
        f"the rows of {listed(law.rows_in_python)} are computed in Python, "
        f"{np.median(times):.0f} us of a tick"
    )


def _explained(
    result: Assessment, phases: Sequence[ExplainedPhase], phase: ExplainedPhase, report: Report
) -> RunExplanation:
    every = *phase.missed, *phase.gave_way
    missed = tuple(MissedPart(task=p.name, error=e, unit=p.part.unit) for p, e in every)
    last, name = phase.first + len(phase.v) - 1, phase.scenario.schedule[phase.index].name
    base = RunExplanation(controller=phase.name, phase=name, tick=last, missed=missed)
    torn = any(task.torn for task in result.tasks)
    suspect = phase.missed or torn or result.held is False
    if suspect and (gone := _lost(phase, base)):
        return gone
    if unfollowed := not_followed(result):
        return base.because("input", f"no goal counts as reached: {unfollowed}")
    if torn and not phase.missed:
        why = f"no goal counts as reached: the loop opened by {loop_words(result)} on the way"
        return base.because("open", why)
    stops = replace(base, sentence=words.stops_short(*phase.missed[0])) if phase.missed else base
    if (phase.missed or not result.reached) and (failed := _failed(phase)):
        return stops.because("failed", failed)
    if strange := [words.stops_short(part, error) for part, error in every if np.isnan(error)]:
        return _sentence(replace(base, kind="failed"), stops.sentence, *strange)
    given_up = relaxed([phase] if phase.missed else phases)
    violated = words.opened(result, phases[0].problem.kappa), words.broken(result)
    if not phase.missed:
        return _kept(result, phases, violated, replace(base, relaxed=given_up))
    answer = _blocked(phase, replace(stops, relaxed=given_up), report)
    standing = "" if answer.kind == "failed" else insufficient_time.stands(phase, blocked=True)
    names = result.at_limits(result.tasks.index(result.missed[0]))
    ends = f"it ends with {listed_limits(names)} at the limit"
    said = all(name in answer.sentence for name in names)
    relaxed_tasks = (task.sentence for task in given_up)
    gave_way = _gave_way(phase, answer)
    clauses = (standing, *gave_way, *relaxed_tasks, "" if said else ends, *violated)
    return _sentence(answer, answer.sentence, *clauses)


def _gave_way(phase: ExplainedPhase, answer: RunExplanation) -> Iterator[str]:
    """Errors of tasks that come after the first that is missed, where that is not said yet."""
    goal, first = phase.goal(), phase.missed[0][0].name
    for part, error in phase.gave_way:
        if part.task.name in answer.tasks:
            continue
        alone = placed([part.task], goal.chain)
        free = alone and Search(goal.only(alone), phase.bounds).best(phase.q[-1]).reached
        far = words.size(error, part.part.unit)
        because = " because of that" if free else ""
        yield f"{part.name}, which comes after {first}, ends {far} off{because}"


def _kept(
    result: Assessment,
    phases: Sequence[ExplainedPhase],
    violated: Sequence[str],
    base: RunExplanation,
) -> RunExplanation:
    """Of a run that reached its goals, but perhaps not as it should."""
    kind, goals = "reached", "every goal is reached"
    if not result.succeeds:
        kind, goals = "broken" if result.loop_closed else "open", "the goals are reached"
    clauses = [*filter(None, violated), *(task.sentence for task in base.relaxed)]
    count = sum(Status.TASKS_RELAXED in causes for phase in phases for causes in phase.causes)
    if base.relaxed:
        clauses.append("--tick says why")
    elif count:
        clauses.append(f"in {count} ticks hard tasks are not met in full")
    return base.because(kind, f"{goals}{', but ' if clauses else ''}{'; '.join(clauses)}")


def _failed(phase: ExplainedPhase) -> str:
    """Why the last tick stood still, where geometry is not the reason."""
    last = phase.causes[-1][0]
    if last.usable or last in (Status.INFEASIBLE, Status.LOOP_BUDGET):
        return "" if np.isfinite(phase.q[-1]).all() else "the joints are no finite numbers any more"
    return f"{phase.stands_still}: {last.value.removeprefix('stands still: ')}"


def _blocked(phase: ExplainedPhase, base: RunExplanation, report: Report) -> RunExplanation:
    first = phase.missed[0][0].task
    if phase.ordered and first.mode == "soft" and not first.weight:
        return base.because("weight", f"{first.name} has weight: 0, so nothing moves for it")
    goal = phase.goal()
    places = [part for part, _ in phase.missed if part.task in goal.tasks]
    velocities = [part for part, _ in phase.missed if part.task.asks_velocity]
    moves = any(task.asks_velocity for task in phase.counted)
    if (velocities and not places) or (moves and insufficient_time.contradicting(phase)):
        return insufficient_time.explain_velocity(phase, base)
    if not places and Status.SQUEEZE_GIVEN_UP in phase.causes[-1]:
        why = "the hands stand at admittance.most_way; raise it, unless the force sensor is dead"
        return base.because("way", why)
    if not places:
        return base.because("unplaced", "it asks for no place")
    cause = diagnosis.diagnose(goal, phase.bounds, phase.q[-1])
    report(0.4)
    if isinstance(cause, diagnosis.NotBlocked):
        if velocities:
            return insufficient_time.explain_velocity(phase, base)
        return insufficient_time.explain(phase, goal, cause.place, base)
    if isinstance(cause, diagnosis.BlockedByLimits):
        suggestion = explained_phase.by_geometry(phase, goal, cause, report)
        if (other := cause.elsewhere) is None:
            return explained_phase.with_suggestion(base, cause.shares, suggestion)
        base = replace(base, elsewhere=tuple(other.q.tolist()))
        elsewhere = words.elsewhere(other, goal.chain)
        return explained_phase.with_suggestion(base, cause.shares, suggestion, elsewhere)
    return _by_geometry(phase, cause, base)


def _by_geometry(
    phase: ExplainedPhase, cause: diagnosis.Unreachable, base: RunExplanation
) -> RunExplanation:
    sentence = words.geometry(cause, phase.missed, phase.problem.chain, ordered=phase.ordered)
    base = replace(base, sentence="", tasks=tuple(task.name for task in cause.tasks))
    if isinstance(cause, diagnosis.Elsewhere):
        at = tuple(cause.place.q.tolist())
        return base.because("elsewhere", sentence, cause.shares, elsewhere=at)
    if isinstance(cause, diagnosis.Contradiction):
        return base.because("contradiction", sentence, any_robot=cause.any_robot)
    if isinstance(cause, diagnosis.TooFewFreedoms):
        return base.because("freedom", sentence)
    sentence += insufficient_time.behind(phase, cause)
    way = tuple((cause.gap / max(cause.distance, 1e-300)).tolist()) if cause.in_world else ()
    return base.because("reach", sentence, cause.shares, distance=cause.distance, way=way)


#: Share of a contact's capacity from which it is at its limit.
TIPS = 0.98
#: Multiples of what the controller presses with that are tried.
TIMES = (1.5, 2.0, 3.0)
#: Settings of what a controller presses with; the first that it has counts.
SETTINGS = ("squeeze", "safety")
#: Margin on the friction that is suggested.
SPARE = 1.05


def _lost(phase: ExplainedPhase, base: RunExplanation) -> RunExplanation | None:
    """How the object was lost until the end of a phase; None where it was held."""
    presses = any(grasp.contact for grasp in phase.problem.chain.grasps.values())
    if not presses or not phase.scenario.plant.takes_torques:
        return None
    trace = run(phase.scenario, controller=phase.name)
    tick = assess(trace).lost_tick
    if tick is None or tick >= phase.first + len(phase.v):
        return None
    time, why = float(trace.t[tick + 1]), _culprits(phase, trace, tick)
    sentence = f"the object is lost at {time:.3g} s{': ' if why else ''}{why}"
    holds = " or ".join(f"with {text}" for text in (_friction(phase), _pressing(phase)) if text)
    if holds:
        sentence += f"; {holds} it is held (tried)"
    return base.because("lost", sentence, tried=True if holds else None, time=time)


def _culprits(phase: ExplainedPhase, trace: Trace, tick: int) -> str:
    """Which hands were at the limit of their contacts first, and by what."""
    slipped = np.flatnonzero((trace.signals["slip"][: tick + 1] > SLIPPED).any(axis=1))
    k = int(slipped[0]) if len(slipped) else tick
    by_reason = _used_up(phase, trace, k)
    while k > 0 and (before := _used_up(phase, trace, k - 1)):
        k, by_reason = k - 1, before
    return listed([f"{why} at {listed(arms)}" for why, arms in by_reason.items()])


def _used_up(phase: ExplainedPhase, trace: Trace, k: int) -> dict[str, list[str]]:
    """Arms whose contact is at its limit in a tick, by why."""
    robot, by_reason = [arm.name for arm in phase.scenario.robot_model.arms], dict[str, list[str]]()
    friction, edge = (trace.signals[name][k] for name in ("friction_use", "edge_use"))
    for hand in hands(phase.problem.chain):
        if hand.contact is None:
            continue
        i = robot.index(hand.arm)
        if edge[i] >= TIPS:
            by_reason.setdefault("the pressure reaches the pad's edge", []).append(hand.arm)
        elif not friction[i] < TIPS:  # NaN: nothing presses there
            modelled, factor = hand.contact.friction, phase.scenario.disturbance.friction
            there = f"the friction coefficient {modelled * factor:.2g}"
            if factor != 1.0:
                there += f" (modelled as {modelled:g})"
            by_reason.setdefault(f"{there} is too low", []).append(hand.arm)
    return by_reason


def _friction(phase: ExplainedPhase) -> str:
    """The friction that would do, where the controller expects more than there is."""
    there = phase.scenario.disturbance.friction
    if there >= 1.0:
        return ""

    def tried(friction: float) -> Trace | None:
        return _again(phase, disturbance=replace(phase.scenario.disturbance, friction=friction))

    known = tried(1.0)
    margin = FrictionMargin().measure(known) if known else None
    enough = 1.0 if margin is None else round(SPARE * (1.0 - margin), 2)
    if not there < enough < 1.0 or tried(enough) is None:
        return ""
    return f"{enough:g} of the modelled friction instead of {there:g}"


def _pressing(phase: ExplainedPhase) -> str:
    """How much firmer the controller would have to press."""
    known, chosen = phase.scenario.controllers, phase.controller
    key = next((key for key in SETTINGS if getattr(chosen, key, None)), "")
    for times in TIMES if key else ():
        more = times * getattr(chosen, key)
        try:
            firmer = {**known, phase.name: replace(chosen, **{key: more})}
        except (CoopqpError, ValueError):
            break
        if _again(phase, controllers=firmer) is not None:
            return f"{phase.name}: {{{key}: {more:g}}}"
    return ""


def _again(phase: ExplainedPhase, **changed: Any) -> Trace | None:
    """The run with something changed; None where the object is still lost."""
    try:
        trace = run(replace(phase.scenario, **changed), controller=phase.name)
    except CoopqpError:
        return None
    return trace if assess(trace).lost_tick is None else None


@dataclass(frozen=True)
class Standing:
    """How arms stand to their goals: at all of them, or kept by geometry from one, in words."""

    reached: bool
    blocked: bool
    sentence: str


def explain_standing(
    problem: ControlProblem, tasks: Sequence[Task], q: Array, *, rests: bool
) -> Standing:
    """Say what keeps arms from their goals, by geometry alone; relaxations are not tried.

    The problem has the limits that count, and each task its reference at its goal. Unless the arms
    rest at q, shape (n,) [rad, m], the explanation says how near they can get.
    """
    chain = problem.chain
    goal = Goal(chain, placed(tasks, chain), 0.0)
    missed = goal.missed(q)
    if not missed:
        return Standing(True, False, "at every goal" if goal.parts else "")
    short, bounds = words.stops_short(*missed[0]), PositionLimits(problem)
    cause = diagnosis.diagnose(goal, bounds, q)
    if isinstance(cause, diagnosis.NotBlocked):
        return Standing(False, False, f"{short}; it can be reached from here")
    if not isinstance(cause, diagnosis.BlockedByLimits):
        # At one instant nobody knows which law acts, and which task it puts first.
        sentence = words.geometry(cause, missed, chain, ordered=False)
        return Standing(False, True, sentence)
    if not rests and (nearest := goal.missed(cause.place.q)):
        part, error = nearest[0]
        short = f"{part.name} gets no nearer than {words.size(error, part.part.unit)}"
    parts = [short, words.holding(cause.shares)]
    if needs := explained_phase.minimal_relaxations(goal, bounds, cause):
        parts.append(f"to reach the goal, relax {explained_phase.needed(needs)} (not tried)")
    if cause.elsewhere:
        parts.append(words.elsewhere(cause.elsewhere, chain))
    return Standing(False, True, "; ".join(parts))
