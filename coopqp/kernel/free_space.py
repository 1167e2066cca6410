"""Distances of a robot's bodies at given configurations, compiled; several threads may ask."""

from collections.abc import Iterable
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopqp.base.spec import Array
from coopqp.kernel import native
from coopqp.kernel.flat import flat_distances, flat_model
from coopqp.limit import DistanceBounds, Program
from coopqp.model.closed_chain import ClosedChain


class Told(IntEnum):
    """What is said of a pair, as in ``core/gjk.hpp``."""

    MEASURED = 0
    BEYOND = 1
    WITHIN = 2
    INSIDE = 3  # not proved


class FreeSpace:
    """Whether configurations keep the distances of limits: self-collision, things in the world.

    ``programs`` of limits that keep no distances are left out; pairs are numbered through, limit
    after limit. It asks for a compiled kernel, and joints that are hinges or slides
    (``flat_model(chain) is not None``). ``compiled`` is what the kernel has of it.
    """

    def __init__(self, chain: ClosedChain, programs: Iterable[Program | None]) -> None:
        kept = [program for program in programs if isinstance(program, DistanceBounds)]
        self._pairs, self._n = sum(len(each.pairs) for each in kept), chain.n
        found = native.module()
        assert found is not None
        flat = [flat_distances(chain, each) for each in kept]
        self.compiled: Any = found.FreeSpace({"model": chain.once(flat_model), "distances": flat})

    def is_free(self, q: Array) -> NDArray[np.bool_]:
        """Whether each row of q (N, n) is proved to keep all distances; without the GIL."""
        free = np.zeros(len(q), np.uint8)
        self.compiled.is_free(np.ascontiguousarray(q, float), free)
        return free.view(np.bool_)

    def measure(self, q: Array) -> Array:
        """Of each pair at q, shape (p, 9).

        What is told, the distance, by how much it may be smaller [m], the nearest point of the
        first body (3) and the unit normal towards the second one (3), in the world.
        """
        found = np.zeros((self._pairs, 9))
        self.compiled.measure(np.ascontiguousarray(q, float), found)
        return found
