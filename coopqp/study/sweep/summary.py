"""What a study says of each controller, in a line."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopqp.study.statistics.summary import Share, wilson
from coopqp.study.sweep.columns import Columns
from coopqp.study.sweep.variant import DONE

#: In a reason, but not in names and in places of files.
_NUMBER = re.compile(r"(?<![\w.:])[-+]?\d+(\.\d+)?([eE][-+]?\d+)?\b")
Rows = NDArray[np.bool_]
"""Which rows count."""


@dataclass(frozen=True)
class Line:
    """One controller on all variants.

    Attributes:
        controller: its name.
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
class Summary:
    """A study in few numbers.

    Attributes:
        rows: how many.
        lines: one a controller.
        reasons: how often each was given by rows that are not done, the most frequent first; those
            that only differ in numbers together.
    """

    rows: int
    lines: tuple[Line, ...]
    reasons: dict[str, int]


def summarize(columns: Columns) -> Summary:
    """Count, a column at a time."""
    of, controllers = columns.codes("controller")
    state, states = columns.codes("state")
    done = np.array([name == DONE for name in states] + [False])[state]
    errors = [name for name in columns.kinds if name.startswith("task_error.")]
    success, reached = (columns.numbers(name) for name in ("success", "reached"))
    values = {name: columns.numbers(name) for name in errors}
    margins = columns.numbers("limit_margin_min")
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
    return Summary(len(columns), tuple(lines), _reasons(columns, ~done))


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
