"""An object that pressing hands have lost: when, where, why, and what would hold it.

A recorded run has no forces, so it is made again. The hands are named whose contacts were the first
at their limit without a break until something had slipped by SLIPPED: at the pad's edge, or else at
the friction limit. Tried are more friction, and more of what the controller presses with.
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
from coopqp.study.explanation.explained_phase import ExplainedPhase
from coopqp.study.explanation.words import RunExplanation
from coopqp.trace import Trace

#: Share of a contact's capacity from which it is at its limit.
TIPS = 0.98
#: Multiples of what the controller presses with that are tried.
TIMES = (1.5, 2.0, 3.0)
#: Settings of what a controller presses with; the first that it has counts.
SETTINGS = ("squeeze", "safety")
#: Margin on the friction that is suggested.
SPARE = 1.05


def lost(phase: ExplainedPhase, base: RunExplanation) -> RunExplanation | None:
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
    found = _used_up(phase, trace, k)
    while k > 0 and (before := _used_up(phase, trace, k - 1)):
        k, found = k - 1, before
    by_why: dict[str, list[str]] = {}
    for arm, why in found:
        by_why.setdefault(why, []).append(arm)
    return words.listed([f"{why} at {words.listed(arms)}" for why, arms in by_why.items()])


def _used_up(phase: ExplainedPhase, trace: Trace, k: int) -> list[tuple[str, str]]:
    """Hands with a contact at its limit in a tick, and why."""
    robot, found = [arm.name for arm in phase.scenario.robot_model.arms], []
    friction, edge = (trace.signals[name][k] for name in ("friction_use", "edge_use"))
    for hand in hands(phase.problem.chain):
        if hand.contact is None:
            continue
        i = robot.index(hand.arm)
        if edge[i] >= TIPS:
            found.append((hand.arm, "the pressure reaches the pad's edge"))
        elif not friction[i] < TIPS:  # NaN: nothing presses there
            modelled, factor = hand.contact.friction, phase.scenario.disturbance.friction
            there = f"friction of {modelled:g}"
            if factor != 1.0:
                believed = f"where the controller is told {modelled:g}"
                there = f"friction of {modelled * factor:.2g}, {believed},"
            found.append((hand.arm, f"{there} does not do"))
    return found


def _friction(phase: ExplainedPhase) -> str:
    """The friction that would do, where the controller expects more than there is."""
    there = phase.scenario.disturbance.friction
    if there >= 1.0:
        return ""

    def tried(friction: float) -> Trace | None:
        return _again(phase, disturbance=replace(phase.scenario.disturbance, friction=friction))

    known = tried(1.0)
    margin = FrictionMargin().measure(known) if known else None
    needed = 1.0 if margin is None else round(SPARE * (1.0 - margin), 2)
    if not there < needed < 1.0 or tried(needed) is None:
        return ""
    return f"{needed:g} of the modelled friction instead of {there:g}"


def _pressing(phase: ExplainedPhase) -> str:
    for other, setting in _firmer(phase.controller):
        if _again(phase, controllers={**phase.scenario.controllers, phase.name: other}) is not None:
            return f"{phase.name}: {{{setting}}}"
    return ""


def _firmer(chosen: Controller) -> Iterator[tuple[Controller, str]]:
    key = next((key for key in SETTINGS if getattr(chosen, key, None)), None)
    for times in TIMES if key else ():
        more = times * getattr(chosen, str(key))
        try:
            yield replace(chosen, **{str(key): more}), f"{key}: {more:g}"
        except (CoopqpError, ValueError):
            return


def _again(phase: ExplainedPhase, **changed: Any) -> Trace | None:
    """The run with something changed; None where the object is still lost."""
    try:
        trace = run(replace(phase.scenario, **changed), controller=phase.name)
    except CoopqpError:
        return None
    return trace if assess(trace).lost_tick is None else None
