"""The rows of a study that went worst."""

from __future__ import annotations

import numpy as np

from coopqp.checked import Array
from coopqp.report.sweep.bins import Binned
from coopqp.study.sweep.results import Columns

WORST = 10


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


def worst_rows(binned: Binned, error: Array, controller: int) -> list[int]:
    """Those of a controller that do not succeed and end farthest from their goals; a NaN is far."""
    rows = np.flatnonzero(binned.done & (binned.controller == controller) & ~(binned.success > 0.0))
    far = np.where(np.isfinite(error[rows]), error[rows], np.inf)
    return [int(row) for row in rows[np.argsort(-far, kind="stable")[:WORST]]]
