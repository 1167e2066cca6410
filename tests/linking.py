"""How often two straight arms and what they hold are wound round themselves: a linking number.

The line from a base through the joints to the object, on through the other arm and back below the
floor is closed. The twist of the arms about it and its writhe, in turns, add up to the linking
number of line and arms (Calugareanu 1959): a constant and a whole number, which no motion changes
but one that leads the line through itself, and then by two. Whether it is odd or even is what the
half-angle proof of ``coopqp.planning.reach`` says. That bodies keep the line from itself is another
claim, for which ``nearest`` says how near it comes. Placements are pinocchio's; nothing here is of
``coopqp.planning``.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain

#: What is no length or turn [m, 1].
NOTHING = 1e-6


class Line:
    """The closed line of two arms on a floor, each straight at zero.

    Args:
        chain: of two arms whose joints lie along such an arm or across it.
        depth: of the line's way back below the bases' origins [m].

    Raises:
        ValueError: other arms.
    """

    def __init__(self, chain: ClosedChain, depth: float = 0.1) -> None:
        model = chain.model
        self._chain, self._data, self._depth = chain, model.createData(), depth
        self._twist, self._corners = np.zeros(chain.n), list[list[int]]()  # joints in arms' corners
        pin.framesForwardKinematics(model, self._data, np.zeros(chain.n))
        for frame in chain.frames:
            joints = [j for j in model.supports[model.frames[frame].parentJoint] if j]
            placed = [self._data.oMi[j] for j in joints]
            corners = np.array([X.translation for X in placed])
            up = (corners[-1] - corners[0]) / np.linalg.norm(corners[-1] - corners[0])
            leans = np.array([X.rotation[:, 2] @ up for X in placed])
            hinges = all(model.joints[j].shortname() == "JointModelRZ" for j in joints)
            off = np.abs(np.cross(corners - corners[0], up)).max()
            off = max(off, np.abs(leans * (1.0 - leans**2)).max())
            if len(chain.frames) != 2 or not hinges or off > NOTHING:
                raise ValueError("not two arms, straight at zero, of hinges along or across them")
            self._twist[[model.idx_qs[j] for j in joints]] = leans.round()
            bends = [j for j, x in zip(joints, leans, strict=True) if abs(x) < 0.5]
            self._corners.append(bends if bends[-1] == joints[-1] else [*bends, joints[-1]])

    def corners(self, q: Array) -> Array:
        """Shape (N, 3): from below one base to below the other, where it goes straight back."""
        model, data = self._chain.model, self._data
        pin.framesForwardKinematics(model, data, q)
        found = []
        for joints, frame in zip(self._corners, self._chain.frames, strict=True):
            first = model.jointPlacements[model.supports[joints[0]][1]].translation
            base = first * (1.0, 1.0, 0.0) - (0.0, 0.0, self._depth)
            at = [data.oMi[j].translation for j in joints]
            found.append([base, *at, data.oMf[frame].translation])
        return np.array([*found[0], *found[1][-2::-1]])

    def number(self, q: Array) -> float:
        """The linking number and a constant."""
        return float(self._twist @ q) / (2.0 * np.pi) + writhe(self.corners(q))

    def nearest(self, q: Array) -> float:
        """How near two sides come that have no corner in common [m]."""
        a, b, c, d = _pairs(self.corners(q))
        u, v, w = b - a, d - c, a - c
        uu, uv, vv, uw, vw = (_dot(*x) for x in ((u, u), (u, v), (v, v), (u, w), (v, w)))
        rest = np.maximum(uu * vv - uv * uv, NOTHING**4)
        t = np.clip((uv * np.clip((uv * vw - vv * uw) / rest, 0.0, 1.0) + vw) / vv, 0.0, 1.0)
        s = np.clip((uv * t - uw) / uu, 0.0, 1.0)
        return float(np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=1).min())


def writhe(corners: Array) -> float:
    """Of a closed line of straight sides, (N, 3).

    Over all pairs of sides the share of directions from which they are seen to cross, with the
    crossing's sign (Klenin and Langowski 2000).
    """
    a, b, c, d = _pairs(corners)
    around = [c - a, d - a, d - b, c - b]
    faces = [np.cross(around[k], around[(k + 1) % 4]) for k in range(4)]
    faces = [x / np.maximum(np.linalg.norm(x, axis=1), NOTHING**2)[:, None] for x in faces]
    cosines = np.array([_dot(faces[k], faces[(k + 1) % 4]) for k in range(4)])
    seen = np.arcsin(np.clip(cosines, -1.0, 1.0)).sum(axis=0)
    side = _dot(np.cross(d - c, b - a), c - a)
    side[np.abs(side) < NOTHING**2] = 0.0  # in a plane
    return float(np.sign(side) @ seen) / (2.0 * np.pi)


def _pairs(corners: Array) -> list[Array]:
    """Ends of each two sides of a closed line that have no corner in common, shape (P, 3) each."""
    n, ends = len(corners), np.roll(corners, -1, axis=0)
    found = [(i, k) for i in range(n) for k in range(i + 2, n) if (i, k) != (0, n - 1)]
    i, k = np.array(found).T
    return [corners[i], ends[i], corners[k], ends[k]]


def _dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=1), float)
