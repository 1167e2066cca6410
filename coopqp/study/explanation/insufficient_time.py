"""What geometry allows and the run missed: too slow, no loop budget, too short, at rest.

A velocity has no goal to search for. At the last tick

    contradiction   all tasks' rows together have no solution within the loops, each alone has one
    reach           the speed that is needed is far beyond the joints', or the loops leave none
    limits, speed   by the multipliers of the ticks, as in :mod:`coopqp.study.explanation.tick`
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from coopqp.assessment.thresholds import HELD_UP, at_effort, rests
from coopqp.base.spec import Array, type_name
from coopqp.closed_loop.screw import LENGTH
from coopqp.model.closed_chain import AXES
from coopqp.plant import Disturbance
from coopqp.solver import Status
from coopqp.study.explanation import explained_phase, tick, words
from coopqp.study.explanation.diagnosis import TooFar
from coopqp.study.explanation.explained_phase import ExplainedPhase, arrival, rerun
from coopqp.study.explanation.goal import (
    Goal,
    PartOfTask,
    Place,
    PositionLimits,
    Share,
    least_relaxation,
)
from coopqp.study.explanation.tick import PhaseTicks, held_up, relaxed, speed_share
from coopqp.study.explanation.words import RunExplanation
from coopqp.task import Task, level_of

#: The loop budget is what slows where more than MANY of the LAST ticks were cut for it.
LAST, MANY = 20, 5
#: Speeds are the cause from this share of the force on.
MOSTLY = 0.5
#: An error that fell by less than this share in the longer run does not fall any more.
FALLS = 0.1
#: How many times as long a profile is tried.
SLOWER = 4.0
#: A spring that bears less than this share of the strongest is not told of.
WORTH_TELLING = 0.02


def explain(
    phase: ExplainedPhase, goal: Goal, place: Place, base: RunExplanation
) -> RunExplanation:
    """Why, with a rerun that shows it, although there is a place at the goal inside the limits."""
    goal.look(phase.q[-1])
    if goal.miss <= 1.0:
        sentence = "by the model it has arrived; the remaining error is the model's"
        return base.because("model", sentence)
    if standing := stands(phase, blocked=False):
        return base.because("failed", standing)
    cut = {Status.STEP_SHORTENED, Status.LOOP_BUDGET}
    if sum(bool(cut & set(causes)) for causes in phase.causes[-LAST:]) > MANY:
        return _budget(phase, base)
    torques = phase.controller.commands_torques
    if torques and (motors := _motors(phase)):
        return base.because("motors", motors)
    if given_way := _gives_way(phase, goal, base):
        return given_way
    limits = () if torques else held_up(phase)
    held = tuple(_with_nearest_pair(share, phase.bounds, phase.q[-1]) for share in limits)
    slow = speed_share(held) > MOSTLY
    if not slow and (waits := _waits_for_measured(phase)):
        return base.because("speed", waits, tried=True)
    after, (part, error) = rerun(phase, longer=True), phase.missed[0]
    falls = after.errors[part.name] < (1.0 - FALLS) * error
    if after.missed and not falls:
        if misled := _misled_by_model(phase):
            return base.because("model", misled, tried=True)
        at = tuple(place.q.tolist())
        return base.because("rest", _rests(phase, place, held), held, tried=False, elsewhere=at)
    return _too_short(phase, goal, after, held, base, slow=slow)


def stands(phase: ExplainedPhase, *, blocked: bool) -> str:
    """Of a phase that ends at rest as not all can hold: why, and what would do; else empty."""
    if phase.causes[-1][0] is not Status.INFEASIBLE:
        return ""
    policy = phase.problem.on_infeasible
    if policy == "scale" or "on_infeasible" not in phase.controller.supports:
        return f"{phase.stands_still}: not all could hold in them; --tick says what"
    after = rerun(phase, longer=True, on_infeasible="scale")
    lacking = [task.task for task in relaxed([after])]
    who = words.listed([f"'{name}'" for name in lacking]) or "loops and limits"
    text = f"{phase.stands_still}, as on_infeasible is {policy} and {who} cannot be met in full"
    ways = [("on_infeasible: scale", after), *(() if blocked else _calmer(phase, lacking))]
    times = [(way, arrival(done.goal(), done)) for way, done in ways if not done.missed]
    if times:
        would = " or ".join(f"{way} (in {time:g} s)" for way, time in times)
        return f"{text}; with {would} the goal is reached (tried)"
    return f"{text}; with on_infeasible: scale {words.stops_short(*after.missed[0])} (tried)"


def _calmer(phase: ExplainedPhase, names: Sequence[str]) -> Iterator[tuple[str, ExplainedPhase]]:
    """Reruns in which some hard tasks ask for less speed, and how."""
    tasks = phase.scenario.schedule[phase.index].tasks
    strict = replace(phase, level=max(phase.missed[0][0].task.level, level_of("scaled", 0)))
    for way, slower in ("mode: scaled", False), (f"profile.duration times {SLOWER:g}", True):
        changed = [_calm(task, slower=slower) if task.name in names else task for task in tasks]
        yield way, rerun(strict, longer=True, tasks=changed)


def _calm(task: Task, *, slower: bool) -> Task:
    changed: dict[str, Any] = {"mode": "scaled"}
    if slower:
        way = task.way
        changed = {"profile": replace(way, duration=SLOWER * way.duration)} if way else {}
    return replace(task, **changed)


def _too_short(
    phase: ExplainedPhase,
    goal: Goal,
    after: ExplainedPhase,
    held: Sequence[Share],
    base: RunExplanation,
    *,
    slow: bool,
) -> RunExplanation:
    why = words.slow(held) if slow else "no limit is active; the run is too short"
    task = phase.missed[0][0].task
    gain = "" if slow or task.impedance else f" (gain {task.gain:g} 1/s)"
    time = None if after.missed else arrival(goal, after)
    then = (
        f"a duration of {time:g} s instead of {phase.t_end:g} s is enough (tried: reached)"
        if time is not None
        else f"after {after.t_end:.3g} s {words.stops_short(*after.missed[0])}"
    )
    kind = "speed" if slow else "short"
    return base.because(kind, f"{why}{gain}; {then}", held, tried=time is not None, time=time)


def behind(phase: ExplainedPhase, too_far: TooFar) -> str:
    """What lack of time adds to an unreachable goal, where a rerun comes to rest nearer to it."""
    part, unit = too_far.part, too_far.part.part.unit
    error = phase.errors[part.name]
    if error - too_far.distance - too_far.cost <= max(part.part.tolerance, FALLS * error):
        return ""
    after = rerun(phase, longer=True)
    then = after.errors[part.name]
    if error - then <= part.part.tolerance or not rests(after.v[-1]):
        return ""
    moves = "" if rests(phase.v[-1]) else ", still moving"
    ends = f"{part.name} ends {words.size(error, unit)} off{moves}"
    later = f"after {after.t_end:.3g} s {words.size(then, unit)} are left (tried)"
    return f"; {ends}, {words.size(error - then, unit)} of it for lack of time: {later}"


def _rests(phase: ExplainedPhase, place: Place, held: Sequence[Share]) -> str:
    if not phase.problem.limits:
        return "it rests there, although the goal is reachable"
    ends = "it rests" if rests(phase.v[-1]) else "it keeps moving"  # as where a reference goes on
    why = f"{words.holding(held)}, and {ends}" if held else ends
    at = words.start(place.q, phase.problem.chain)
    return f"{why} although this is inside the limits: {at}"


def _with_nearest_pair(share: Share, bounds: PositionLimits, q: Array) -> Share:
    """With the nearest pair of bodies and its distance, where these hold it up."""
    pairs = zip(bounds.at(q).tolist(), bounds.rows, strict=True)
    own = [(left, row) for left, row in pairs if row.owner == share.row.owner and row.bodies]
    if not own:
        return share
    left, row = min(own, key=lambda pair: pair[0])
    label = f"{row.label} ({1e3 * (left + row.kept):.1f} mm)"
    return replace(share, row=replace(row, label=label))


def _waits_for_measured(phase: ExplainedPhase) -> str:
    """Which limits made commands wait for the measured joints; empty where none did."""
    limits = phase.scenario.limits
    leash = [limit for limit in limits if limit.uses_measurements]
    free = tuple(limit for limit in limits if limit not in leash)
    if not leash or rerun(phase, limits=free).missed:
        return ""
    names = words.listed([type_name(type(limit)) for limit in leash])
    sentence = f"{names} keeps the commands near the measured joints"
    return f"{sentence}; without it the goal is reached (tried)"


def _misled_by_model(phase: ExplainedPhase) -> str:
    """Whether the disturbance keeps it from the goal, in words; empty where it does not."""
    known, held = phase.scenario.disturbance, phase.scenario.held
    reached = "the goal is reached (tried)"

    def reaches(**changed: Any) -> bool:
        return not rerun(phase, **changed).missed

    if known == Disturbance() or not reaches(disturbance=Disturbance()):
        return ""
    if known.faults:
        named = words.listed([fault.description for fault in known.faults])
        return f"it has faults ({named}): without the disturbance {reached}"
    mass, right = known.object_mass * held.mass, replace(known, object_mass=1.0)
    if right != known and reaches(disturbance=right, held=replace(held, mass=mass)):
        way = "heavier" if mass > held.mass else "lighter"
        return f"the object is {way} than modelled: with object.mass {mass:.3g} {reached}"
    if known.push and reaches(disturbance=replace(known, push=None)):
        return f"a push holds it away: without it {reached}"
    why = f"the model's errors are the cause: without the disturbance {reached}"
    return f"{why}; 'coopqp calibrate' may identify them"


def _budget(phase: ExplainedPhase, base: RunExplanation) -> RunExplanation:
    kappa, highest = phase.problem.kappa, 1.0 / phase.problem.dt
    text = f"the loops' budget is used up (kappa {kappa:g})"
    if kappa >= highest * (1.0 - 1e-9):
        return base.because("budget", f"{text}, although kappa is as large as it can be")
    after = rerun(phase, kappa=highest)
    sentence = f"{text}; kappa: {highest:g} is enough (tried: reached)"
    if after.missed:
        sentence = f"{text}; with kappa: {highest:g} {words.stops_short(*after.missed[0])}"
    return base.because("budget", sentence, tried=not after.missed)


def _motors(phase: ExplainedPhase) -> str:
    """Motors at their limits; empty where none was."""
    effort, tau = phase.problem.chain.model.effortLimit, phase.tau[-LAST:]
    if not tau.size:
        return ""
    often = at_effort(tau, effort).mean(axis=0)
    names = [phase.problem.chain.joint_names[i] for i in np.flatnonzero(often > HELD_UP)]
    if not names:
        return ""
    verb = "is at its torque limit" if len(names) == 1 else "are at their torque limits"
    return f"{words.listed(names)} {verb}"


def _gives_way(phase: ExplainedPhase, goal: Goal, base: RunExplanation) -> RunExplanation | None:
    """What an impedance bears where it rests away from its goal, and what of it is a mistake."""
    task = phase.missed[0][0].task
    springs = task.impedance
    if springs is None or not rests(phase.v[-1]):
        return None
    forces = springs.stiffness * goal.stack.e[goal.stack.slices[goal.tasks.index(task)]]
    axes = [AXES[axis] for axis in springs.axes]
    turns = np.array([axis.startswith("rot") for axis in axes])
    sizes, loads = np.abs(forces) / np.where(turns, LENGTH, 1.0), []
    for i in np.flatnonzero(sizes > WORTH_TELLING * sizes.max()):
        unit, way = ("N m", "about") if turns[i] else ("N", "along")
        loads.append(f"{forces[i]:.3g} {unit} {way} {axes[i].removeprefix('rot_')}")
    bear = words.listed(loads)
    why = f"it yields as specified: its springs carry {bear} there, and deflect by F/K"
    if misled := _misled_by_model(phase):
        return base.because("model", f"{why}; {misled}", tried=True)
    others = "that is a push, a wrong mass, or another task that pulls"
    return base.because("springs", f"{why}; {others}")


#: Singular where so many times the joints' speed is needed.
BEYOND = 20.0
#: Rows have a solution where the least-squares residual is a smaller share of what is wanted.
SOLVED = 1e-3
#: Singular values below this share of the largest are no motion.
CUT = 1e-4
#: Last ticks of a velocity that are evaluated.
EVALUATED = 50


def explain_velocity(phase: ExplainedPhase, base: RunExplanation) -> RunExplanation:
    """Why a velocity was missed, at the last tick."""
    if names := contradicting(phase):
        sentence = f"{words.listed(names)} cannot hold together: they ask for different motions"
        return base.because("contradiction", sentence, tasks=names)
    part = next(part for part, _ in phase.missed if part.task.asks_velocity)
    look, k = PhaseTicks(phase), len(phase.v) - 1
    u = look.look(k)[part.rows]
    needed = _speed_needed(look, part.rows)
    axes = [row.name.rpartition(".")[2] for row in look.stack.rows[part.rows]]
    if needed > BEYOND:
        return _at_the_edge(part, axes, u, base)
    held = held_up(phase, range(max(0, k - EVALUATED), k + 1))
    if held and speed_share(held) <= MOSTLY:
        return explained_phase.with_suggestion(base, held, explained_phase.by_rerun(phase, None))
    why = words.slow(held) if held else "the controller does not follow it"
    more = f"; it needs {needed:.2g} times the available speed" if needed > 1.0 else ""
    return base.because("speed", why + more, held, tasks=(part.task.name,))


def _at_the_edge(
    part: PartOfTask, names: Sequence[str], u: Array, base: RunExplanation
) -> RunExplanation:
    """Explain that the loops leave no motion along u, the missed velocity of the named axes."""
    i = int(np.abs(u).argmax())
    along = f"{'+' if u[i] > 0 else '-'}{names[i]}"
    of = " of its own axes" if getattr(part.task, "axes", "world") == "object" else ""
    sentence = (
        f"the object is at the edge of its reach along {along}{of}: whatever the limits and "
        "speeds, the loops leave no motion there"
    )
    missed = dict(zip(names, u.tolist(), strict=True))
    way = np.array([missed.get(axis, 0.0) for axis in "xyz"])
    size = float(np.linalg.norm(way))
    unit = tuple((way / size).tolist()) if size else ()
    return base.because("reach", sentence, tasks=(part.task.name,), way=unit)


def _speed_needed(look: PhaseTicks, rows: slice) -> float:
    """Least share of the joints' speeds that follows some rows in the last look; inf for none."""
    J, loops, most = look.stack.J[rows], look.state.J_loop, look.state.chain.velocity
    shares = np.diag(1.0 / np.maximum(most, 1e-9))  # none of joints without a limit
    equal = np.vstack([loops, J]), np.concatenate([np.zeros(len(loops)), look.stack.wanted[rows]])
    both, none = np.vstack([shares, -shares]), np.zeros(2 * len(most))
    found = least_relaxation(equal, (both, none), none.astype(int), [1.0])
    return float(found[1][0]) if found else np.inf


def contradicting(phase: ExplainedPhase) -> tuple[str, ...]:
    """Tasks whose velocities at the last tick rule each other out; none where they do not."""
    look = PhaseTicks(phase)
    look.look(len(phase.v) - 1)
    stack, loops = look.stack, look.state.J_loop
    free = {task.name for task in stack.tasks if not task.joint_space}
    own = [i for i in look.counted if stack.rows[i].owner in free]
    wanted, owners = stack.wanted[own], [stack.rows[i].owner for i in own]
    allowed = np.full(len(own), SOLVED * np.linalg.norm(wanted))
    return tick.contradicting_rows(
        loops, np.zeros(len(loops)), stack.J[own], wanted, owners, allowed, CUT
    )
