"""A goal that geometry allows and the run missed: too slow, no loop budget, too short, at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from coopqp.assessment.thresholds import AT_EFFORT, HELD_UP, rests
from coopqp.base.spec import Array, type_name
from coopqp.closed_loop.screw import LENGTH
from coopqp.model.closed_chain import AXES
from coopqp.plant import Disturbance
from coopqp.solver import Status
from coopqp.study.explanation import words
from coopqp.study.explanation.asked import held_up, speed_share
from coopqp.study.explanation.diagnosis import OutOfReach
from coopqp.study.explanation.explained_phase import ExplainedPhase, arrival, rerun
from coopqp.study.explanation.goal import Goal, Place
from coopqp.study.explanation.room import Room, Share
from coopqp.study.explanation.words import RunExplanation

#: The loop budget is what slows where more than MANY of the LAST ticks were cut for it.
LAST, MANY = 20, 5
#: Speeds are the cause from this share of the force on.
MOSTLY = 0.5
#: An error that fell by less than this share in the longer run does not fall any more.
FALLS = 0.1
#: A spring that bears less than this share of the strongest is not told of.
WORTH_TELLING = 0.02


def explain(leg: ExplainedPhase, goal: Goal, place: Place, base: RunExplanation) -> RunExplanation:
    """Why, with a rerun that shows it, although there is a place at the goal inside the limits."""
    goal.look(leg.q[-1])
    if goal.miss <= 1.0:
        said = "by its model it has arrived; the rest is what the model gets wrong"
        return base.because("model", said)
    if leg.causes[-1][0] is Status.INFEASIBLE:
        said = f"{leg.stands_still}: not all could hold in them; --tick says what"
        return base.because("failed", said)
    if _out_of_budget(leg):
        return _budget(leg, base)
    torques = leg.controller.commands_torques
    if torques and (motors := _motors(leg)):
        return base.because("motors", motors)
    if given_way := _pushed(leg, goal):
        return base.because("springs", given_way)
    held = () if torques else tuple(_told(share, leg.room, leg.q[-1]) for share in held_up(leg))
    slow = speed_share(held) > MOSTLY
    if not slow and (waits := _leash(leg)):
        return base.because("speed", waits, tried=True)
    after = rerun(leg, longer=True)
    if after.missed and not _falls(leg, after):
        if misled := _misled(leg):
            return base.because("model", misled, tried=True)
        return base.because("rest", _rests(leg, place, held), held, tried=False)
    return _too_short(leg, goal, after, held, base, slow=slow)


def _too_short(
    leg: ExplainedPhase,
    goal: Goal,
    after: ExplainedPhase,
    held: Sequence[Share],
    base: RunExplanation,
    *,
    slow: bool,
) -> RunExplanation:
    why = words.slow(held) if slow else "nothing is in the way; the run ends too early"
    task = leg.missed[0][0].task
    gain = "" if slow or task.impedance else f" (gain {task.gain:g} 1/s)"
    time = None if after.missed else arrival(goal, after)
    then = (
        f"{time:.3g} s instead of {leg.t_end:.3g} s would do (tried: reached)"
        if time is not None
        else f"after {after.t_end:.3g} s {words.stops(after)}"
    )
    kind = "speed" if slow else "short"
    return base.because(kind, f"{why}{gain}; {then}", held, tried=time is not None, time=time)


def behind(leg: ExplainedPhase, found: OutOfReach) -> str:
    """What lack of time adds to a goal out of reach, where a rerun comes to rest nearer to it."""
    part, unit = found.part, found.part.part.unit
    error = _error_of(leg, part.name)
    if error - found.distance - found.cost <= max(part.part.tolerance, FALLS * error):
        return ""
    after = rerun(leg, longer=True)
    then = _error_of(after, part.name)
    if error - then <= part.part.tolerance or not rests(after.v[-1]):
        return ""
    moves = "" if rests(leg.v[-1]) else ", still moving"
    lacks = f"{words.ends_off(part, error)}{moves}, {words.size(error - then, unit)} of it"
    later = f"after {after.t_end:.3g} s {words.size(then, unit)} are left (tried)"
    return f"; {lacks} for lack of time: {later}"


def _error_of(leg: ExplainedPhase, name: str) -> float:
    """What a part of a task ends off by."""
    return next(e for p, e in zip(leg.parts, leg.errors, strict=True) if p.name == name)


def _rests(leg: ExplainedPhase, place: Place, held: Sequence[Share]) -> str:
    if not leg.problem.limits:
        return "it rests there, although the goal is in reach"
    ends = "it rests" if rests(leg.v[-1]) else "it keeps moving"  # as where a reference goes on
    why = f"{words.holding(held)}, and {ends}" if held else ends
    at = words.start(place.q, leg.problem.chain)
    return f"{why} although this is inside the limits: {at}"


def _told(share: Share, room: Room, q: Array) -> Share:
    """With the nearest pair of bodies and its distance, where these hold it up."""
    pair = room.nearest(share.row.owner, q)
    if pair is None:
        return share
    row, distance = pair
    return replace(share, row=replace(row, label=f"{row.words} ({1e3 * distance:.1f} mm)"))


def _leash(leg: ExplainedPhase) -> str:
    """Which limits made commands wait for the measured joints; empty where none did."""
    limits = leg.scenario.limits
    leash = [limit for limit in limits if limit.uses_measurements]
    free = tuple(limit for limit in limits if limit not in leash)
    if not leash or rerun(leg, limits=free).missed:
        return ""
    names = words.listed([type_name(type(limit)) for limit in leash])
    said = f"{names} keeps the commands near the measured joints"
    return f"{said}; without it the goal is reached (tried)"


def _misled(leg: ExplainedPhase) -> str:
    """Whether the disturbance keeps it from the goal, in words; empty where it does not."""
    perfect = Disturbance()
    if leg.scenario.disturbance == perfect or rerun(leg, disturbance=perfect).missed:
        return ""
    said = "this is what the model gets wrong: without the disturbance the goal is reached (tried)"
    return f"{said}; 'coopqp calibrate' may find out what"


def _out_of_budget(leg: ExplainedPhase) -> bool:
    cut = {Status.STEP_SHORTENED, Status.LOOP_BUDGET}
    return sum(bool(cut & set(causes)) for causes in leg.causes[-LAST:]) > MANY


def _budget(leg: ExplainedPhase, base: RunExplanation) -> RunExplanation:
    kappa, most = leg.problem.kappa, 1.0 / leg.problem.dt
    text = f"the loops' budget is used up (kappa {kappa:g})"
    if kappa >= most * (1.0 - 1e-9):
        return base.because("budget", f"{text}, although kappa is as large as it can be")
    after = rerun(leg, kappa=most)
    said = f"{text}; kappa: {most:g} would do (tried: reached)"
    if after.missed:
        said = f"{text}; with kappa: {most:g} {words.stops(after)}"
    return base.because("budget", said, tried=not after.missed)


def _motors(leg: ExplainedPhase) -> str:
    """Motors at their limits; empty where none was."""
    effort = leg.problem.chain.model.effortLimit
    tau = leg.tau[-LAST:]
    if not tau.size:
        return ""
    often = (np.abs(tau) >= AT_EFFORT * effort).mean(axis=0)
    often[~np.isfinite(effort) | (effort <= 0.0)] = 0.0
    names = [leg.problem.chain.joint_names[i] for i in np.flatnonzero(often > HELD_UP)]
    if not names:
        return ""
    verb = "is at its torque limit" if len(names) == 1 else "are at their torque limits"
    return f"{words.listed(names)} {verb}"


def _falls(before: ExplainedPhase, after: ExplainedPhase) -> bool:
    """Whether more time brought it nearer."""
    part, error = before.missed[0]
    return bool(_error_of(after, part.name) < (1.0 - FALLS) * error)


def _pushed(leg: ExplainedPhase, goal: Goal) -> str:
    """What else than the scenario's push holds an impedance away; empty where it still moves."""
    task = leg.missed[0][0].task
    springs = task.impedance
    if springs is None or not rests(leg.v[-1]):
        return ""
    forces = springs.stiffness * goal.stack.e[goal.stack.slices[goal.tasks.index(task)]]
    said = _by_axis(tuple(AXES[axis] for axis in springs.axes), forces)
    return (
        f"it gives way as asked: its springs bear {said} there, and move by F/K; that is a push, a "
        "weight that is wrong, or another task that pulls"
    )


def _by_axis(axes: tuple[str, ...], forces: Array) -> str:
    """Forces and torques, without negligible ones."""
    turns = np.array([axis.startswith("rot") for axis in axes])
    sizes = np.abs(forces) / np.where(turns, LENGTH, 1.0)
    told = []
    for i in np.flatnonzero(sizes > WORTH_TELLING * sizes.max()):
        unit, way = ("N m", "about") if turns[i] else ("N", "along")
        told.append(f"{forces[i]:.3g} {unit} {way} {axes[i].removeprefix('rot_')}")
    return words.listed(told)
