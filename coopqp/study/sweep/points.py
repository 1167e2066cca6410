"""Which points of the unit cube a study looks at; each is found without the others.

sobol            Sobol's sequence, scrambled: even from the first point on
latin_hypercube  each dimension in as many even parts as there are points
random           each point by itself
grid             every level with every other

The points of a study follow from its seed alone, through scipy.stats.qmc.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256

import numpy as np

from coopqp.base.spec import Array

MOST = 10_000_000  # points of a study
METHODS = ("sobol", "random", "latin_hypercube")
#: What the samples' seed is mixed with, so that it gives other numbers than the variants' seeds.
SAMPLES = 0x5A3B


@dataclass(frozen=True)
class Points:
    """Points of the unit cube.

    Attributes:
        levels: of a grid, in each dimension; empty for others.
        drawn: of the others, shape (count, dimensions); empty for a grid.
    """

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
    """Points of one of the other methods."""
    rng = np.random.default_rng([seed, SAMPLES])
    if dimensions == 0:
        return Points(count, (), np.zeros((count, 0)))
    if method == "random":
        return Points(count, (), rng.random((count, dimensions)))
    from scipy.stats import qmc  # workers, who draw nothing, do not wait for it

    sampler = {"sobol": qmc.Sobol, "latin_hypercube": qmc.LatinHypercube}[method]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # counts that are no power of two; the reader notes it
        return Points(count, (), sampler(dimensions, seed=rng).random(count))
