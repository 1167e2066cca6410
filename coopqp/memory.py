"""What a law remembers from tick to tick."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np

from coopqp.checked import Array


class Memory:
    """What a law remembers from tick to tick, by name, in one array that can be recorded.

    Args:
        sizes: how many numbers go by each name.

    Attributes:
        numbers: all of them, zero at first.
    """

    def __init__(self, sizes: Mapping[str, int]) -> None:
        self.sizes = dict(sizes)
        ends = list(itertools.accumulate(self.sizes.values(), initial=0))
        self.numbers = np.zeros(ends[-1])
        self._of = {
            name: self.numbers[a:b]
            for name, (a, b) in zip(self.sizes, itertools.pairwise(ends), strict=True)
        }

    def __reduce__(self) -> tuple[Any, ...]:
        # Copies of views are no views: a copy is made anew.
        return _memory, (self.sizes, self.numbers)

    def __getitem__(self, name: str) -> Array:
        """The numbers of one name; a view, to be written to."""
        return self._of[name]


def _memory(sizes: Mapping[str, int], numbers: Array) -> Memory:
    """A memory from what a copy is made of."""
    memory = Memory(sizes)
    memory.numbers[:] = numbers
    return memory
