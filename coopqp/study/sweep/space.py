"""What a key of a scenario is varied over.

    box: [[0.1, -0.05], [0.2, 0.05]]          numbers between two corners, even; and levels
    range: [0.5, 2.0]                         a number between two, even; a third: so many levels
    log: [0.1, 10]                            the same, even in its logarithm
    normal: [1.0, 0.2]                        mean and standard deviation
    values: [1, 2, 5]                         one of some numbers, or of lists of them
    choice: [quintic, {kind: linear}]         one of anything

A variation maps numbers u of the unit interval, one a dimension, to a value.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtri

from coopqp.checked import Array
from coopqp.errors import InvalidValueError, unknown_name
from coopqp.wording import shown

LEAST = 2.0**-40  # u of a normal variation is between this and 1 - this
MOST_LEVELS = 1_000_000


class Variation(ABC):
    """What one key is varied over."""

    @property
    def dimensions(self) -> int:
        """How many numbers of the unit interval make a value."""
        return 1

    @property
    def suffixes(self) -> tuple[str, ...]:
        """What is added to the key's path for each number of a value; one empty for one."""
        return ("",)

    @abstractmethod
    def at(self, u: Array) -> Any:
        """The value of numbers in [0, 1), shape (dimensions,)."""

    @abstractmethod
    def levels(self, count: int) -> tuple[int, ...]:
        """How many levels a grid has in each dimension; ``count`` where none is said, 0 if none."""

    @abstractmethod
    def tried(self) -> list[Any]:
        """Values that stand for all, to see whether the key takes them."""

    def parts(self, value: Any) -> tuple[Any, ...]:
        """The numbers or texts that stand in the columns of a value."""
        return tuple(value) if len(self.suffixes) > 1 else (value,)


@dataclass(frozen=True)
class Interval:
    """Numbers between two.

    Attributes:
        low, high: the ends.
        count: levels; 0 where all numbers count.
        whole: whether the levels are whole numbers.
    """

    low: float
    high: float
    count: int = 0
    whole: bool = False

    def at(self, u: float, levels: int) -> float:
        """The number at u; the nearest level where there are levels."""
        if levels == 1:
            return self.low
        share = min(int(u * levels), levels - 1) / (levels - 1) if levels else u
        number = self.low + share * (self.high - self.low)
        return round(number) if self.whole else number


@dataclass(frozen=True)
class Box(Variation):
    """One number, or as many as the corners have."""

    sides: tuple[Interval, ...]
    listed: bool
    grows: bool = False

    @property
    def dimensions(self) -> int:
        return len(self.sides)

    @property
    def suffixes(self) -> tuple[str, ...]:
        return tuple(f"[{i}]" for i in range(len(self.sides))) if self.listed else ("",)

    def parts(self, value: Any) -> tuple[Any, ...]:
        return tuple(value) if self.listed else (value,)

    def at(self, u: Array) -> Any:
        found = [side.at(float(x), side.count) for side, x in zip(self.sides, u, strict=True)]
        if self.grows:
            found = [10.0**x for x in found]
        return found if self.listed else found[0]

    def levels(self, count: int) -> tuple[int, ...]:
        return tuple(1 if s.low == s.high else s.count or count for s in self.sides)

    def gridded(self, levels: Sequence[int]) -> Box:
        """The same with levels."""
        sides = zip(self.sides, levels, strict=True)
        return Box(tuple(Interval(s.low, s.high, n, s.whole) for s, n in sides), self.listed,
                   self.grows)  # fmt: skip

    def tried(self) -> list[Any]:
        return [self.at(np.full(self.dimensions, u)) for u in (0.0, 0.5, 1.0)]


@dataclass(frozen=True)
class Normal(Variation):
    """A number with a mean and a standard deviation."""

    mean: float
    deviation: float

    def at(self, u: Array) -> Any:
        return self.mean + self.deviation * float(ndtri(np.clip(u[0], LEAST, 1.0 - LEAST)))

    def levels(self, count: int) -> tuple[int, ...]:
        return (0,)

    def tried(self) -> list[Any]:
        return [self.mean]


@dataclass(frozen=True)
class Listed(Variation):
    """One of some values."""

    values: tuple[Any, ...]
    numbers: int = 0

    @property
    def suffixes(self) -> tuple[str, ...]:
        return tuple(f"[{i}]" for i in range(self.numbers)) if self.numbers else ("",)

    def parts(self, value: Any) -> tuple[Any, ...]:
        return tuple(value) if self.numbers else (value,)

    def at(self, u: Array) -> Any:
        return self.values[min(int(u[0] * len(self.values)), len(self.values) - 1)]

    def levels(self, count: int) -> tuple[int, ...]:
        return (len(self.values),)

    def tried(self) -> list[Any]:
        return list(self.values)


