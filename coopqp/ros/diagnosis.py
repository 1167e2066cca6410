"""What is said of a loop on /diagnostics: what became of its ticks, and which limits it is at."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from coopqp.base.qp import Row
from coopqp.online.loop import OnlineLoop
from coopqp.recordings.messages import AT, BROKEN, Remark, level_of
from coopqp.solver import Status, written

#: What a tick says where the robot has to come to rest, or its joints are not known.
HALTS = frozenset({
    Status.ROBOT_SILENT, Status.NOT_MEASURED, Status.MEASURED_JUMPED, Status.STOPPED,
    Status.NOT_BEGUN, Status.RAISED,
})  # fmt: skip


class Diagnosis:
    """Gathers what became of ticks until it is told.

    Args:
        loop: whose ticks.
    """

    def __init__(self, loop: OnlineLoop) -> None:
        self._loop = loop
        self._causes: dict[Status, None] = {}
        self._note = ""

    def tick(self) -> None:
        """Take the last tick down."""
        command = self._loop.command
        for cause in command.causes:
            self._causes[cause] = None
        self._note = command.note or self._note

    def remarks(self, why: str = "") -> list[Remark]:
        """What there is to be said since it was last asked.

        Args:
            why: the loop has ended, or could not begin; empty while it goes on.
        """
        found = [self._law(why), *(_limits(self._loop) if self._loop.begun else ())]
        self._causes, self._note = {}, ""
        return found

    def _law(self, why: str) -> Remark:
        """What became of the ticks; all that was said in one of them."""
        loop, causes = self._loop, list(self._causes)
        if len(causes) > 1:
            causes = [cause for cause in causes if cause is not Status.OPTIMAL]
        levels = [2 if cause in HALTS else level_of(cause) for cause in causes]
        stopped = why or loop.stopped
        said = [*(cause.value for cause in causes), self._note, stopped]
        said = [x for i, x in enumerate(said) if not any(x in other for other in said[i + 1 :])]
        watch = loop.watch
        values = {
            "status": written(causes) if causes else "",
            "law": loop.controller,
            "phase": loop.phase.name,
            "t [s]": f"{loop.state.t:.3f}",
            "ticks": str(loop.ticks),
            "late": str(watch.late),
            "longest [ms]": f"{1e3 * watch.longest:.2f}",
        }
        words = "; ".join(part for part in said if part) or "waits for the robot"
        return Remark("loop", 2 if stopped else max(levels, default=0), words, values)


def _limits(loop: OnlineLoop) -> Iterator[Remark]:
    """Each limit: at which of its rows the last command is, and what is left at the nearest."""
    kept, problem = loop.history.last(2), loop.problem
    q, v = np.vstack([kept.q, loop.setpoint]), kept.v
    for limit in problem.limits:
        left: dict[Row, float] = {}
        with suppress(Exception):  # a tick that met the same error names it
            margins = limit.margins(problem.chain, q, v, problem.dt)
            left = {row: float(margin[-1]) for row, margin in margins.items() if margin.size}
        for owner in dict.fromkeys(row.owner for row in left):
            yield _limit(owner, {row: m for row, m in left.items() if row.owner == owner})


def _limit(owner: str, left: dict[Row, float]) -> Remark:
    level = max(2 if m < BROKEN else int(m <= AT) for m in left.values())
    said = [f"{'beyond' if m < BROKEN else 'at'} {row.words}" for row, m in left.items() if m <= AT]
    nearest: dict[str, Row] = {}
    for row, m in left.items():
        if row.unit not in nearest or m < left[nearest[row.unit]]:
            nearest[row.unit] = row
    values = {f"left [{unit}]": f"{left[row]:.4g}" for unit, row in nearest.items()}
    values |= {f"nearest [{unit}]": row.words for unit, row in nearest.items()}
    return Remark(f"limit {owner}", level, "; ".join(said), values)
