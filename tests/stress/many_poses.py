"""Where a chain is in many configurations at once; written for numpy, without the kernel.

Letters: T configurations, n joints, L closed loops. Rotations are after Rodrigues,

    R(a, x) = a a' + cos(x) (1 - a a') + sin(x) [a]x

so that a joint's frame is one product of its parent's with constants, R_parent P [a a', 1 - a a',
[a]x], whatever T is. Within this file T is the last axis: numpy's inner loops are long then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain
from coopqp.robot import axis_of

Poses = tuple[Array, Array]
"""Rotations, shape (T, 3, 3), and positions, shape (T, 3) [m]."""


def loop_errors(chain: ClosedChain, q: Array) -> tuple[Array, Array]:
    """How far apart the arms carry the object, the worst of the closed loops.

    Args:
        chain: the closed chain, whose joints have one coordinate each.
        q: shape (T, n).

    Returns:
        Positions [m] and angles [rad], each of shape (T,).
    """
    apart, turned = np.zeros((2, len(q)))
    if chain.holding < 2:
        return apart, turned
    (R_0, p_0), *others = carried(chain, q)[: chain.holding]
    for R, p in others:
        apart = np.maximum(apart, np.linalg.norm(p - p_0, axis=1))
        turned = np.maximum(turned, angles(np.einsum("tik,tjk->tij", R, R_0)))
    return apart, turned


def carried(chain: ClosedChain, q: Array) -> list[Poses]:
    """Pose of the object as carried by each arm.

    Args:
        chain: the closed chain, whose joints have one coordinate each.
        q: shape (T, n).
    """
    joints, frames = chain.once(_described)
    world = np.zeros((3, 3, len(q)))
    world[np.arange(3), np.arange(3)] = 1.0
    placed, x = {0: (world, np.zeros((3, len(q))))}, np.ascontiguousarray(q.T)
    for joint in joints:
        placed[joint.j] = _moved(joint, placed[joint.parent], x[joint.j - 1])
    return [
        ((R.T @ placed[parent][0]).transpose(2, 0, 1), _at(placed[parent], p).T)
        for parent, R, p in frames
    ]


def angles(R: Array) -> Array:
    """How far each rotation turns, shape (T,) [rad].

    Args:
        R: shape (T, 3, 3).
    """
    sine = np.linalg.norm(
        [R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=0
    )
    found: Array = np.arctan2(sine, np.trace(R, axis1=1, axis2=2) - 1.0)
    return found


@dataclass(frozen=True)
class _Joint:
    """A joint that moves an arm.

    Attributes:
        j, parent: ids into chain.model.joints; 0 is the world.
        p: where it is in its parent's frame, shape (3,) [m].
        R: its placement's rotation; of a hinge, times a a', 1 - a a' and [a]x, shape (3, 9).
        along: where it slides, in its parent's frame, shape (3,); None for a hinge.
    """

    j: int
    parent: int
    p: Array
    R: Array
    along: Array | None


def _described(chain: ClosedChain) -> tuple[list[_Joint], list[tuple[int, Array, Array]]]:
    """The joints that move arms, and the object's frame as carried by each."""
    model = chain.model
    frames = [model.frames[frame] for frame in chain.frames]
    moving = sorted({j for frame in frames for j in model.supports[frame.parentJoint]} - {0})
    return [_joint(model, j) for j in moving], [
        (int(f.parentJoint), f.placement.rotation.copy(), f.placement.translation.copy())
        for f in frames
    ]


def _joint(model: pin.Model, j: int) -> _Joint:
    S, X = axis_of(model.joints[j]), model.jointPlacements[j]
    assert S is not None
    a, R = S[3:], X.rotation.copy()
    where = j, int(model.parents[j]), X.translation.copy()
    if not a.any():
        return _Joint(*where, R, R @ S[:3])
    along = np.outer(a, a)
    turns = np.hstack([along, np.eye(3) - along, np.asarray(pin.skew(a))])
    return _Joint(*where, R @ turns, None)


def _moved(joint: _Joint, parent: Poses, x: Array) -> Poses:
    """A joint's frame, from its parent's."""
    R, p = joint.R.T @ parent[0], _at(parent, joint.p)
    if joint.along is not None:
        return R, p + x * (joint.along @ parent[0])
    turned = np.cos(x) * R[:, 3:6]
    turned += np.sin(x) * R[:, 6:]
    turned += R[:, :3]
    return turned, p


def _at(X: Poses, p: Array) -> Array:
    """Where a point of each frame is."""
    placed: Array = X[1] + p @ X[0]
    return placed
