"""A goal that geometry allows and the run missed: too slow, no loop budget, too short, at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from coopqp.assessment.thresholds import AT_EFFORT, HELD_UP, rests
from coopqp.checked import Array, type_name
from coopqp.disturbance import Disturbance
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status
from coopqp.study.explanation import words
from coopqp.study.explanation.goal import Goal
from coopqp.study.explanation.leg import Leg
from coopqp.study.explanation.motion import held_up, is_speed
from coopqp.study.explanation.rerun import Change, arrival, longer, rerun
from coopqp.study.explanation.room import Room
from coopqp.study.explanation.search import Place
from coopqp.study.explanation.shares import Share
from coopqp.study.explanation.springs import pushed

#: The loop budget is what slows where more than MANY of the LAST ticks were cut for it.
LAST, MANY = 20, 5
#: Speeds are the cause from this share of the force on.
MOSTLY = 0.5
#: An error that fell by less than this share in the longer run does not fall any more.
FALLS = 0.1


@dataclass(frozen=True)
class Late:
    """Why a run was late.

    Attributes:
        kind: speed, budget, short, rest, model, motors, springs or failed.
        sentence: in words.
        shares: of the limits that held it up.
        tried: whether a rerun reached the goal; None without one.
        time: that would do [s].
    """

    kind: str
    sentence: str
    shares: tuple[Share, ...] = ()
    tried: bool | None = None
    time: float | None = None


def explain(
    scenario: Scenario,
    controller: str,
    leg: Leg,
    goal: Goal,
    room: Room,
    *,
    torques: bool,
    place: Place,
) -> Late:
    """Why, with a rerun that shows it.

    Args:
        scenario: as the controller holds it.
        controller: its name.
        leg: that missed.
        goal: of its tasks.
        room: the limits.
        torques: whether the controller commands torques.
        place: a configuration at the goal, inside the limits.
    """
    goal.look(leg.q[-1])
    if goal.miss <= 1.0:
        return Late("model", "by its model it has arrived; the rest is what the model gets wrong")
    if leg.causes[-1][0] is Status.INFEASIBLE:
        count = sum(not causes[0].usable for causes in leg.causes)
        said = f"it stands still in {count} of {len(leg.causes)} ticks: not all could hold in them"
        return Late("failed", f"{said}; --tick says what")
    if _out_of_budget(leg):
        return _budget(scenario, controller, leg)
    if torques and (late := _motors(leg)):
        return late
    if given_way := pushed(scenario, leg, goal):
        return Late("springs", given_way)
    held = () if torques else tuple(_told(share, room, leg.q[-1]) for share in held_up(leg))
    slow = sum(share.share for share in held if is_speed(share.row)) > MOSTLY
    if not slow and (late := _leash(scenario, controller, leg)):
        return late
    after = rerun(scenario, controller, leg.phase, Change(longer=longer(leg)))
    reached = not after.missed
    time = arrival(goal, after) if reached else None
    if not reached and not _falls(leg, after):
        if late := _misled(scenario, controller, leg):
            return late
        return Late("rest", _rests(leg, place, held), held, tried=False)
    why = words.slow(held) if slow else "nothing is in the way; the run ends too early"
    task = leg.missed[0][0].task
    gain = "" if slow or task.impedance else f" (gain {task.gain:g} 1/s)"
    then = (
        f"{time:.3g} s instead of {leg.t_end:.3g} s would do (tried: reached)"
        if time is not None
        else f"after {after.t_end:.3g} s {words.stops(after)}"
    )
    return Late("speed" if slow else "short", f"{why}{gain}; {then}", held, reached, time)


def _rests(leg: Leg, place: Place, held: Sequence[Share]) -> str:
    """Of a run that more time does not help."""
    if not leg.problem.limits:
        return "it rests there, although the goal is in reach"
    ends = "it rests" if rests(leg.v[-1]) else "it keeps moving"  # as where a reference goes on
    why = f"{words.holding(held)}, and {ends}" if held else ends
    at = words.start(place.q, leg.problem.chain)
    return f"{why} although this is inside the limits: {at}"


def _told(share: Share, room: Room, q: Array) -> Share:
    """The same, where bodies hold it up with the nearest pair and its distance."""
    pair = room.nearest(share.row.owner, q)
    if pair is None:
        return share
    row, distance = pair
    return replace(share, row=replace(row, label=f"{row.words} ({1e3 * distance:.1f} mm)"))


def _leash(scenario: Scenario, controller: str, leg: Leg) -> Late | None:
    """Commands that had to wait for the measured joints."""
    leash = tuple(limit for limit in scenario.limits if limit.heeds_measured)
    if not leash or rerun(scenario, controller, leg.phase, Change(leave_out=leash)).missed:
        return None
    names = words.listed([type_name(type(limit)) for limit in leash])
    said = f"{names} keeps the commands near the measured joints"
    return Late("speed", f"{said}; without it the goal is reached (tried)", tried=True)


def _misled(scenario: Scenario, controller: str, leg: Leg) -> Late | None:
    """What the controller was not told keeps it from the goal."""
    if scenario.disturbance == Disturbance():
        return None
    if rerun(scenario, controller, leg.phase, Change(perfect=True)).missed:
        return None
    said = "this is what the model gets wrong: without the disturbance the goal is reached (tried)"
    return Late("model", f"{said}; 'coopqp calibrate' may find out what", tried=True)


def _out_of_budget(leg: Leg) -> bool:
    cut = {Status.STEP_SHORTENED, Status.LOOP_BUDGET}
    return sum(bool(cut & set(causes)) for causes in leg.causes[-LAST:]) > MANY


def _budget(scenario: Scenario, controller: str, leg: Leg) -> Late:
    kappa = leg.problem.kappa
    most = 1.0 / leg.problem.dt
    text = f"the loops' budget is used up (kappa {kappa:g})"
    if kappa >= most * (1.0 - 1e-9):
        return Late("budget", f"{text}, although kappa is as large as it can be")
    after = rerun(scenario, controller, leg.phase, Change(kappa=most))
    if not after.missed:
        return Late("budget", f"{text}; kappa: {most:g} would do (tried: reached)", tried=True)
    return Late("budget", f"{text}; with kappa: {most:g} {words.stops(after)}", tried=False)


def _motors(leg: Leg) -> Late | None:
    """Motors that were at their limits."""
    effort = leg.problem.chain.model.effortLimit
    tau = leg.tau[-LAST:]
    if not tau.size:
        return None
    often = (np.abs(tau) >= AT_EFFORT * effort).mean(axis=0)
    often[~np.isfinite(effort) | (effort <= 0.0)] = 0.0
    names = [leg.problem.chain.joint_names[i] for i in np.flatnonzero(often > HELD_UP)]
    if not names:
        return None
    verb = "is at its torque limit" if len(names) == 1 else "are at their torque limits"
    return Late("motors", f"{words.listed(names)} {verb}")


def _falls(before: Leg, after: Leg) -> bool:
    """Whether more time brought it nearer."""
    errors = dict(zip((p.name for p in after.parts), after.errors.tolist(), strict=True))
    part, error = before.missed[0]
    return bool(errors[part.name] < (1.0 - FALLS) * error)
