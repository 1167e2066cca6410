"""Run what of a study is not there yet, and write down what comes."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from coopqp.study.engine import Engine, Lost
from coopqp.study.sweep.folder import check_folder, head_for
from coopqp.study.sweep.journal import Journal, path_of
from coopqp.study.sweep.results import Index, compact, needs_arrow
from coopqp.study.sweep.study import Study, job_of, lost_rows, run_variants

HERE = Engine()


@dataclass
class Progress:
    """How far a sweep is.

    Attributes:
        total: variants of this share; so many were there ``before``, and are ``done``.
        states: of the rows that came since it began.
        damaged: records that were not as they were written; what they said is done again.
    """

    total: int
    before: int
    done: int
    states: Counter[str] = field(default_factory=Counter)
    damaged: int = 0
    begun: float = field(default_factory=time.monotonic)

    @property
    def rate(self) -> float:
        """Variants a second since it began; 0 before the first."""
        return (self.done - self.before) / max(time.monotonic() - self.begun, 1e-3)

    @property
    def left(self) -> float:
        """Time that the others will take [s]; infinite before the first."""
        return (self.total - self.done) / self.rate if self.rate else float("inf")


def sweep(
    study: Study,
    folder: Path,
    *,
    engine: Engine = HERE,
    progress: Callable[[Progress], None] | None = None,
) -> Progress:
    """Run the variants that are not in the folder yet; at the end write ``results.parquet``.

    Killed at any moment, it goes on from there when called again; the file is the same in the end.

    Args:
        study: what is asked.
        folder: for its journal and results; made if it does not exist.
        engine: where, and which share; on all cores when omitted.
        progress: called after each batch.

    Raises:
        CoopqpError: the folder belongs to another study, or cannot be written to; nobody answers
            at the scheduler's address.
    """
    needs_arrow()
    head = head_for(study)
    check_folder(folder, head)
    job = job_of(study)
    with Journal.opened(path_of(folder, engine.share), head) as journal:
        mine = engine.share.taken(range(study.points.count))
        index = Index(folder, study)
        missing = index.missing(mine)
        there = len(mine) - len(missing)
        state = Progress(len(mine), there, there, damaged=index.damaged)
        variants = map(study.variant, missing.tolist())
        for batch in engine.batches(partial(run_variants, job=job), variants, len(missing)):
            found = [
                (variant.index, lost_rows(job, rows.reason) if isinstance(rows, Lost) else rows)
                for variant, rows in batch
            ]
            journal.append((index, {"variant": index, "rows": rows}) for index, rows in found)
            state.done += len(found)
            state.states.update(row["state"] for _, rows in found for row in rows)
            if progress:
                progress(state)
    compact(study, folder)
    return state
