"""What a study says of each controller, and of two on the same variants.

Variants differ more than controllers do. Two intervals, one for each controller, overlap for that
alone; the interval and the test of the difference do not see it.

    success   b variants on which only the first succeeds, c only the second, of n
              difference (b - c) / n, interval of Bonett and Price (2012), and the exact test of
              McNemar (1947): b of b + c as often as heads
    numbers   median of the differences, with the interval between two of them in order that the
              sign test does not refuse; both are free of any distribution
"""

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtr, bdtrik

from coopqp.base.spec import Array
from coopqp.study.sweep.results import Columns

Z = 1.959963984540054  # of a two-sided 95 % interval
TAIL = 0.025  # of it, on each side


@dataclass(frozen=True)
class Share:
    """How often something was so, of how many, and the 95 % interval of the share."""

    count: int
    of: int
    low: float
    high: float

    def percent(self, digits: int, *, exact: bool = False) -> str:
        """Such as "93.1 90.2-95.4", without the interval if exact; a dash where there was none."""
        if not self.of:
            return "-"
        part, low, high = 100.0 * self.count / self.of, 100 * self.low, 100 * self.high
        told = f"{part:.{digits}f}"
        return told if exact else f"{told} {low:.{digits}f}-{high:.{digits}f}"


def wilson(count: int, of: int) -> Share:
    """A share with its interval (Wilson 1927), which holds near 0 and 1 and for few as well."""
    if not of:
        return Share(0, 0, 0.0, 1.0)
    p, spread = count / of, Z * Z / of
    middle = (p + 0.5 * spread) / (1.0 + spread)
    half = math.sqrt(spread * p * (1.0 - p) + 0.25 * spread**2) / (1.0 + spread)
    return Share(count, of, max(0.0, middle - half), min(1.0, middle + half))


@dataclass(frozen=True)
class Difference:
    """A controller's value, share or median, less that of the reference."""

    value: float
    low: float  # of the 95 % interval, which is infinite where there are too few for one
    high: float
    p: float  # of an exact two-sided test that there is no difference
    of: int  # so many variants

    @property
    def chance(self) -> str:
        """Such as "p 0.03"."""
        return f"p {self.p:.1g}" if self.p >= 1e-4 else "p < 1e-4"


@dataclass(frozen=True)
class Success:
    """On how many variants two controllers succeed, and the difference of the shares."""

    both: int
    only_one: int
    only_reference: int
    neither: int
    difference: Difference


def success(one: NDArray[np.bool_], reference: NDArray[np.bool_]) -> Success:
    """Compare whether two controllers succeed, for each variant, shapes (n,)."""
    counts = (one & reference, one & ~reference, reference & ~one, ~one & ~reference)
    both, b, c, neither = (int(x.sum()) for x in counts)
    n = len(one)
    first, second = (b + 1) / (n + 2), (c + 1) / (n + 2)
    middle = first - second
    half = Z * math.sqrt((first + second - middle**2) / (n + 2))
    low, high = max(-1.0, middle - half), min(1.0, middle + half)
    difference = Difference((b - c) / n if n else math.nan, low, high, heads(b, c), n)
    return Success(both, b, c, neither, difference)


def median(one: Array, reference: Array) -> Difference:
    """Compare numbers of two controllers, shapes (n,); a NaN is no difference."""
    with np.errstate(invalid="ignore"):  # of two infinite errors
        differences = one - reference
    differences = np.sort(differences[~np.isnan(differences)])
    n = len(differences)
    if not n:
        return Difference(math.nan, -math.inf, math.inf, 1.0, 0)
    low, high = -math.inf, math.inf
    if bdtr(0, n, 0.5) <= TAIL:
        outside = math.floor(bdtrik(TAIL, n, 0.5))  # so many at each end are no part of it
        low, high = float(differences[outside]), float(differences[n - 1 - outside])
    p = heads(int((differences > 0.0).sum()), int((differences < 0.0).sum()))
    return Difference(float(np.median(differences)), low, high, p, n)


def heads(b: int, c: int) -> float:
    """Probability that b and c tosses of a coin are as uneven as this, or more."""
    return min(1.0, 2.0 * float(bdtr(min(b, c), b + c, 0.5))) if b + c else 1.0


MARGIN = "limit_margin_min"
#: What the columns of tasks' errors begin with.
ERROR = "task_error."
#: In a reason, but not in names and in places of files.
_NUMBER = re.compile(r"(?<![\w.:])[-+]?\d+(\.\d+)?([eE][-+]?\d+)?\b")
Rows = NDArray[np.bool_]
"""Which rows count."""


