"""An object that hands which press have lost: when, by whom and by what, and what would hold it.

A recorded run does not tell forces, so it is made again. The hands are named whose contacts were
the first at the end of what they bear, without a break until something had slipped by SLIPPED:
at the pad's edge, or else with all the friction that there is needed.

What would hold it is tried: more friction, or more of what the controller presses with.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from coopqp.assessment import assess
from coopqp.assessment.thresholds import SLIPPED
from coopqp.closed_loop.hands import hands
from coopqp.controller import Controller
from coopqp.controller_run import controller_of, run
from coopqp.errors import CoopqpError
from coopqp.metrics.friction_margin import FrictionMargin
from coopqp.scenario.scenario import Scenario
from coopqp.study.explanation import words
from coopqp.study.explanation.leg import Leg
from coopqp.trace import Trace

#: From this share on what a contact bears is used up.
TIPS = 0.98
#: So many times of what the controller presses with are tried.
TIMES = (1.5, 2.0, 3.0)
#: What a controller presses with, by the name of its setting: the first that it has.
SETTINGS = ("squeeze", "safety")
#: Friction is told with this much to spare.
SPARE = 1.05


@dataclass(frozen=True)
class Lost:
    """How it was lost.

    Attributes:
        time: since the run began [s].
        sentence: in words.
        tried: whether something that was tried held it; None where nothing was.
    """

    time: float
    sentence: str
    tried: bool | None


def lost(scenario: Scenario, controller: str, leg: Leg) -> Lost | None:
    """How the object was lost until the end of a leg; None where it was held.

    Args:
        scenario: as the controller holds it.
        controller: its name.
        leg: that missed.
    """
    presses = any(grasp.contact for grasp in leg.problem.chain.grasps.values())
    if not presses or not scenario.plant.takes_torques:
        return None
    trace = run(scenario, controller=controller)
    tick = assess(trace).lost_tick
    if tick is None or tick >= leg.first + len(leg.v):
        return None
    time, why = float(trace.t[tick + 1]), _culprits(scenario, trace, leg, tick)
    said = f"the object is lost at {time:.3g} s{': ' if why else ''}{why}"
    would = _would_hold(scenario, controller)
    return Lost(time, f"{said}; {would}" if would else said, True if would else None)


def _culprits(scenario: Scenario, trace: Trace, leg: Leg, tick: int) -> str:
    """Which hands, and by what, when what contacts bear was first used up."""
    slipped = np.flatnonzero((trace.signals["slip"][: tick + 1] > SLIPPED).any(axis=1))
    k = int(slipped[0]) if len(slipped) else tick
    found = _used_up(scenario, trace, leg, k)
    while k > 0 and (before := _used_up(scenario, trace, leg, k - 1)):
        k, found = k - 1, before
    by_why: dict[str, list[str]] = {}
    for arm, why in found:
        by_why.setdefault(why, []).append(arm)
    return words.listed([f"{why} at {words.listed(arms)}" for why, arms in by_why.items()])


def _used_up(scenario: Scenario, trace: Trace, leg: Leg, k: int) -> list[tuple[str, str]]:
    """The hands in which a contact is at the end of what it bears in a tick, and what ends it."""
    robot, found = [arm.name for arm in scenario.robot_model.arms], []
    friction, edge = (trace.signals[name][k] for name in ("friction_use", "edge_use"))
    for hand in hands(leg.problem.chain):
        if hand.contact is None:
            continue
        i = robot.index(hand.arm)
        if edge[i] >= TIPS:
            found.append((hand.arm, "the pressure reaches the pad's edge"))
        elif not friction[i] < TIPS:  # NaN: nothing presses there
            found.append((hand.arm, _short(hand.contact.friction, scenario.disturbance.friction)))
    return found


def _short(friction: float, factor: float) -> str:
    """That friction does not do, and what the controller is told of it."""
    if factor == 1.0:
        return f"friction of {friction:g} does not do"
    told = f"where the controller is told {friction:g}"
    return f"friction of {friction * factor:.2g}, {told}, does not do"


def _would_hold(scenario: Scenario, controller: str) -> str:
    """What would hold it, of what was tried; empty where nothing did."""
    said = [_friction(scenario, controller), _pressing(scenario, controller)]
    would = " or ".join(f"with {text}" for text in said if text)
    return f"{would} it is held (tried)" if would else ""


def _friction(scenario: Scenario, controller: str) -> str:
    """The friction that would do, where the controller was told of more than there is."""
    there = scenario.disturbance.friction
    if there >= 1.0:
        return ""
    known = _again(scenario, controller, friction=1.0)
    margin = FrictionMargin().measure(known) if known else None
    needed = 1.0 if margin is None else round(SPARE * (1.0 - margin), 2)
    if not there < needed < 1.0 or _again(scenario, controller, friction=needed) is None:
        return ""
    return f"{needed:g} of the modelled friction instead of {there:g}"


def _pressing(scenario: Scenario, controller: str) -> str:
    """The setting of the controller that would do."""
    chosen = controller_of(scenario, controller)
    for other, words_for in _firmer(chosen):
        if _again(scenario, controller, instead=other) is not None:
            return f"{controller}: {{{words_for}}}"
    return ""


def _firmer(chosen: Controller) -> Iterator[tuple[Controller, str]]:
    """The controller with more of what it presses with."""
    for key in SETTINGS:
        now = getattr(chosen, key, None)
        if not now:
            continue
        for times in TIMES:
            try:
                yield replace(chosen, **{key: times * now}), f"{key}: {times * now:g}"
            except (CoopqpError, ValueError):
                return
        return


def _again(
    scenario: Scenario,
    controller: str,
    *,
    friction: float | None = None,
    instead: Controller | None = None,
) -> Trace | None:
    """The run with something changed; None where the object is lost in it all the same."""
    changed: dict[str, Any] = {}
    if friction is not None:
        changed["disturbance"] = replace(scenario.disturbance, friction=friction)
    if instead is not None:
        changed["controllers"] = {**scenario.controllers, controller: instead}
    try:
        trace = run(replace(scenario, **changed), controller=controller)
    except CoopqpError:
        return None
    return trace if assess(trace).lost_tick is None else None
