"""What a key of a scenario is varied over, and which points of that a study looks at.

    box: [[0.1, -0.05], [0.2, 0.05]]          numbers between two corners, even; and levels
    range: [0.5, 2.0]                         a number between two, even; a third: so many levels
    log: [0.1, 10]                            the same, even in its logarithm
    normal: [1.0, 0.2]                        mean and standard deviation
    values: [1, 2, 5]                         one of some numbers, or of lists of them
    choice: [quintic, {kind: linear}]         one of anything

A variation maps numbers u of the unit interval, one a dimension, to a value. The points of a study
follow from its seed alone, through scipy.stats.qmc; each is found without the others.
"""

from __future__ import annotations

import math
import types
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, WrapValidator
from scipy.special import ndtri

from coopqp.base.spec import Array
from coopqp.base.wording import shown

LEAST = 2.0**-40  # u of a normal variation is between this and 1 - this
MOST_LEVELS = 1_000_000
MOST = 10_000_000  # points of a study
CORNERS = "needs two corners, [[lows], [highs]], and levels if you like"
#: What the samples' seed is mixed with, so that it gives other numbers than the variants' seeds.
MIXED = 0x5A3B
GRID = "grid"
#: Ways to sample.
SAMPLES = {
    "sobol": "Points of Sobol's sequence, even from the first on; best a power of two.",
    "random": "Points, each by itself.",
    "latin_hypercube": "Points, in each dimension in as many even parts.",
    GRID: "Every level with every other; this many levels where none are said.",
}


class Variation(ABC):
    """What one key is varied over."""

    numbers: int  # of a value that is a list of so many; 0 where it is no list

    @property
    def dimensions(self) -> int:
        """How many numbers of the unit interval make a value."""
        return 1

    def parts(self, value: Any) -> tuple[Any, ...]:
        """The numbers or texts that stand in the columns of a value."""
        return tuple(value) if self.numbers else (value,)

    @abstractmethod
    def at(self, u: Array) -> Any:
        """The value of numbers in [0, 1), shape (dimensions,)."""

    @abstractmethod
    def levels(self, count: int) -> tuple[int, ...]:
        """How many levels a grid has in each dimension; ``count`` where none is said, 0 if none."""

    def gridded(self, levels: Sequence[int]) -> Variation:
        """The same with levels."""
        return self

    @abstractmethod
    def tried(self) -> list[Any]:
        """Values that stand for all, to see whether the key takes them."""


@dataclass(frozen=True)
class Interval:
    """Numbers between two; at levels, which may be whole numbers, if there is a count of them."""

    low: float
    high: float
    count: int = 0
    whole: bool = False

    def at(self, u: float) -> float:
        """The number at u; the nearest level where there are levels."""
        if self.count == 1:
            return self.low
        share = min(int(u * self.count), self.count - 1) / (self.count - 1) if self.count else u
        number = self.low + share * (self.high - self.low)
        return round(number) if self.whole else number


@dataclass(frozen=True)
class Box(Variation):
    """One number, or as many as the corners have; powers of ten if it grows."""

    sides: tuple[Interval, ...]
    numbers: int = 0
    grows: bool = False

    @property
    def dimensions(self) -> int:
        return len(self.sides)

    def at(self, u: Array) -> Any:
        found = [side.at(float(x)) for side, x in zip(self.sides, u, strict=True)]
        if self.grows:
            found = [10.0**x for x in found]
        for i, side in enumerate(self.sides):
            if side.count and not side.whole:
                # Without the rounding of arithmetic: 0.35, where 0.3 + 0.05 is that and 4e-17 more.
                found[i] = float(f"{found[i]:.15g}")
        return found if self.numbers else found[0]

    def levels(self, count: int) -> tuple[int, ...]:
        return tuple(1 if s.low == s.high else s.count or count for s in self.sides)

    def gridded(self, levels: Sequence[int]) -> Box:
        sides = zip(self.sides, levels, strict=True)
        return replace(self, sides=tuple(replace(side, count=n) for side, n in sides))

    def tried(self) -> list[Any]:
        return [self.at(np.full(self.dimensions, u)) for u in (0.0, 0.5, 1.0)]


@dataclass(frozen=True)
class Normal(Variation):
    """A number with a mean and a standard deviation."""

    mean: float
    deviation: float
    numbers: int = 0

    def at(self, u: Array) -> Any:
        return self.mean + self.deviation * float(ndtri(np.clip(u[0], LEAST, 1.0 - LEAST)))

    def levels(self, count: int) -> tuple[int, ...]:
        return (0,)

    def tried(self) -> list[Any]:
        return [self.at(np.full(1, 0.5))]


@dataclass(frozen=True)
class Listed(Variation):
    """One of some values."""

    values: tuple[Any, ...]
    numbers: int = 0

    def at(self, u: Array) -> Any:
        return self.values[min(int(u[0] * len(self.values)), len(self.values) - 1)]

    def levels(self, count: int) -> tuple[int, ...]:
        return (len(self.values),)

    def tried(self) -> list[Any]:
        return list(self.values)


