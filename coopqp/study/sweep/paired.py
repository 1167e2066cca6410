"""How often a controller succeeds, and it against another on the same variants.

Variants differ more than controllers do. Two intervals, one for each controller, overlap for that
alone; the interval and the test of the difference do not see it.

    success   b variants on which only the first succeeds, c only the second, of n
              difference (b - c) / n, interval of Bonett and Price (2012), and the exact test of
              McNemar (1947): b of b + c as often as heads
    numbers   median of the differences, with the interval between two of them in order that the
              sign test does not refuse; both are free of any distribution
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtr, bdtrik

from coopqp.base.spec import Array

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
    """A controller's value less that of the reference.

    Attributes:
        value: share, or median.
        low, high: 95 % interval; infinite where there are too few variants for one.
        p: of an exact two-sided test that there is none.
        of: variants that count.
    """

    value: float
    low: float
    high: float
    p: float
    of: int

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
    return Success(both, b, c, neither, _of_shares(b, c, len(one)))


def _of_shares(b: int, c: int, n: int) -> Difference:
    if not n:
        return Difference(math.nan, -1.0, 1.0, 1.0, 0)
    first, second = (b + 1) / (n + 2), (c + 1) / (n + 2)
    middle = first - second
    half = Z * math.sqrt((first + second - middle**2) / (n + 2))
    return Difference(
        (b - c) / n, max(-1.0, middle - half), min(1.0, middle + half), heads(b, c), n
    )


def median(one: Array, reference: Array) -> Difference:
    """Compare numbers of two controllers, shapes (n,); a NaN is no difference."""
    with np.errstate(invalid="ignore"):  # of two infinite errors
        found = one - reference
    found = np.sort(found[~np.isnan(found)])
    n = len(found)
    if not n:
        return Difference(math.nan, -math.inf, math.inf, 1.0, 0)
    low, high = -math.inf, math.inf
    if bdtr(0, n, 0.5) <= TAIL:
        outside = math.floor(bdtrik(TAIL, n, 0.5))  # so many at each end are no part of it
        low, high = float(found[outside]), float(found[n - 1 - outside])
    p = heads(int((found > 0.0).sum()), int((found < 0.0).sum()))
    middle = found[(n - 1) // 2], found[n // 2]
    value = middle[0] if middle[0] == middle[1] else 0.5 * (middle[0] + middle[1])
    return Difference(float(value), low, high, p, n)


def heads(b: int, c: int) -> float:
    """Probability that b and c tosses of a coin are as uneven as this, or more."""
    return min(1.0, 2.0 * float(bdtr(min(b, c), b + c, 0.5))) if b + c else 1.0
