"""What force sensors in the hands say, looked at before it is believed."""

from __future__ import annotations

from typing import Any

import numpy as np

from coopqp.base.spec import Array, real
from coopqp.base.wording import said

#: A hand that does more than this to an object is none [N, N m].
MOST = 1e6
NEEDS = "force and torque of each of the robot's arms [N, N m]"


class Felt:
    """The last reading that was looked at.

    Args:
        arms: how many the robot has, N.

    Attributes:
        fault: why it cannot be used; empty if it can.
    """

    def __init__(self, arms: int) -> None:
        self._size, self.fault = 6 * arms, ""

    def read(self, found: Any) -> Array | None:
        """The wrenches by arm, shape (N, 6); None where they cannot be used.

        Args:
            found: ``State.hand_wrench``; anything can come from a driver.
        """
        self.fault = self._wrong(found)
        return None if self.fault else real(found).reshape(-1, 6)

    def _wrong(self, found: Any) -> str:
        if found is None:
            return f"no hand_wrench has come; needs {self._size} numbers: {NEEDS}"
        try:
            given = real(found)
        except Exception as error:  # noqa: BLE001 - anything can come from a driver
            return f"hand_wrench: {said(error) or f'found {type(found).__name__}, needs numbers'}"
        if given.shape != (self._size,):
            return f"hand_wrench: found shape {given.shape}, needs {(self._size,)}: {NEEDS}"
        bad = np.flatnonzero(~np.isfinite(given))
        if len(bad):
            return f"hand_wrench: found no finite number at {', '.join(map(str, bad[:6]))}"
        most = float(np.abs(given).max())
        return "" if most < MOST else f"hand_wrench: found {most:.3g}, which no hand does"
