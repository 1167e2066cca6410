"""What a study says of each controller, in a line."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopqp.study.sweep.paired import Difference, Share, Success, median, wilson
from coopqp.study.sweep.paired import success as paired
from coopqp.study.sweep.results import Columns
from coopqp.study.sweep.variant import DONE

MARGIN = "limit_margin_min"
#: What the columns of tasks' errors begin with.
ERROR = "task_error."
#: In a reason, but not in names and in places of files.
_NUMBER = re.compile(r"(?<![\w.:])[-+]?\d+(\.\d+)?([eE][-+]?\d+)?\b")
Rows = NDArray[np.bool_]
"""Which rows count."""


@dataclass(frozen=True)
class Line:
    """One controller on all variants.

    Attributes:
        states: how many rows are done, invalid and failed.
        success, reached: of those that are done.
        errors: median and 95 % quantile of each task's error, by name.
        margin: the same of the least distance to a joint's limit, 5 % instead of 95.
        blocked_by: how often each limit kept it from a goal.
        broken: how often each limit was broken.
    """

    controller: str
    states: dict[str, int]
    success: Share
    reached: Share
    errors: dict[str, tuple[float, float]]
    margin: tuple[float, float]
    blocked_by: dict[str, int]
    broken: dict[str, int]


@dataclass(frozen=True)
class Pair:
    """A controller against the reference, on the variants on which both are done.

    Attributes:
        controller, reference: their names; the reference is the first of the study.
        success: how often they succeed.
        numbers: median differences of each task's error, and of the least distance to a joint's
            limit, by name of the column.
    """

    controller: str
    reference: str
    success: Success
    numbers: dict[str, Difference]


@dataclass(frozen=True)
class Summary:
    """A study in few numbers.

    Attributes:
        exact: whether nothing was drawn, so that there is nothing to estimate.
        pairs: one for each controller but the reference.
        reasons: how often each was given by rows that are not done, the most frequent first; those
            that only differ in numbers together.
    """

    rows: int
    exact: bool
    lines: tuple[Line, ...]
    pairs: tuple[Pair, ...]
    reasons: dict[str, int]


def summarize(columns: Columns, *, exact: bool) -> Summary:
    """Count, a column at a time; it is exact where nothing was drawn."""
    of, controllers = columns.codes("controller")
    state, states = columns.codes("state")
    done = np.array([name == DONE for name in states] + [False])[state]
    errors = [name for name in columns.kinds if name.startswith(ERROR)]
    success, reached = (columns.numbers(name) for name in ("success", "reached"))
    values = {name: columns.numbers(name) for name in errors}
    margins = columns.numbers(MARGIN)
    named = {name: columns.codes(name) for name in ("blocked_by", "broken")}
    lines = []
    for k, controller in enumerate(controllers):
        own = of == k
        there = own & done
        counts = np.bincount(state[own], minlength=len(states))
        lines.append(
            Line(
                controller,
                dict(zip(states, map(int, counts), strict=True)),
                _share(success[there]),
                _share(reached[there]),
                {name: _quantiles(values[name][there], 0.95) for name in errors},
                _quantiles(margins[there], 0.05),
                *(_counted(codes[there], texts) for codes, texts in named.values()),
            )
        )
    # A row of a run that is done and has no finite error ends infinitely far from its goal.
    far = {name: np.where(done & np.isnan(x), np.inf, x) for name, x in values.items()}
    measured = {**far, MARGIN: margins}
    pairs = _pairs(controllers, of, done, success > 0.0, measured)
    return Summary(len(columns), exact, tuple(lines), tuple(pairs), _reasons(columns, ~done))


def _pairs(
    controllers: Sequence[str],
    of: NDArray[np.int64],
    done: Rows,
    good: Rows,
    measured: Mapping[str, NDArray[np.float64]],
) -> Iterator[Pair]:
    """The rows of a variant follow each other, one for each controller."""
    n = len(controllers)
    if n < 2 or len(of) % n or not (of.reshape(-1, n) == np.arange(n)).all():
        return
    done, good = done.reshape(-1, n), good.reshape(-1, n)
    columns = {name: values.reshape(-1, n) for name, values in measured.items()}
    for k in range(1, n):
        both = done[:, k] & done[:, 0]
        numbers = {name: median(x[both, k], x[both, 0]) for name, x in columns.items()}
        yield Pair(controllers[k], controllers[0], paired(good[both, k], good[both, 0]), numbers)


def _share(true: NDArray[np.float64]) -> Share:
    return wilson(int(np.nansum(true)), len(true))


def _quantiles(values: NDArray[np.float64], outer: float) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    if not len(known):
        return float("nan"), float("nan")
    middle, far = np.quantile(known, [0.5, outer])
    return float(middle), float(far)


def _counted(codes: NDArray[np.int64], texts: list[str]) -> dict[str, int]:
    """How often each of the names is in the texts, the most frequent first."""
    found: Counter[str] = Counter()
    counts = np.bincount(codes[codes >= 0], minlength=len(texts))
    for text, count in zip(texts, counts, strict=True):
        for name in filter(None, text.split(", ")):
            found[name] += int(count)
    return {name: count for name, count in found.most_common() if count}


def _reasons(columns: Columns, rows: Rows) -> dict[str, int]:
    """Reasons that only differ in numbers are one, with the numbers of the most frequent."""
    codes, texts = columns.codes("reason")
    counts = np.bincount(codes[rows & (codes >= 0)], minlength=len(texts))
    alike: dict[str, Counter[str]] = {}
    for text, count in zip(texts, counts.tolist(), strict=True):
        if text and count:
            alike.setdefault(_NUMBER.sub("#", text), Counter())[text] += count
    found: Counter[str] = Counter()
    for several in alike.values():
        ((text, _),) = several.most_common(1)
        found[text if len(several) == 1 else f"such as {text}"] += several.total()
    return dict(found.most_common())
