"""Counts by law and class of goal, with intervals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from coopqp.study.sweep.summary import Share, Success, success, wilson
from random_goals.trial import GoalRun, LawRun

AS_NEAR = 1.05  # an error up to so many times the best, plus the tolerance, counts as nearest


@dataclass(frozen=True)
class Line:
    """One law on the goals of one class.

    Attributes:
        robot: or "all".
        start: "near", "away" or "all".
        goal: "inside" or "beyond" the limits.
        law: its name.
        reached, inside, loop: as in :class:`LawRun`.
        whole: all three.
        nearest: inside with the loops closed, and no law that was so ended nearer.
        against: all three, or nearest for goals beyond, less that of the first law on the same
            goals.
    """

    robot: str
    start: str
    goal: str
    law: str
    reached: Share
    inside: Share
    loop: Share
    whole: Share
    nearest: Share
    against: Success


def summarize(goals: Sequence[GoalRun]) -> list[Line]:
    """By class, first over all robots, then for each."""
    robots = ["all", *dict.fromkeys(goal.robot for goal in goals)]
    return [
        line
        for robot in robots
        for kind in ("inside", "beyond")
        for start in ("away", "near", "all")
        for line in _lines(robot, start, kind, goals)
    ]


def _lines(robot: str, start: str, kind: str, goals: Sequence[GoalRun]) -> Iterable[Line]:
    chosen = [
        g
        for g in goals
        if g.goal == kind and robot in ("all", g.robot) and start in ("all", g.start)
    ]
    succeeds = (lambda run, g: run.reached and run.safe) if kind == "inside" else _nearest
    good = np.array([[succeeds(run, g) for run in g.runs] for g in chosen], bool)
    good = good.reshape(len(chosen), len(goals[0].runs))
    for i, law in enumerate(run.law for run in goals[0].runs):
        runs = [(g.runs[i], g) for g in chosen]
        yield Line(
            robot,
            start,
            kind,
            law,
            _share(run.reached for run, _ in runs),
            _share(run.inside for run, _ in runs),
            _share(run.loop for run, _ in runs),
            _share(run.reached and run.safe for run, _ in runs),
            _share(_nearest(run, g) for run, g in runs),
            success(good[:, i], good[:, 0]),
        )


def _share(true: Iterable[bool]) -> Share:
    found = list(true)
    return wilson(sum(found), len(found))


def _nearest(run: LawRun, goal: GoalRun) -> bool:
    """Whether no law that kept limits and loops ended nearer than this one, which did too."""
    best = min((r.error for r in goal.runs if r.safe), default=math.inf)
    return run.safe and run.error <= AS_NEAR * best + goal.tolerance
