"""An object that hands which press have lost: when, by whom and by what, and what would hold it.

A recorded run does not tell forces, so it is made again. The hands are named whose contacts were
the first at the end of what they bear, without a break until something had slipped by SLIPPED:
at the pad's edge, or else with all the friction that there is needed.

What would hold it is tried: more friction, or more of what the controller presses with.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from coopqp.assessment import assess
from coopqp.assessment.thresholds import SLIPPED
from coopqp.base.errors import CoopqpError
from coopqp.closed_loop.hands import hands
from coopqp.controller import Controller
from coopqp.execution.controller_run import run
from coopqp.metrics.friction_margin import FrictionMargin
from coopqp.study.explanation import words
from coopqp.study.explanation.answer import RunExplanation
from coopqp.study.explanation.explained_phase import ExplainedPhase
from coopqp.trace import Trace

#: From this share on what a contact bears is used up.
TIPS = 0.98
#: So many times of what the controller presses with are tried.
TIMES = (1.5, 2.0, 3.0)
#: What a controller presses with, by the name of its setting: the first that it has.
SETTINGS = ("squeeze", "safety")
#: Friction is told with this much to spare.
SPARE = 1.05


def lost(leg: ExplainedPhase, base: RunExplanation) -> RunExplanation | None:
    """How the object was lost until the end of a leg; None where it was held."""
    presses = any(grasp.contact for grasp in leg.problem.chain.grasps.values())
    if not presses or not leg.scenario.plant.takes_torques:
        return None
    trace = run(leg.scenario, controller=leg.name)
    tick = assess(trace).lost_tick
    if tick is None or tick >= leg.first + len(leg.v):
        return None
    time, why = float(trace.t[tick + 1]), _culprits(leg, trace, tick)
    said = f"the object is lost at {time:.3g} s{': ' if why else ''}{why}"
    holds = " or ".join(f"with {text}" for text in (_friction(leg), _pressing(leg)) if text)
    if holds:
        said += f"; {holds} it is held (tried)"
    return base.because("lost", said, tried=True if holds else None, time=time)


def _culprits(leg: ExplainedPhase, trace: Trace, tick: int) -> str:
    """Which hands, and by what, when what contacts bear was first used up."""
    slipped = np.flatnonzero((trace.signals["slip"][: tick + 1] > SLIPPED).any(axis=1))
    k = int(slipped[0]) if len(slipped) else tick
    found = _used_up(leg, trace, k)
    while k > 0 and (before := _used_up(leg, trace, k - 1)):
        k, found = k - 1, before
    by_why: dict[str, list[str]] = {}
    for arm, why in found:
        by_why.setdefault(why, []).append(arm)
    return words.listed([f"{why} at {words.listed(arms)}" for why, arms in by_why.items()])


def _used_up(leg: ExplainedPhase, trace: Trace, k: int) -> list[tuple[str, str]]:
    """The hands in which a contact is at the end of what it bears in a tick, and what ends it."""
    robot, found = [arm.name for arm in leg.scenario.robot_model.arms], []
    friction, edge = (trace.signals[name][k] for name in ("friction_use", "edge_use"))
    for hand in hands(leg.problem.chain):
        if hand.contact is None:
            continue
        i = robot.index(hand.arm)
        if edge[i] >= TIPS:
            found.append((hand.arm, "the pressure reaches the pad's edge"))
        elif not friction[i] < TIPS:  # NaN: nothing presses there
            modelled, factor = hand.contact.friction, leg.scenario.disturbance.friction
            there = f"friction of {modelled:g}"
            if factor != 1.0:
                told = f"where the controller is told {modelled:g}"
                there = f"friction of {modelled * factor:.2g}, {told},"
            found.append((hand.arm, f"{there} does not do"))
    return found


def _friction(leg: ExplainedPhase) -> str:
    """The friction that would do, where the controller was told of more than there is."""
    there = leg.scenario.disturbance.friction
    if there >= 1.0:
        return ""
    known = _with_friction(leg, 1.0)
    margin = FrictionMargin().measure(known) if known else None
    needed = 1.0 if margin is None else round(SPARE * (1.0 - margin), 2)
    if not there < needed < 1.0 or _with_friction(leg, needed) is None:
        return ""
    return f"{needed:g} of the modelled friction instead of {there:g}"


def _with_friction(leg: ExplainedPhase, friction: float) -> Trace | None:
    return _again(leg, disturbance=replace(leg.scenario.disturbance, friction=friction))


def _pressing(leg: ExplainedPhase) -> str:
    """The setting of the controller that would do."""
    for other, setting in _firmer(leg.controller):
        if _again(leg, controllers={**leg.scenario.controllers, leg.name: other}) is not None:
            return f"{leg.name}: {{{setting}}}"
    return ""


def _firmer(chosen: Controller) -> Iterator[tuple[Controller, str]]:
    """The controller with more of what it presses with."""
    key = next((key for key in SETTINGS if getattr(chosen, key, None)), None)
    for times in TIMES if key else ():
        more = times * getattr(chosen, str(key))
        try:
            yield replace(chosen, **{str(key): more}), f"{key}: {more:g}"
        except (CoopqpError, ValueError):
            return


def _again(leg: ExplainedPhase, **changed: Any) -> Trace | None:
    """The run with something changed; None where the object is lost in it all the same."""
    try:
        trace = run(replace(leg.scenario, **changed), controller=leg.name)
    except CoopqpError:
        return None
    return trace if assess(trace).lost_tick is None else None
