"""What no signal can ask for: where, and as fast as, nothing is that arms hold."""

from __future__ import annotations

import numpy as np

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import FARTHEST, Array

#: Nothing that arms hold, and none of their joints, is faster [m/s, rad/s].
FASTEST = 1e3


def check_places(key: str, numbers: Array) -> None:
    """InvalidValueError: a number (none of a quaternion) is beyond what any place can be."""
    most = float(np.abs(numbers).max(initial=0.0))
    if most > FARTHEST:
        words = f"found {most:g}, needs at most {FARTHEST:g} (metres, radians; of forces N)"
        raise InvalidValueError(f"{key}: {words}")


def check_speed(key: str, speed: float) -> None:
    """InvalidValueError: a speed [m/s, rad/s, N/s] is beyond that of any arm."""
    if speed > FASTEST:
        words = f"goes at {speed:.3g} m/s (rad/s; of forces N/s), needs at most {FASTEST:g}"
        raise InvalidValueError(f"{key}: {words}; times are seconds")
