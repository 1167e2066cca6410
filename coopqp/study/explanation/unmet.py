"""Hard and scaled tasks that are not met in full: in a tick, and in a run.

A task that wants the rate w and gets u = J v gets the share 1 - |u - w| / max(|w|, |u - w|) of it,
that is s where u = s w.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from coopqp.base.spec import Array
from coopqp.solver import Status
from coopqp.study.explanation.asked import TickBatch
from coopqp.study.explanation.explained_phase import ExplainedPhase
from coopqp.task import Mode

#: A task that lacks more than this share of its rate counts, beside the one that lacks most.
WORTH_COUNTING = 0.02


@dataclass(frozen=True)
class Unmet:
    """A hard or scaled task that gets only a share of its rate in a tick."""

    task: str
    mode: Mode
    share: float

    @property
    def words(self) -> str:
        """What a sentence calls it."""
        return f"{self.mode} task '{self.task}'"


@dataclass(frozen=True, kw_only=True)
class Relaxed:
    """A hard or scaled task that is not met in full in so many ticks of a run.

    What is missing is the share of its rate that it lacks in the last tick.
    """

    task: str
    mode: Mode
    ticks: int
    missing: float

    @property
    def words(self) -> str:
        """A clause of a sentence."""
        ticks = f"{self.ticks} tick{'' if self.ticks == 1 else 's'}"
        end = f"lacks {percent(self.missing)} of its rate" if self.missing else "is met"
        return f"{self.mode} task '{self.task}' is not met in full in {ticks} and {end} at the end"


def part_of_rate(got: Array, wanted: Array) -> float:
    """The share of its rate that a task gets."""
    off, size = float(np.linalg.norm(got - wanted)), float(np.linalg.norm(wanted))
    return 1.0 - off / max(size, off, 1e-300)


def relaxed(legs: Sequence[ExplainedPhase]) -> tuple[Relaxed, ...]:
    """Who is not met in full in the ticks that say so, the most often first.

    Those of a law that commands torques do not show it.
    """
    modes: dict[str, Mode] = {}
    ticks, missing = Counter[str](), dict[str, float]()
    for leg in legs:
        if leg.controller.commands_torques:
            break
        missing = {}
        modes |= {task.name: task.mode for task in leg.problem.tasks}
        for k, lacks in _lacks(leg):
            ticks.update(lacks.keys())
            missing = lacks if k == len(leg.v) - 1 else {}
    return tuple(
        Relaxed(task=name, mode=modes[name], ticks=count, missing=missing.get(name, 0.0))
        for name, count in ticks.most_common()
    )


def _lacks(leg: ExplainedPhase) -> Iterator[tuple[int, dict[str, float]]]:
    """Relaxed ticks of a leg, with the share that each task lacks."""
    look = TickBatch(leg)
    every = zip(leg.problem.tasks, look.stack.slices, strict=True)
    firm = [(task.name, rows) for task, rows in every if task.mode != "soft"]
    for k in (k for k, causes in enumerate(leg.causes) if Status.TASKS_RELAXED in causes):
        off, wanted = look.look(k), look.stack.wanted
        got = wanted - off
        lacks = {name: 1.0 - part_of_rate(got[rows], wanted[rows]) for name, rows in firm}
        least = min(max(lacks.values(), default=0.0), WORTH_COUNTING)
        yield k, {name: x for name, x in lacks.items() if x >= least > 0.0}


def percent(share: float) -> str:
    """A share, in words."""
    if share < 0.01:
        return "less than 1 %"
    return "more than 99 %" if 0.99 < share < 1.0 else f"{100.0 * share:.0f} %"
