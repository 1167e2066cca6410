"""Attitudes that two arms of five joints can give an object whose point is at a goal.

The half-angle proof says that two configurations are in different parts; that *no* configuration at
a goal is in the start's part is another claim, which random starts cannot prove. Here all of an
arm's configurations are written down: with its third and fifth joint on a grid, the elbow follows
from how far the goal is from the shoulder and the shoulder from where it is, in closed form. An
attitude is the unit quaternion that goes on continuously with the joints, so that an arm's
attitudes are a surface on the sphere S^3; loops close where the surfaces of both arms meet, in the
start's part, or where one meets the other's opposite, in the other. A grid is no proof: between
its points an attitude turns by any angle where an elbow is stretched. Placements are pinocchio's;
nothing here is of ``coopqp.planning``.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.spatial import KDTree

from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain

#: Points of the grid for each of two joints; limits are wider by this, so that nothing that lies
#: just inside falls through the grid [rad].
GRID, WIDER = 200, 0.1
#: Surfaces that are farther apart than this do not meet, those that are nearer do [rad].
APART, MEET = 0.5, 0.03


class Arm:
    """An arm of five hinges about their z; shoulder and elbow are two joints at one place each.

    Raises:
        ValueError: it is another arm.
    """

    def __init__(self, chain: ClosedChain, frame: int) -> None:
        model, held = chain.model, chain.model.frames[frame]
        joints = [j for j in model.supports[held.parentJoint] if j]
        self.placed = [model.jointPlacements[j] for j in joints] + [held.placement]
        met = len(joints) == 5 and not any(self.placed[k].translation.any() for k in (1, 3))
        if not met or any(model.joints[j].shortname() != "JointModelRZ" for j in joints):
            raise ValueError("not an arm of five hinges with a shoulder and an elbow of two each")
        self.columns = [model.idx_qs[j] for j in joints]
        self.lower, self.upper = (x[self.columns] for x in (chain.lower, chain.upper))

    def configurations(self, goal: Array) -> Array:
        """Those on the grid, shape (N, 5), that have the object's point at the goal."""
        first, second, third, fourth, fifth, held = self.placed
        low, high = self.lower - WIDER, self.upper + WIDER
        grids = (np.linspace(low[j], high[j], GRID) for j in (2, 4))
        q3, q5 = (x.ravel() for x in np.meshgrid(*grids))
        d, upper_arm = first.actInv(goal), third.translation
        forearm = _turned(q5, held.translation) @ fifth.rotation.T + fifth.translation
        back = _turned(-q3, third.rotation.T @ upper_arm) @ fourth.rotation
        away = 0.5 * (d @ d - upper_arm @ upper_arm - (forearm**2).sum(1))
        found = []
        for q4 in _turns(forearm, back, away):
            bent = _turned(q3, _turned(q4, forearm) @ fourth.rotation.T) @ third.rotation.T
            v = bent + upper_arm
            for q2 in _turns(v, np.broadcast_to(second.rotation[2], v.shape), d[2]):
                y = _turned(q2, v) @ second.rotation.T
                q1 = np.arctan2(d[1], d[0]) - np.arctan2(y[:, 1], y[:, 0])
                q = np.column_stack([(q1 + np.pi) % (2.0 * np.pi) - np.pi, q2, q3, q4, q5])
                found.append(q[((q >= low) & (q <= high)).all(axis=1)])
        return np.concatenate(found)

    def attitudes(self, q: Array) -> Array:
        """The quaternions, continuous in q (N, 5), shape (N, 4)."""
        found = np.tile(_quaternion(self.placed[0].rotation), (len(q), 1))
        for angle, placed in zip(q.T, self.placed[1:], strict=True):
            turn = np.zeros((len(q), 4))
            turn[:, 2], turn[:, 3] = np.sin(0.5 * angle), np.cos(0.5 * angle)
            found = _product(_product(found, turn), _quaternion(placed.rotation)[None])
        return found


def nearest(chain: ClosedChain, goal: Array) -> tuple[float, float]:
    """How near the attitudes of both arms come to each other [rad].

    In the start's part, and in the other.
    """
    a, b = (Arm(chain, frame) for frame in chain.frames)
    start = [arm.attitudes(chain.q_start[None, arm.columns])[0] for arm in (a, b)]
    side = np.sign(start[0] @ start[1])
    of_a, of_b = (arm.attitudes(arm.configurations(goal)) for arm in (a, b))
    tree = KDTree(of_b)
    least = (tree.query(sign * side * of_a)[0].min() for sign in (1.0, -1.0))
    same, other = (float(4.0 * np.arcsin(min(0.5 * chord, 1.0))) for chord in least)
    return same, other


def is_cut_off(chain: ClosedChain, goal: Array) -> bool:
    """Whether loops close there, but not in the start's part; False for arms of another kind."""
    try:
        same, other = nearest(chain, goal)
    except ValueError:
        return False
    return same > APART and other < MEET


def _turns(v: Array, b: Array, along: Array | float) -> list[Array]:
    """The two angles about z by which v turned has this product with b; NaN where none has."""
    cosine, sine = (b[:, :2] * v[:, :2]).sum(1), b[:, 1] * v[:, 0] - b[:, 0] * v[:, 1]
    with np.errstate(invalid="ignore"):
        away = np.arccos((along - b[:, 2] * v[:, 2]) / np.hypot(cosine, sine))
    angles = np.arctan2(sine, cosine) + np.array([away, -away])
    return list((angles + np.pi) % (2.0 * np.pi) - np.pi)


def _turned(angle: Array, v: Array) -> Array:
    """Each v turned about z."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = np.broadcast_to(v, (len(angle), 3)).T
    return np.column_stack([c * x - s * y, s * x + c * y, z])


def _quaternion(R: Array) -> Array:
    return np.array(pin.Quaternion(R).coeffs())


def _product(a: Array, b: Array) -> Array:
    """Of quaternions x, y, z, w."""
    w = a[:, 3] * b[:, 3] - (a[:, :3] * b[:, :3]).sum(1)
    xyz = a[:, 3:] * b[:, :3] + b[:, 3:] * a[:, :3] + np.cross(a[:, :3], b[:, :3])
    return np.column_stack([xyz, w])
