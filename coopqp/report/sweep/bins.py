"""A study in bins: what its page shows, a few thousand numbers for any number of rows."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopqp.base.spec import Array
from coopqp.study.sweep.results import Columns
from coopqp.study.sweep.space import Box
from coopqp.study.sweep.study import DONE, Study
from coopqp.study.sweep.summary import ERROR

BINS, MIN_BINS = 16, 4  # of an axis with numbers
ROWS_A_CELL = 8  # of a map and a controller, where there are enough variants
LEVELS = 24  # values that have a bin each; of texts the most frequent
MAX_AXES = 8  # on the page; the first ones
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
OTHER = "others"
NULL = "left out"  # what a scenario does with a key that is null

Codes = NDArray[np.int64]
WORST = 10


@dataclass(frozen=True)
class Axis:
    """A varied quantity, in bins with labels or edges (one more than bins).

    Attributes:
        log: whether the edges are evenly spaced in their logarithm.
        code: bin of each row, shape (rows,).
    """

    name: str
    labels: tuple[str, ...]
    edges: tuple[float, ...]
    log: bool
    code: Codes

    @property
    def count(self) -> int:
        return len(self.labels) or len(self.edges) - 1

    def as_json(self) -> dict[str, Any]:
        edges = [short(edge) for edge in self.edges]
        return {"name": self.name, "labels": self.labels, "edges": edges, "log": self.log}


def axes(study: Study, columns: Columns) -> list[Axis]:
    """All that takes more than one value, the first ones of many."""
    boxes = [(one, one.over) for one in study.varied if isinstance(one.over, Box)]
    logs = {one.path for one, box in boxes if box.grows}
    ends = {  # as the study has them; of logarithms, those
        name: (side.low, side.high)
        for one, box in boxes
        for name, side in zip(one.columns, box.sides, strict=True)
    }
    count = bins_for(study.points.count)
    every = (
        _axis(columns, name, log=name in logs, count=count, ends=ends.get(name))
        for name in study.columns
    )
    return [axis for axis in every if axis is not None and axis.count > 1][:MAX_AXES]


def bins_for(variants: int) -> int:
    """So many that a cell of a map has enough rows; a multiple of four, for ticks."""
    fitting = int(np.sqrt(variants / ROWS_A_CELL)) // 4 * 4
    return min(BINS, max(MIN_BINS, fitting))


def _axis(
    columns: Columns,
    name: str,
    *,
    log: bool,
    count: int = BINS,
    ends: tuple[float, float] | None = None,
) -> Axis | None:
    kind = columns.kinds[name]
    if kind == "string":
        return _texts(columns, name)
    values = columns.numbers(name)
    there = np.isfinite(values)
    if not there.any():
        return None
    known = np.unique(values[there])
    if kind == "bool" or len(known) <= LEVELS:
        labels = tuple(("false", "true")[int(v)] if kind == "bool" else f"{v:.4g}" for v in known)
        return _with_null(Axis(name, labels, (), log, np.searchsorted(known, values)), there)
    shown = np.log10(values, where=there, out=np.zeros_like(values)) if log else values
    low, high = ends or (float(shown[there].min()), float(shown[there].max()))
    edges = np.linspace(low, high, count + 1)
    code = np.clip(np.searchsorted(edges, shown, side="right") - 1, 0, count - 1)
    even = tuple((10.0**edges if log else edges).tolist())
    return _with_null(Axis(name, (), even, log, code), there)


def _with_null(axis: Axis, there: NDArray[np.bool_]) -> Axis:
    """The axis with one more bin for rows whose key is null; its bins then all have labels."""
    if there.all():
        return axis
    between = (f"{a:.4g} to {b:.4g}" for a, b in itertools.pairwise(axis.edges))
    labels = (*(axis.labels or between), NULL)
    return replace(axis, labels=labels, edges=(), code=np.where(there, axis.code, axis.count))


def _texts(columns: Columns, name: str) -> Axis:
    codes, texts = columns.codes(name)
    there = codes >= 0
    if len(texts) <= LEVELS:
        return _with_null(Axis(name, tuple(texts), (), False, codes), there)
    order = np.argsort(-np.bincount(codes[there], minlength=len(texts)), kind="stable")
    kept = order[: LEVELS - 1]
    new = np.full(len(texts) + 1, LEVELS - 1)
    new[kept] = np.arange(len(kept))
    labels = (*(texts[i] for i in kept), OTHER)
    return _with_null(Axis(name, labels, (), False, new[codes]), there)


@dataclass(frozen=True)
class Binned:
    """Of each row, shape (rows,): controller, whether it is done, success (1, 0 or NaN)."""

    axes: Sequence[Axis]
    controllers: Sequence[str]
    controller: Codes
    done: NDArray[np.bool_]
    success: Array

    @classmethod
    def of(cls, study: Study, columns: Columns) -> Binned:
        controller, names = columns.codes("controller")
        state, states = columns.codes("state")
        done = np.array([name == DONE for name in states] + [False])[state]
        return cls(axes(study, columns), names, controller, done, columns.numbers("success"))

    def maps(self) -> Iterator[dict[str, Any]]:
        """For each pair of axes and each controller how many rows, and how many succeed."""
        numbers = range(len(self.axes))
        pairs = list(itertools.combinations(numbers, 2)) or [(0, 0)] * bool(self.axes)
        done = [self.done & (self.controller == k) for k in range(len(self.controllers))]
        good = [rows & (self.success > 0.0) for rows in done]
        for i, j in pairs:
            a, b = self.axes[i], self.axes[j]
            cell, cells = a.code * b.count + b.code, a.count * b.count
            counts = (
                [np.bincount(cell[rows], minlength=cells).tolist() for rows in kept]
                for kept in (done, good)
            )
            yield {"x": i, "y": j} | dict(zip(("all", "good"), counts, strict=True))

    def bands(self, values: Array) -> list[list[list[list[float] | None]]]:
        """Quantiles of a column: by axis, by controller, by bin; None for an empty bin."""
        return [
            [self._quantiles(axis, values, k) for k in range(len(self.controllers))]
            for axis in self.axes
        ]

    def _quantiles(self, axis: Axis, values: Array, controller: int) -> list[list[float] | None]:
        rows = np.flatnonzero(self.done & (self.controller == controller) & np.isfinite(values))
        rows = rows[np.argsort(axis.code[rows], kind="stable")]
        ends = np.searchsorted(axis.code[rows], np.arange(axis.count + 1))
        return [
            [short(q) for q in np.quantile(values[rows[a:b]], QUANTILES)] if b > a else None
            for a, b in itertools.pairwise(ends)
        ]

    def flows(self) -> list[list[list[int]]]:
        """Parallel coordinates: between neighbouring axes, [bin, bin, rows, successes].

        Before the first axis come the controllers, after the last success.
        """
        good = self.success > 0.0
        sides = [self.controller, *(axis.code for axis in self.axes), good.astype(np.int64)]
        counts = [*(axis.count for axis in self.axes), 2]
        flows = []
        for (a, b), n in zip(itertools.pairwise(sides), counts, strict=True):
            pair = (a * n + b)[self.done]
            every, succeeded = np.bincount(pair), np.bincount(pair, weights=good[self.done])
            there = np.flatnonzero(every).tolist()
            flows.append([[c // n, c % n, int(every[c]), int(succeeded[c])] for c in there])
        return flows


def short(value: float) -> float:
    """With five digits."""
    return float(f"{value:.5g}")


def worst_error(columns: Columns) -> Array:
    """Each row's largest task error, in medians of that task, shape (rows,)."""
    worst = np.full(len(columns), -np.inf)
    for name in columns.kinds:
        if name.startswith(ERROR):
            error = columns.numbers(name)
            known = error[np.isfinite(error)]
            scale = float(np.median(known)) if len(known) else 1.0
            worst = np.fmax(worst, error / (scale or 1.0))
    return worst


def worst_rows(binned: Binned, error: Array, controller: int) -> list[int]:
    """A controller's rows without success, the largest errors first; a NaN is the largest."""
    rows = np.flatnonzero(binned.done & (binned.controller == controller) & ~(binned.success > 0.0))
    far = np.where(np.isfinite(error[rows]), error[rows], np.inf)
    return [int(row) for row in rows[np.argsort(-far, kind="stable")[:WORST]]]
