"""What a limit is: bounds on v, and inequality rows G v <= h, that hold whatever the tasks want."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from coopqp.closed_chain import ClosedChain
from coopqp.spec import spec
from coopqp.state import State

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LimitRows:
    """Where a limit writes; bounds are tightened, never widened.

    Attributes:
        lb, ub: bounds on v, shape (n,) [rad/s, m/s].
        G, h: this limit's own inequality rows, shapes (p, n) and (p,).
    """

    lb: Array
    ub: Array
    G: Array
    h: Array


Tighten = Callable[[State, LimitRows], None]


@spec
class Limit:
    """A plug-in in ``limits/``: a hard bound on the motion."""

    constant: ClassVar[bool] = False
    """Whether the bounds are the same in every tick, so that they are asked for once."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """A name for each inequality row beside the bounds; none for most limits."""
        return ()

    @abstractmethod
    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        """Return the function that tightens the bounds each tick.

        Args:
            chain: what is limited.
            dt: control period [s].
        """
        raise NotImplementedError
