"""Times stamped by ROS's clock, as times by the loop's.

ROS stamps by the system's clock, which can be set, or by a simulator's; the loop's never goes back.
Two readings of the one around a reading of the other bound the offset between them. It is kept as
long as it is within these bounds, so that times keep their order and distances, and follows a clock
that was set.
"""

from __future__ import annotations

import math
from collections.abc import Callable

#: Nanoseconds in a second.
NS = 1_000_000_000


class Clocks:
    """Two clocks.

    Args:
        stamping: that of the stamps [ns].
        own: the loop's [s].
    """

    def __init__(self, stamping: Callable[[], int], own: Callable[[], float]) -> None:
        self._stamping, self._own = stamping, own
        self._offset = -math.inf
        self.compare()

    def compare(self) -> None:
        """Look at both."""
        before, there, after = self._own(), self._stamping() / NS, self._own()
        self._offset = min(max(self._offset, before - there), after - there)

    def own(self, stamp: object) -> float | None:
        """A stamp by the loop's clock [s]; None where nothing is stamped, which is time zero.

        Args:
            stamp: as in a header.
        """
        ns = int(stamp.sec) * NS + int(stamp.nanosec)  # type: ignore[attr-defined]
        return ns / NS + self._offset if ns else None
