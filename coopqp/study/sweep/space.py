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
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, WrapValidator
from scipy.special import ndtri

from coopqp.base.spec import Array
from coopqp.base.wording import shown

MIN_U = 2.0**-40  # u of a normal variation is between this and 1 - this
MAX_LEVELS = 1_000_000
MAX_POINTS = 10_000_000  # points of a study
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


@dataclass(frozen=True)
class Interval:
    """Numbers between two, powers of ten if it grows; at levels if there is a count of them."""

    low: float
    high: float
    count: int = 0
    whole: bool = False  # whether they are whole numbers
    grows: bool = False
    tries = (0.0, 0.5, 1.0)

    def at(self, u: float) -> float:
        share = min(int(u * self.count), self.count - 1) / (self.count - 1) if self.count > 1 else u
        number = self.low + share * (self.high - self.low)
        if self.whole:
            return round(number)
        number = 10.0**number if self.grows else number
        # Levels without the rounding of arithmetic: 0.35, where 0.3 + 0.05 is that and 4e-17 more.
        return float(f"{number:.15g}") if self.count else number

    def levels(self, count: int) -> int:
        return 1 if self.low == self.high else self.count or count


@dataclass(frozen=True)
class Normal:
    """A number with a mean and a standard deviation."""

    mean: float
    deviation: float
    tries = (0.5,)

    def at(self, u: float) -> float:
        return self.mean + self.deviation * float(ndtri(np.clip(u, MIN_U, 1.0 - MIN_U)))

    def levels(self, count: int) -> int:
        return 0


@dataclass(frozen=True)
class Listed:
    """One of some values."""

    values: tuple[Any, ...]

    @property
    def tries(self) -> list[float]:
        return [(i + 0.5) / len(self.values) for i in range(len(self.values))]

    def at(self, u: float) -> Any:
        return self.values[min(int(u * len(self.values)), len(self.values) - 1)]

    def levels(self, count: int) -> int:
        return len(self.values)


@dataclass(frozen=True)
class Variation:
    """What one key is varied over: what stands on each side makes a number, or else a value.

    Of a side ``at`` is the value of a number u in [0, 1), ``tries`` are those that stand for all,
    and ``levels`` how many a grid has there; ``count`` where none is said, 0 if none.
    """

    sides: tuple[Interval | Normal | Listed, ...]
    numbers: int = 0  # of a value that is a list of so many; 0 where it is no list

    @property
    def values(self) -> tuple[Any, ...] | None:
        """Those that are listed; None where none are."""
        return self.sides[0].values if isinstance(self.sides[0], Listed) else None

    def parts(self, value: Any) -> tuple[Any, ...]:
        """The numbers or texts that stand in the columns of a value."""
        return tuple(value) if self.numbers else (value,)

    def at(self, u: Array) -> Any:
        """The value of numbers in [0, 1), one for each side."""
        found = [side.at(float(x)) for side, x in zip(self.sides, u, strict=True)]
        return found if self.numbers and self.values is None else found[0]

    def levels(self, count: int) -> tuple[int, ...]:
        """How many levels a grid has on each side."""
        return tuple(side.levels(count) for side in self.sides)

    def gridded(self, levels: Sequence[int]) -> Variation:
        sides = (
            replace(side, count=count) if isinstance(side, Interval) else side
            for side, count in zip(self.sides, levels, strict=True)
        )
        return replace(self, sides=tuple(sides))

    def tried(self) -> list[Any]:
        """Values that stand for all, to see whether the key takes them."""
        return [self.at(np.full(len(self.sides), u)) for u in self.sides[0].tries]


@dataclass(frozen=True)
class Points:
    """Points of the unit cube: of a grid, with its levels, or drawn, shape (count, dimensions).

    Of a grid every level comes with every other; the last dimension changes first.
    """

    count: int
    levels: tuple[int, ...] = ()
    drawn: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def at(self, index: int) -> Array:
        """A point, shape (dimensions,); of a grid in the middle of a level's part."""
        if not self.levels:
            point: Array = self.drawn[index]
            return point
        level = np.array(np.unravel_index(index, self.levels))
        return np.asarray((level + 0.5) / self.levels, float)

    @property
    def digest(self) -> str:
        """A hash; libraries may draw otherwise one day."""
        return sha256(repr(self.levels).encode() + self.drawn.tobytes()).hexdigest()[:16]


def drawn(method: str, count: int, dimensions: int, seed: int) -> Points:
    """Points of another way to sample."""
    rng = np.random.default_rng([seed, MIXED])
    if method == "random" or not dimensions:
        return Points(count, drawn=rng.random((count, dimensions)))
    from scipy.stats import qmc  # workers, who draw nothing, do not wait for it

    sampler = {"sobol": qmc.Sobol, "latin_hypercube": qmc.LatinHypercube}[method]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # counts that are not a power of two; the reader notes it
        return Points(count, drawn=sampler(dimensions, seed=rng).random(count))


#: A number as it is, so that levels between whole numbers are whole.
Number = Annotated[float, WrapValidator(lambda value, check: (check(value), value)[1])]
Numbers = Annotated[list[Number], Field(min_length=1)]


def needs(test: Callable[[Any], bool], message: str) -> BeforeValidator:
    """Refuse, in words, what does not pass a test."""

    def check(value: Any) -> Any:
        if not test(value):
            raise ValueError(message)
        return value

    return BeforeValidator(check)


def _list(item: Any, lower: int, upper: int | None, message: str) -> Any:
    of_item = types.GenericAlias(list, (item,))
    many = needs(lambda x: isinstance(x, list) and lower <= len(x) <= (upper or len(x)), message)
    return Annotated[of_item, Field(min_length=lower, max_length=upper), many]


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
    return Variation(tuple(map(_interval, low, high, listed)), len(low))


def _range(given: list[Any]) -> Variation:
    return Variation((_interval(*given),))


def _log(given: list[Any]) -> Variation:
    if given[0] <= 0.0:
        raise ValueError(f"found {given[0]:g}; a logarithm needs numbers above 0")
    found = _interval(*given)
    side = Interval(math.log10(found.low), math.log10(found.high), found.count, grows=True)
    return Variation((side,))


def _interval(low: Any, high: Any, count: Any = None) -> Interval:
    if low > high:
        raise ValueError(f"is empty: {low:g} to {high:g}; give the least first")
    if count is None:
        return Interval(low, high)
    if not isinstance(count, int) or not 1 <= count <= MAX_LEVELS:
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
    return Variation((Normal(mean, deviation),))


def _values(given: list[Any]) -> Variation:
    lengths = {len(one) if isinstance(one, list) else 0 for one in given}
    if len(lengths) != 1:
        raise ValueError("needs numbers, or lists of one length")
    return replace(_choice(given), numbers=lengths.pop())


def _choice(given: list[Any]) -> Variation:
    for i, one in enumerate(given):
        # Python has True equal to 1.
        if any(one == x and isinstance(one, bool) is isinstance(x, bool) for x in given[:i]):
            raise ValueError(f"has {shown(one)} twice; leave one out")
    return Variation((Listed(tuple(given)),))


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
