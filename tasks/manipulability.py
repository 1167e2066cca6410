"""The object keeps able to move every way: Yoshikawa's manipulability, with the loops closed.

With J the rows of the object's translation, C = J_rel the loop rows and P = I - C^+ C the joint
motions that keep the loops closed,

    m(q) = sqrt(det(J P J')),   phi = m / m_0,   m_0 = (tr(J P J') / k)^(k/2) at the start

so that phi is 1 where the object starts equally able to move in all k directions and 0 where it
cannot move in one. Beyond phi = ``LARGE``, which a poor start makes possible, its logarithm counts
instead, with the same slope there: climbing m itself in steps would oscillate. The joints climb:

    e = -grad phi,   grad_j m = m tr(G (dJ/dq_j - J C^+ dC/dq_j)),   G = P J' (J P J')^-1

J and C are fixed mixtures of the arms' Jacobians, eq. (30)-(31), whose columns z = (v; w) change as

    dv_k/dq_j = w_j x v_k  if j carries k or is k,   w_k x v_j  if k carries j
    dw_k/dq_j = w_j x w_k  if j carries k

so the gradient is analytic. Where m = 0 it has no gradient; the rows stay finite there. Yoshikawa
1985; gradient projection after Dubey and Luh 1988.
"""

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field
from scipy.linalg import lapack

from coopqp.base.spec import Array, spec
from coopqp.model.closed_chain import AXES, ClosedChain
from coopqp.model.state import State
from coopqp.program import Kind, Primitive
from coopqp.task import Evaluate, Task, TaskRows

Axis = Literal["x", "y", "z"]

ALL: tuple[Axis, ...] = ("x", "y", "z")

#: phi beyond which its logarithm is climbed.
LARGE = 3.0

#: Added to J P J' and C C', as a share of their traces, so that they can be inverted.
REGULAR = 1e-12

_YZX, _ZXY = np.array([1, 2, 0]), np.array([2, 0, 1])


@spec
class Manipulability(Task):
    """Joints keep the object able to move every way, with what the tasks leave free."""

    unit: ClassVar[str] = "1/rad"
    joint_space: ClassVar[bool] = True
    all_joints: ClassVar[bool] = True

    axes: Annotated[tuple[Axis, ...], Field(min_length=1, max_length=3)] = ALL
    """Directions in the world that count; for a planar robot those of its plane."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return chain.joint_names

    def bind(self, start: State) -> Evaluate:
        """The scale m_0 is that of the start."""
        climb = _Climb(start.chain, self._kept)
        m_0 = climb.isotropic(start)

        def evaluate(state: State, rows: TaskRows) -> None:
            m = climb.gradient(state, rows.e)
            np.multiply(rows.e, -1.0 / max(m_0, m / LARGE), rows.e)

        return evaluate

    def program(self, start: State) -> tuple[Primitive, ...]:
        m_0 = _Climb(start.chain, self._kept).isotropic(start)
        return (Primitive(kind=Kind.MANIPULABILITY, rows=tuple(self._kept), length=m_0),)

    @property
    def _kept(self) -> list[int]:
        return [AXES.index(axis) for axis in dict.fromkeys(self.axes)]


class _Climb:
    """The gradient of the manipulability; ``kept`` are the rows of J_task that count."""

    def __init__(self, chain: ClosedChain, kept: list[int]) -> None:
        self._kept, self._arms = np.array(kept), len(chain.arms)
        self._of_J, self._of_C = chain.mixing[kept], chain.mixing[6:]
        self._unmix, self._down, self._up = chain.once(_carrying)

    def isotropic(self, state: State) -> float:
        """(tr(J P J') / k)^(k/2), or 1 where the object cannot move."""
        k = len(self._kept)
        _, J_free, failed = self._project(state)
        mean = float(np.sum(J_free * J_free)) / k
        return 1.0 if failed or mean <= 0.0 else float(mean ** (0.5 * k))

    def gradient(self, state: State, out: Array) -> float:
        """Write grad m, shape (n,), zero where it cannot be computed; and return m."""
        to_loops, J_free, failed = self._project(state)
        factor, G_T, singular = lapack.dposv(_regular(J_free.dot(J_free.T)), J_free)
        if failed or singular:
            out[:] = 0.0
            return 0.0
        m = float(factor.diagonal().prod())
        mixture = self._of_J - to_loops.T.dot(self._of_C)
        n = state.chain.n
        pull = (m * mixture).T.dot(G_T).reshape(self._arms, 2, 3, n)
        J_arms = self._unmix.dot(state.J_ext).reshape(self._arms, 2, 3, n)
        v, w, g, h = J_arms[:, 0], J_arms[:, 1], pull[:, 0], pull[:, 1]
        after = (_cross(v, g) + _cross(w, h)) @ self._down
        before = _cross(g, w) @ self._up
        np.sum(w * after + v * before, axis=(0, 1), out=out)
        return m

    def _project(self, state: State) -> tuple[Array, Array, int]:
        """(J C^+)', J P and whether that failed."""
        J, C = state.J_task[self._kept], state.J_rel
        _, to_loops, failed = lapack.dposv(_regular(C.dot(C.T)), C.dot(J.T))
        return to_loops, J - to_loops.T.dot(C), failed


def _carrying(chain: ClosedChain) -> tuple[Array, Array, Array]:
    """The inverse of the mixing; and by arm which joints carry which, down and up the arm."""
    model = chain.model
    # carries[i, j, k]: arm i has joints j and k, and j is k or nearer to the base.
    carries = np.zeros((len(chain.arms), chain.n, chain.n))
    for i, frame in enumerate(chain.frames):
        joints = list(model.supports[model.frames[frame].parentJoint])[1:]
        columns = [model.idx_vs[joint] for joint in joints]
        carries[np.ix_([i], columns, columns)] = np.triu(np.ones((len(columns),) * 2))
    down = np.ascontiguousarray(carries.transpose(0, 2, 1))
    unmix = np.asarray(np.linalg.inv(chain.mixing), float)
    return unmix, down, carries - carries * np.eye(chain.n)


def _regular(matrix: Array) -> Array:
    """The matrix, in place, with a little more on its diagonal."""
    matrix.flat[:: len(matrix) + 1] += REGULAR * matrix.trace()
    return matrix


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, _YZX] * b[:, _ZXY] - a[:, _ZXY] * b[:, _YZX])
