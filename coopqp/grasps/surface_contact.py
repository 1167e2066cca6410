"""A grasp that holds by pressing with a flat pad: friction bears the rest, and nothing pulls.

Its cone in closed form, Caron, Pham and Nakamura 2015 (arXiv 1501.04719): with half-lengths X
along x, Y along y, z into the object, every corner bears |f_x| <= m f_z and |f_y| <= m f_z. Their
sums are exactly the wrenches with

    |f_x| <= m f_z,  |f_y| <= m f_z,  |t_x| <= Y f_z,  |t_y| <= X f_z,
    -m(X+Y) f_z + |Y f_x - m t_x| + |X f_y - m t_y| <= t_z
                 <= m(X+Y) f_z - |Y f_x + m t_x| - |X f_y + m t_y|

which are 4 + 4 + 8 rows. m = mu is a square around Coulomb's circle, which allows up to 1.41 mu;
the square inside it has m = mu / sqrt(2).
"""

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from coopqp.base.spec import Array, Positive, spec
from coopqp.grasp import BEYOND, NO_CONTACT, REACH, Contact, PassiveJoint
from coopqp.grasps._families import Pressing

#: From a circle to the square inside it.
INNER = 1.0 / np.sqrt(2.0)
#: Edges of each corner's cone where neither square tells; it loses 1 - cos(pi/16) = 1.9 %.
CORNER_EDGES = 16
#: Relative accuracy of the friction that is needed.
NEAR = 0.005
#: Forces sum up to a wrench where no more than this share of the normal force is left.
SUMS_UP = 1e-6


@dataclass(frozen=True, kw_only=True)
class Pad(Contact):
    """A flat pad; ``torsion`` is its share of the corners' yaw, about 0.5 under even pressure."""

    torsion: float = 1.0

    def rows(self, friction: float) -> Array:
        """The 16 rows with the square inside Coulomb's circle, and 2 where torsion is below 1."""
        X, Y = self.half_lengths
        m = INNER * friction
        rows = pad_rows(m, X, Y)
        if self.torsion < 1.0:
            yaw = self.torsion * m * (X + Y)
            rows = np.vstack([rows, [0, 0, -yaw, 0, 0, 1.0], [0, 0, -yaw, 0, 0, -1.0]])
        return rows

    def edge_use(self, wrench: ArrayLike) -> float:
        w = np.asarray(wrench, float)
        X, Y = self.half_lengths
        return max(abs(w[3]) / Y, abs(w[4]) / X) / float(w[2]) if w[2] > NO_CONTACT else math.nan

    def friction_needed(self, wrench: ArrayLike) -> float:
        """By cones at the corners; a force beyond the edge counts as on it, with the same yaw."""
        w = self._on_the_pad(np.array(wrench, float))
        X, Y = self.half_lengths
        if not w[2] > NO_CONTACT:
            return math.inf
        # On one corner alone the rows compare nothing with nothing: keep off it by rounding.
        w[3:5] *= 1.0 - 2.0 * BEYOND
        # The square around needs the least, and the one inside sqrt(2) of that at most.
        low = max(self._needed(w), float(np.hypot(w[0], w[1]) / w[2]))
        low = max(low, float(abs(w[5]) / (w[2] * np.hypot(X, Y) * self.torsion)))
        high = self._needed(w) / INNER
        if not high - low > NEAR * high + 1e-9:
            return float(max(low, high))
        # Most wrenches need hardly more than the least, which then answers for all above.
        tried = (1.0 + 4.0 * NEAR) * low
        enough = corners_hold(w, self.half_lengths, tried)
        while high - low > NEAR * high + 1e-9:
            middle = 0.5 * (low + high)
            known = (middle >= tried) == enough
            if enough if known else corners_hold(w, self.half_lengths, middle):
                high = middle
            else:
                low = middle
        return float(max(low, high))

    def _on_the_pad(self, w: Array) -> Array:
        """With the normal force no farther out than the edges."""
        X, Y = self.half_lengths
        fx, fy, fz, tx, ty, tz = w.tolist()
        on_x, on_y = float(np.clip(tx, -Y * fz, Y * fz)), float(np.clip(ty, -X * fz, X * fz))
        if fz > NO_CONTACT and (on_x != tx or on_y != ty):
            # Pressure at x = -ty / fz, y = tx / fz: what the friction there makes about the middle.
            tz += ((ty - on_y) * fy + (tx - on_x) * fx) / fz
            return np.array([fx, fy, fz, on_x, on_y, tz])
        return w

    def _needed(self, w: Array) -> float:
        """The least m with which the 16 rows hold, by what they are made of."""
        X, Y = self.half_lengths
        fx, fy, fz, tx, ty, tz = w.tolist()
        need = max(abs(fx), abs(fy)) / fz
        for a, b in itertools.product((1.0, -1.0), repeat=2):
            # a Y fx + b X fy + sign tz <= m ((X + Y) fz - sign (a tx + b ty))
            for sign in (1.0, -1.0):
                margin = (X + Y) * fz - sign * (a * tx + b * ty)
                force = a * Y * fx + b * X * fy + sign * tz
                if force > 0.0:
                    need = max(need, force / margin if margin > 0.0 else np.inf)
        return float(need)


