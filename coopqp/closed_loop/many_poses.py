"""Where a chain is in many configurations at once; written for numpy, without the kernel.

Letters: T configurations, n joints, L closed loops. Rotations are after Rodrigues,

    R(a, x) = a a' + cos(x) (1 - a a') + sin(x) [a]x
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
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
        turned = np.maximum(turned, angles(R @ R_0.transpose(0, 2, 1)))
    return apart, turned


def carried(chain: ClosedChain, q: Array) -> list[Poses]:
    """Pose of the object as carried by each arm.

    Args:
        chain: the closed chain, whose joints have one coordinate each.
        q: shape (T, n).
    """
    model, joints = chain.model, {0: _fixed(pin.SE3.Identity(), len(q))}
    frames = [model.frames[frame] for frame in chain.frames]
    for j in sorted({j for frame in frames for j in model.supports[frame.parentJoint]} - {0}):
        joints[j] = _moved(model, j, joints[int(model.parents[j])], q[:, j - 1])
    return [
        _product(joints[frame.parentJoint], _fixed(frame.placement, len(q))) for frame in frames
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


def _moved(model: pin.Model, j: int, parent: Poses, x: Array) -> Poses:
    """A joint's frame, from its parent's."""
    S = axis_of(model.joints[j])
    assert S is not None
    a = S[3:]
    along, skew = np.outer(a, a), np.asarray(pin.skew(a))
    turn = np.cos(x)[:, None, None] * (np.eye(3) - along) + np.sin(x)[:, None, None] * skew + along
    at = _product(parent, _fixed(model.jointPlacements[j], len(x)))
    return _product(at, (turn if a.any() else np.eye(3)[None], x[:, None] * S[:3]))


def _product(A: Poses, B: Poses) -> Poses:
    return A[0] @ B[0], A[1] + (A[0] @ B[1][:, :, None])[:, :, 0]


def _fixed(X: pin.SE3, count: int) -> Poses:
    """One pose that all configurations share."""
    return X.rotation[None], np.broadcast_to(X.translation, (count, 3))