def read(given: Any) -> Variation:
    """A variation from what a file says.

    Raises:
        InvalidValueError: it is none, empty or contradicts itself; its keys say where.
    """
    if not isinstance(given, dict) or len(given) != 1:
        found = f"found {len(given)} keys" if isinstance(given, dict) else "found no mapping"
        raise InvalidValueError(f"{found}; needs one of {', '.join(KINDS)}, such as range: [0, 1]")
    ((kind, value),) = given.items()
    if kind not in KINDS:
        raise InvalidValueError(unknown_name("variation", str(kind), KINDS)).at(str(kind))
    try:
        return KINDS[kind](value)
    except InvalidValueError as error:
        raise error.at(kind) from None


def _box(value: Any) -> Variation:
    if not isinstance(value, list) or not 2 <= len(value) <= 3:
        raise InvalidValueError("needs two corners, [[lows], [highs]], and levels if you like")
    low, high = (_numbers(corner) for corner in value[:2])
    counts = value[2] if len(value) == 3 else 0
    listed = counts if isinstance(counts, list) else [counts] * len(low)
    if not low or len(low) != len(high):
        raise InvalidValueError(f"needs corners of one length; found {len(low)} and {len(high)}")
    if len(listed) != len(low):
        raise InvalidValueError(f"found {len(listed)} levels; needs {len(low)}, or one for all")
    sides = [
        _interval([a, b], n) if n else _interval([a, b])
        for a, b, n in zip(value[0], value[1], listed, strict=True)
    ]
    return Box(tuple(sides), listed=True)


def _range(value: Any) -> Variation:
    return Box((_interval(_ends(value), *value[2:]),), listed=False)


def _log(value: Any) -> Variation:
    low, high = _ends(value)
    if low <= 0.0:
        raise InvalidValueError(f"found {low:g}; a logarithm needs numbers above 0")
    found = _interval([low, high], *value[2:])
    side = Interval(math.log10(found.low), math.log10(found.high), found.count)
    return Box((side,), listed=False, grows=True)


def _ends(value: Any) -> list[float]:
    if not isinstance(value, list) or not 2 <= len(value) <= 3:
        raise InvalidValueError("needs [least, most], or [least, most, levels]")
    return _numbers(value[:2])


def _interval(ends: Sequence[Any], count: Any = None) -> Interval:
    low, high = ends
    if low > high:
        raise InvalidValueError(f"is empty: {low:g} to {high:g}; give the least first")
    if count is None:
        return Interval(low, high)
    if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MOST_LEVELS:
        raise InvalidValueError(f"found {shown(count)} levels; needs a whole number, at least 1")
    if count == 1 and low != high:
        raise InvalidValueError("found 1 level between two numbers; needs at least 2")
    if low == high:
        count = 1
    even = count == 1 or (high - low) % (count - 1) == 0
    return Interval(low, high, count, all(isinstance(end, int) for end in ends) and even)


def _normal(value: Any) -> Variation:
    if not isinstance(value, list) or len(value) != 2:
        raise InvalidValueError("needs [mean, standard deviation]")
    mean, deviation = _numbers(value)
    if deviation <= 0.0:
        raise InvalidValueError(f"found a deviation of {deviation:g}; needs more than 0")
    return Normal(mean, deviation)


def _values(value: Any) -> Variation:
    given = _several(value)
    if all(isinstance(one, list) for one in given):
        lengths = {len(_numbers(one)) for one in given}
        if len(lengths) != 1 or 0 in lengths:
            raise InvalidValueError("needs lists of one length")
        return Listed(tuple(given), lengths.pop())
    _numbers(given)
    return Listed(tuple(given))


def _choice(value: Any) -> Variation:
    return Listed(tuple(_several(value)))


def _several(value: Any) -> list[Any]:
    if not isinstance(value, list) or not value:
        raise InvalidValueError("is empty; needs a list of at least one value")
    for i, one in enumerate(value):
        if any(one == other and _is_truth(one) is _is_truth(other) for other in value[:i]):
            raise InvalidValueError(f"has {shown(one)} twice; leave one out")
    return value


def _is_truth(value: Any) -> bool:
    """Python has True equal to 1."""
    return isinstance(value, bool)


def _numbers(value: Any) -> list[float]:
    """The list as it is.

    Raises:
        InvalidValueError: not all in it are finite numbers.
    """
    listed = value if isinstance(value, list) else [value]
    for one in listed:
        number = isinstance(one, int | float) and not _is_truth(one)
        if not number or not math.isfinite(one):
            raise InvalidValueError(f"found {shown(one)}; needs numbers")
    return listed


KINDS: dict[str, Callable[[Any], Variation]] = {
    "box": _box, "values": _values, "range": _range, "log": _log, "choice": _choice,
    "normal": _normal,
}  # fmt: skip
