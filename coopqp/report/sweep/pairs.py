"""Controllers against each other on the same variants, and the rows that went worst."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from coopqp.checked import Array
from coopqp.report.sweep.bins import Binned
from coopqp.study.statistics.summary import AS_NEAR
from coopqp.study.sweep.columns import Columns

WORST = 10


@dataclass(frozen=True)
class Pair:
    """Two controllers on the variants on which both are done.

    Attributes:
        one, other: their names.
        both, only_one, only_other, neither: variants on which they succeed.
        nearer: share of the variants on which the first ends nearer to its goals: it broke nothing,
            one of the two misses a goal, and the errors differ by more than a margin.
    """

    one: str
    other: str
    both: int
    only_one: int
    only_other: int
    neither: int
    nearer: float


def worst_error(columns: Columns) -> Array:
    """Each row's error of the task that is worst, in medians of that task, shape (rows,)."""
    worst = np.full(len(columns), -np.inf)
    for name in columns.kinds:
        if name.startswith("task_error."):
            error = columns.numbers(name)
            known = error[np.isfinite(error)]
            scale = float(np.median(known)) if len(known) else 1.0
            worst = np.fmax(worst, error / (scale or 1.0))
    return worst


def pairs(binned: Binned, error: Array, columns: Columns) -> Iterator[Pair]:
    """Every two controllers; rows of a variant follow each other, a controller each."""
    n = len(binned.controllers)
    if n < 2 or len(error) % n:
        return
    done, good = (truth.reshape(-1, n) for truth in (binned.done, binned.success > 0.0))
    far = error.reshape(-1, n)
    reached = (columns.numbers("reached") > 0.0).reshape(-1, n)
    codes, texts = columns.codes("broken")
    whole = np.array([not text for text in texts] + [True])[codes].reshape(-1, n)
    for i, j in itertools.combinations(range(n), 2):
        both = done[:, i] & done[:, j]
        a, b = good[both, i], good[both, j]
        counts = [int(x.sum()) for x in (a & b, a & ~b, ~a & b, ~a & ~b)]
        close = whole[:, i] & ~(reached[:, i] & reached[:, j]) & (AS_NEAR * far[:, i] < far[:, j])
        nearer = float(close[both].mean()) if both.any() else float("nan")
        one, other = binned.controllers[i], binned.controllers[j]
        yield Pair(one, other, counts[0], counts[1], counts[2], counts[3], nearer)


def worst_rows(binned: Binned, error: Array, controller: int) -> list[int]:
    """Those of a controller that do not succeed and end farthest from their goals; a NaN is far."""
    rows = np.flatnonzero(binned.done & (binned.controller == controller) & ~(binned.success > 0.0))
    far = np.where(np.isfinite(error[rows]), error[rows], np.inf)
    return [int(row) for row in rows[np.argsort(-far, kind="stable")[:WORST]]]