@dataclass(frozen=True)
class Line:
    """One controller on all variants."""

    controller: str
    # how many rows are done, invalid and failed; the others are of those that are done
    states: dict[str, int]
    success: Share
    reached: Share
    errors: dict[str, tuple[float, float]]  # median and 95 % quantile of each task's error, by name
    # the same of the least distance to a joint's limit, 5 % instead of 95
    margin: tuple[float, float]
    # blocked_by, broken: how often each limit kept it from a goal, and was broken
    blocked_by: dict[str, int]
    broken: dict[str, int]


@dataclass(frozen=True)
class Pair:
    """A controller against the study's first, the reference, on variants on which both are done."""

    controller: str
    reference: str
    success: Success
    # median differences of each task's error, and of the least distance to a joint's limit, by name
    # of the column
    numbers: dict[str, Difference]


@dataclass(frozen=True)
class Summary:
    """A study in few numbers."""

    rows: int
    exact: bool  # where nothing was drawn, so that there is nothing to estimate
    lines: tuple[Line, ...]
    pairs: tuple[Pair, ...]  # one for each controller but the reference
    # how often each was given by rows that are not done, the most frequent first; those that only
    # differ in numbers together
    reasons: dict[str, int]


def summarize(columns: Columns, *, exact: bool) -> Summary:
    """Count, a column at a time; it is exact where nothing was drawn."""
    of, controllers = columns.codes("controller")
    state, states = columns.codes("state")
    done = columns.done
    success, reached, margins = map(columns.numbers, ("success", "reached", MARGIN))
    errors = {name: columns.numbers(name) for name in columns.kinds if name.startswith(ERROR)}
    blocked_by, broken = map(columns.codes, ("blocked_by", "broken"))
    lines = []
    for k, controller in enumerate(controllers):
        own = of == k
        there = own & done
        counts = np.bincount(state[own], minlength=len(states)).tolist()
        lines.append(
            Line(
                controller,
                states=dict(zip(states, counts, strict=True)),
                success=_share(success[there]),
                reached=_share(reached[there]),
                errors={name: _quantiles(x[there], 0.95) for name, x in errors.items()},
                margin=_quantiles(margins[there], 0.05),
                blocked_by=_counted(there, *blocked_by),
                broken=_counted(there, *broken),
            )
        )
    # A row of a run that is done and has no finite error ends infinitely far from its goal.
    far = {name: np.where(done & np.isnan(x), np.inf, x) for name, x in errors.items()}
    pairs = _pairs(controllers, of, done, success > 0.0, {**far, MARGIN: margins})
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
        yield Pair(controllers[k], controllers[0], success(good[both, k], good[both, 0]), numbers)


def _share(true: NDArray[np.float64]) -> Share:
    return wilson(int(np.nansum(true)), len(true))


def _quantiles(values: NDArray[np.float64], outer: float) -> tuple[float, float]:
    known = values[np.isfinite(values)]
    if not len(known):
        return math.nan, math.nan
    middle, far = np.quantile(known, [0.5, outer]).tolist()
    return middle, far


def _texts(rows: Rows, codes: NDArray[np.int64], texts: list[str]) -> Iterator[tuple[str, int]]:
    counts = np.bincount(codes[rows & (codes >= 0)], minlength=len(texts))
    return zip(texts, counts.tolist(), strict=True)


def _counted(rows: Rows, codes: NDArray[np.int64], texts: list[str]) -> dict[str, int]:
    """How often each of the names is in the texts, the most frequent first."""
    found: Counter[str] = Counter()
    for text, count in _texts(rows, codes, texts):
        for name in filter(None, text.split(", ")):
            found[name] += count
    return {name: count for name, count in found.most_common() if count}


def _reasons(columns: Columns, rows: Rows) -> dict[str, int]:
    """Reasons that only differ in numbers are one, with the numbers of the most frequent."""
    alike: dict[str, Counter[str]] = {}
    for text, count in _texts(rows, *columns.codes("reason")):
        if text and count:
            alike.setdefault(_NUMBER.sub("#", text), Counter())[text] += count
    found: Counter[str] = Counter()
    for several in alike.values():
        ((text, _),) = several.most_common(1)
        found[text if len(several) == 1 else f"such as {text}"] += several.total()
    return dict(found.most_common())