def pad_rows(m: float, X: float, Y: float) -> Array:
    """The 16 rows, shape (16, 6), for half-lengths X, Y [m] and m of the square of forces."""
    rows = []
    for sign in (1.0, -1.0):
        rows += [
            [sign, 0.0, -m, 0.0, 0.0, 0.0],
            [0.0, sign, -m, 0.0, 0.0, 0.0],
            [0.0, 0.0, -Y, sign, 0.0, 0.0],
            [0.0, 0.0, -X, 0.0, sign, 0.0],
        ]
    for a, b in itertools.product((1.0, -1.0), repeat=2):
        rows.append([a * Y, b * X, -m * (X + Y), a * m, b * m, 1.0])
        rows.append([a * Y, b * X, -m * (X + Y), -a * m, -b * m, -1.0])
    return np.array(rows)


def corners_hold(wrench: Array, half: tuple[float, float], friction: float) -> bool:
    """Whether forces at the corners, each in a cone of many edges, sum up to a pressing wrench."""
    from scipy.optimize import nnls  # which takes a quarter of a second to come

    wanted = wrench / wrench[2]
    wanted[3:] /= max(half)
    # Friction stretches what is tangential: forces along x and y, and the yaw that they make.
    stretched = np.array([friction, friction, 1.0, 1.0, 1.0, friction])
    return bool(nnls(stretched[:, None] * _corner_edges(half), wanted)[1] < SUMS_UP)


@lru_cache(maxsize=64)
def _corner_edges(half: tuple[float, float]) -> Array:
    """Wrenches, (6, edges), of all corners' cones for friction 1, torques over max(half)."""
    angles = 2.0 * np.pi * np.arange(CORNER_EDGES) / CORNER_EDGES
    edges = np.array([np.cos(angles), np.sin(angles), np.ones(CORNER_EDGES)])
    X, Y = half
    columns = []
    for x, y in ((X, Y), (X, -Y), (-X, Y), (-X, -Y)):
        torques = np.array([y * edges[2], -x * edges[2], x * edges[1] - y * edges[0]])
        columns.append(np.vstack([edges, torques / max(X, Y)]))
    return np.hstack(columns)


@spec
class SurfaceContact(Pressing):
    """Flat pad: holds by pressing; friction bears what goes along it, and nothing pulls."""

    half_lengths: tuple[Positive, Positive] = (0.03, 0.03)
    """Of the pad [m]."""
    torsion: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    """Share of the corners' yaw that it bears: 1 hard and level, about 0.5 soft."""
    reach: Annotated[float, Field(gt=0.0, le=1.0)] = REACH
    """Share of the half-lengths that controllers count on, so that pressure keeps off the edge."""

    def passive_joints(self, R_WT: Array) -> tuple[PassiveJoint, ...]:
        """None: while it holds, hand and object move as one body."""
        return ()

    @property
    def contact(self) -> Contact:
        return Pad(
            **self.pressed(),
            half_lengths=self.half_lengths,
            reach=self.reach,
            torsion=self.torsion,
        )