@dataclass(frozen=True)
class Points:
    """Points of the unit cube: of a grid, with its levels, or drawn, shape (count, dimensions)."""

    count: int
    levels: tuple[int, ...]
    drawn: Array

    def at(self, index: int) -> Array:
        """A point, shape (dimensions,); of a grid in the middle of a level's part."""
        if not self.levels:
            point: Array = self.drawn[index]
            return point
        found = np.empty(len(self.levels))
        for k in reversed(range(len(self.levels))):
            index, level = divmod(index, self.levels[k])
            found[k] = (level + 0.5) / self.levels[k]
        return found

    @property
    def digest(self) -> str:
        """A hash; libraries may draw otherwise one day."""
        return sha256(repr(self.levels).encode() + self.drawn.tobytes()).hexdigest()[:16]


def grid(levels: Sequence[int]) -> Points:
    """Every level with every other; the last dimension changes first."""
    return Points(math.prod(levels), tuple(levels), np.zeros((0, 0)))


def drawn(method: str, count: int, dimensions: int, seed: int) -> Points:
    """Points of another way to sample."""
    rng = np.random.default_rng([seed, MIXED])
    if method == "random" or not dimensions:
        return Points(count, (), rng.random((count, dimensions)))
    from scipy.stats import qmc  # workers, who draw nothing, do not wait for it

    sampler = {"sobol": qmc.Sobol, "latin_hypercube": qmc.LatinHypercube}[method]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # counts that are not a power of two; the reader notes it
        return Points(count, (), sampler(dimensions, seed=rng).random(count))


#: A number as it is, so that levels between whole numbers are whole.
Number = Annotated[float, WrapValidator(lambda value, check: (check(value), value)[1])]
Numbers = Annotated[list[Number], Field(min_length=1)]


def needs(test: Callable[[Any], bool], words: str) -> BeforeValidator:
    """Refuse, in words, what does not pass a test."""

    def check(value: Any) -> Any:
        if not test(value):
            raise ValueError(words)
        return value

    return BeforeValidator(check)


def _list(item: Any, least: int, most: int | None, words: str) -> Any:
    """A list of so many."""
    of_item = types.GenericAlias(list, (item,))
    many = needs(lambda x: isinstance(x, list) and least <= len(x) <= (most or len(x)), words)
    return Annotated[of_item, Field(min_length=least, max_length=most), many]


def _box(given: list[Any]) -> Variation:
    low, high, *rest = given
    if not isinstance(low, list) or not isinstance(high, list):
        raise ValueError(CORNERS)
    counts = rest[0] if rest else None
    listed = counts if isinstance(counts, list) else [counts] * len(low)
    if len(low) != len(high):
        raise ValueError(f"needs corners of one length; found {len(low)} and {len(high)}")
    if len(listed) != len(low):
        raise ValueError(f"found {len(listed)} levels; needs {len(low)}, or one for all")
    return Box(tuple(map(_interval, low, high, listed)), len(low))


def _range(given: list[Any]) -> Variation:
    return Box((_interval(*given),))


def _log(given: list[Any]) -> Variation:
    if given[0] <= 0.0:
        raise ValueError(f"found {given[0]:g}; a logarithm needs numbers above 0")
    found = _interval(*given)
    side = Interval(math.log10(found.low), math.log10(found.high), found.count)
    return Box((side,), grows=True)


def _interval(low: Any, high: Any, count: Any = None) -> Interval:
    if low > high:
        raise ValueError(f"is empty: {low:g} to {high:g}; give the least first")
    if count is None:
        return Interval(low, high)
    if not isinstance(count, int) or not 1 <= count <= MOST_LEVELS:
        raise ValueError(f"found {shown(count)} levels; needs a whole number, at least 1")
    if count == 1 and low != high:
        raise ValueError("found 1 level between two numbers; needs at least 2")
    if low == high:
        count = 1
    even = count == 1 or (high - low) % (count - 1) == 0
    return Interval(low, high, count, isinstance(low, int) and isinstance(high, int) and even)


def _normal(given: list[Any]) -> Variation:
    mean, deviation = given
    if deviation <= 0.0:
        raise ValueError(f"found a deviation of {deviation:g}; needs more than 0")
    return Normal(mean, deviation)


def _values(given: list[Any]) -> Variation:
    lengths = {len(one) if isinstance(one, list) else 0 for one in given}
    if len(lengths) != 1:
        raise ValueError("needs numbers, or lists of one length")
    return replace(_choice(given), numbers=lengths.pop())


def _choice(given: list[Any]) -> Listed:
    for i, one in enumerate(given):
        # Python has True equal to 1.
        if any(one == x and isinstance(one, bool) is isinstance(x, bool) for x in given[:i]):
            raise ValueError(f"has {shown(one)} twice; leave one out")
    return Listed(tuple(given))


_ENDS = _list(Number, 2, 3, "needs [least, most], or [least, most, levels]")
_MANY = "is empty; needs a list of at least one value"
#: What stands behind each variation, what makes it of that, and what it means.
KINDS: dict[str, tuple[Any, Callable[[Any], Variation], str]] = {
    "box": (_list(Numbers | Number, 2, 3, CORNERS), _box,
            "Lists of numbers between two corners; a third list, or one number: levels."),
    "values": (_list(Number | Numbers, 1, None, _MANY), _values,
               "These numbers, or these lists of numbers."),
    "range": (_ENDS, _range, "Even between two numbers; a third is the number of levels."),
    "log": (_ENDS, _log, "Even in the logarithm between two numbers above 0; a third: levels."),
    "choice": (_list(Any, 1, None, _MANY), _choice, "These, whatever they are."),
    "normal": (_list(Number, 2, 2, "needs [mean, standard deviation]"), _normal,
               "Mean and standard deviation."),
}  # fmt: skip
