r"""Closed configurations between which there is no motion that keeps the loops closed.

A rotation by w has two lifts to SU(2), +-U with :math:`U = \cos(|w|/2) I - i \sin(|w|/2) w\cdot
\sigma / |w|`, and the product of such U of an arm's joints, at half their angles, is a continuous
function of q. Where a loop is closed, the lifts of the object's attitude by arm i and by arm 0 are
equal or opposite. Closed all the way, they stay what they are: a hand that has turned once round
against another is on another part of the closed configurations, and only joint by joint, not by
closed loops, one gets from one part to the other (the plate trick; SO(3) is not simply connected).
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain
from coopqp.robot import axis_of

#: Why no motion leads from one part to another, for sentences.
CUT_OFF = (
    "from the start's joint angles to such ones a hand turns once round against another, which "
    "closed loops never let it"
)

_PAULI = np.array([[[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]]])


def parts(chain: ClosedChain, q: Array) -> NDArray[np.int_]:
    """Of closed configurations (N, n) the sign of each arm's lift against the first arm's.

    Shape (N, arms - 1); equal rows may be connected by a motion, others never are.
    """
    first, *rest = (_lifted(chain, frame, q) for frame in chain.frames[: chain.holding])
    signs = [np.sign(np.einsum("nab,nab->n", first.conj(), lift).real) for lift in rest]
    return np.array(signs, int).reshape(len(rest), len(q)).T


def cut_off(chain: ClosedChain, q: Array) -> NDArray[np.bool_]:
    """Of closed configurations (N, n), to which ones no motion leads from the start."""
    found = parts(chain, np.vstack([chain.q_start, q]))
    return np.asarray((found[1:] != found[0]).any(axis=1))


def _lifted(chain: ClosedChain, frame: int, q: Array) -> NDArray[np.complex128]:
    """The lift of a frame's attitude at each row of q, shape (N, 2, 2)."""
    model, placement = chain.model, chain.model.frames[frame].placement
    found = np.tile(np.eye(2, dtype=complex), (len(q), 1, 1))
    for j in model.supports[model.frames[frame].parentJoint]:
        axis = axis_of(model.joints[j]) if j else None
        if axis is not None:
            fixed = _lift(pin.log3(model.jointPlacements[j].rotation)[None])
            found = found @ fixed @ _lift(q[:, model.idx_qs[j], None] * axis[3:])
    return np.asarray(found @ _lift(pin.log3(placement.rotation)[None]))


def _lift(w: Array) -> NDArray[np.complex128]:
    half = 0.5 * np.linalg.norm(w, axis=1)[:, None, None]
    turned = np.sinc(half / np.pi) * np.einsum("nk,kab->nab", w, _PAULI)
    return np.asarray(np.cos(half) * np.eye(2) - 0.5j * turned)
