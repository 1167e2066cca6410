"""A motion of the object as a screw: its axis, a point of it and its pitch, and in words."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from coopqp.checked import Array

#: A rotation of 1 rad counts as much as a translation of this many metres.
LENGTH = 0.1


@dataclass(frozen=True)
class Screw:
    """A twist of the object up to its size.

    Attributes:
        twist: (v; omega) at the object's origin in world axes, shape (6,) [m/s, rad/s].
        axis: unit direction of the screw's axis.
        point: of the axis nearest to the object's origin, in the world [m]; the origin itself for
            a translation.
        pitch: translation per turn [m/rad]; infinite for a translation.
    """

    twist: tuple[float, ...]
    axis: tuple[float, ...]
    point: tuple[float, ...]
    pitch: float

    def words(self) -> str:
        """Such as "rotation about the left axis (y)"."""
        direction = _direction_in_words(np.array(self.axis))
        if math.isinf(self.pitch):
            return f"translation along {direction}"
        at = "({:.3f}, {:.3f}, {:.3f}) m".format(*self.point)
        if abs(self.pitch) < 1e-3 * LENGTH:
            return f"rotation about {direction} through {at}"
        return f"screw about {direction} through {at}, {1e3 * self.pitch:.1f} mm per radian"


def screw_of(twist: Array, origin: Array) -> Screw:
    """The screw of a twist (v; omega) at an origin in world axes."""
    v, omega = twist[:3], twist[3:]
    turn = float(np.linalg.norm(omega))
    if turn * LENGTH < 1e-6 * max(float(np.linalg.norm(v)), 1e-12):
        axis = v / np.linalg.norm(v)
        return Screw(_tuple(twist), _tuple(axis), _tuple(origin), math.inf)
    point = origin + np.cross(omega, v) / turn**2
    return Screw(_tuple(twist), _tuple(omega / turn), _tuple(point), float(omega @ v) / turn**2)


def _direction_in_words(axis: Array) -> str:
    for i, name in enumerate(("x", "y", "z")):
        if abs(abs(axis[i]) - 1.0) < 1e-6:
            return name
    return "({:.3f}, {:.3f}, {:.3f})".format(*axis)


def _tuple(values: Array) -> tuple[float, ...]:
    return tuple(float(x) for x in values)
