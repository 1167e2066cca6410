"""A motion of the object as a screw: its axis, a point of it and its pitch, and in words."""

import math
from dataclasses import dataclass

import numpy as np

from coopqp.base.spec import Array

#: A rotation of 1 rad counts as much as a translation of this many metres.
LENGTH = 0.1
#: Singular values below count as zero: starts are typed with four digits, and files round pi
#: [m or rad for a unit of joint motion].
MOTION_TOLERANCE = 1e-5
#: A screw that turns the object by less than this, for a translation of as much, is nearly a
#: translation; its axis is more than half a metre away.
LITTLE = 0.2
#: A wrench with less torque than this along its force is a force [N mm for a newton].
MAX_PITCH = 0.5
#: What people who stand behind the robot call its axes, and how near to one a direction must be.
PEOPLE, NEARLY = {"x": "forward (x)", "y": "sideways (y)", "z": "up (z)"}, 0.99


@dataclass(frozen=True)
class Screw:
    """A twist of the object up to its size."""

    # (v; omega) at the object's origin in world axes, shape (6,) [m/s, rad/s]
    twist: tuple[float, ...]
    axis: tuple[float, ...]  # unit direction of the screw's axis
    # of the axis nearest to the object's origin [m]; the origin for a translation
    point: tuple[float, ...]
    pitch: float  # translation per turn [m/rad]; infinite for a translation

    def describe(self) -> str:
        """Such as "rotation about y through (0.300, 0.000, 0.200) m"."""
        direction = axis_name(np.array(self.axis))
        if math.isinf(self.pitch):
            return f"translation along {direction}"
        v, turn = np.array(self.twist[:3]), float(np.linalg.norm(self.twist[3:]))
        far = float(np.linalg.norm(v))
        if turn * LENGTH < LITTLE * far:
            way = axis_name(v / far, NEARLY)
            angle = np.degrees(turn / far * LENGTH)
            return (
                f"{PEOPLE.get(way, f'translation along {way}')}, with a little turning about "
                f"{axis_name(np.array(self.axis), NEARLY)} ({angle:.2g} degrees per "
                f"{1e3 * LENGTH:.0f} mm)"
            )
        at = f"{numbers(np.array(self.point))} m"
        if abs(self.pitch) < 1e-3 * LENGTH:
            return f"rotation about {direction} through {at}"
        return f"screw about {direction} through {at}, {1e3 * self.pitch:.1f} mm per radian"

    def describe_force(self) -> str:
        """As a wrench, such as "force along x through (0.000, 0.000, 0.200) m"."""
        direction = axis_name(np.array(self.axis))
        if math.isinf(self.pitch):
            return f"torque about {direction}"
        line = f"force along {direction} through {numbers(np.array(self.point))} m"
        turning = 1e3 * self.pitch
        return line if abs(turning) < MAX_PITCH else f"{line}, with {turning:.0f} N mm a newton"


def screw_of(twist: Array, origin: Array) -> Screw:
    """The screw of a twist (v; omega) at an origin in world axes."""
    v, omega = twist[:3], twist[3:]
    turn, pitch = float(np.linalg.norm(omega)), math.inf
    if turn * LENGTH < 1e-6 * max(float(np.linalg.norm(v)), 1e-12):
        axis, point = v / np.linalg.norm(v), origin
    else:
        axis, point = omega / turn, origin + np.cross(omega, v) / turn**2
        pitch = float(omega @ v) / turn**2
    return Screw(tuple(twist.tolist()), tuple(axis.tolist()), tuple(point.tolist()), pitch)


def scaled(rows: Array, length: float = LENGTH) -> Array:
    """Every second three rows times a length: rotations as lengths, or torques as forces."""
    factors = np.tile(np.repeat([1.0, length], 3), len(rows) // 6)
    return np.asarray(rows * factors[:, None], float)


def rank_of(rows: Array) -> int:
    """Rank of scaled rows by ``MOTION_TOLERANCE``."""
    return int(np.linalg.matrix_rank(rows, tol=MOTION_TOLERANCE)) if rows.size else 0


def axis_name(direction: Array, min_part: float = 1.0 - 1e-6) -> str:
    """The axis along which a direction has at least this part, or its numbers."""
    for i, name in enumerate(("x", "y", "z")):
        if abs(direction[i]) >= min_part:
            return name
    return numbers(direction)


def numbers(values: Array) -> str:
    """Three numbers in brackets."""
    return "({:.3f}, {:.3f}, {:.3f})".format(*(np.round(values, 3) + 0.0))
