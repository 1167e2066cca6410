"""Kinematic constraint equations: section 3.1 and 3.3 of the paper, for any choice of joints.

The joints are split into actuated (a), passive (p) and, one a loop, cut (c) ones. Written in the
cut joint's own frame, its column is a unit vector: one row holds it and the others do not, eq. (8),

    [G_a  G_p  0 ] [v_a]                  G   = -G_p^-1 G_a                          eq. (10)-(11)
    [G_ac G_pc G_c] [v_p] = 0,            v_c = -G_c^-1 (G_ac + G_pc G) v_a          eq. (12)
                    [v_c]
    J_a = J_i [I; G; ...]                 the object's Jacobian from either arm      eq. (17)-(19)
    a_p = G a_a - G_p^-1 (Jdot_c v)       and likewise for a_c                       eq. (13)

"Passive" here means not chosen as independent; a motor may still sit there.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError, require_known
from coopqp.base.rank import independent_rows
from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain

#: Condition number of G_p beyond which a scheme counts as singular.
SINGULAR_CONDITION = 1e8


@dataclass(frozen=True)
class ConstraintEquations:
    """The constraint equations of one choice of joints at one state."""

    actuated: tuple[int, ...]  # indices of joints, as are the next two
    passive: tuple[int, ...]
    cut: tuple[int, ...]
    G: Array  # v_p = G v_a, shape (p, f); NaN when the scheme is singular
    G_cut: Array  # v_c = G_cut v_a, shape (L, f)
    motion: Array  # all joint velocities from the actuated ones, v = motion v_a, shape (n, f)
    J_a: Array  # object twist from v_a by each arm, shape (N, 6, f) [m/rad, 1]; all N agree
    drift: Array  # what Jdot_c v adds to the accelerations, a = motion a_a + drift, shape (n,)
    condition: float  # of the block that is inverted; beyond 1e8 the scheme is singular here

    @property
    def singular(self) -> bool:
        """Whether the actuated joints cannot be chosen freely here."""
        return not self.condition < SINGULAR_CONDITION


def constraint_equations(
    chain: ClosedChain, q: Array, v: Array, *, actuated: Sequence[str], cut: Sequence[str] = ()
) -> ConstraintEquations:
    """Equations (8)-(13) and (17)-(19) at a state with closed loops, q and v of shape (n,).

    v may be zero where ``drift`` is not needed. ``actuated`` names the independent joints, as many
    as there are degrees of freedom, and ``cut`` the joint at which each loop is cut: the last of
    each arm but the first if omitted.

    UnknownNameError, InvalidValueError: the choice is no scheme of this chain.
    """
    a, c = scheme(chain, actuated), _cut_joints(chain, cut, actuated)
    p = tuple(i for i in range(chain.n) if i not in a and i not in c)
    J, Jdot_v, J_arms = _rows_in_cut_frames(chain, q, v, c)
    with_cut = [6 * i + int(np.abs(J[6 * i : 6 * i + 6, j]).argmax()) for i, j in enumerate(c)]
    free = [row for row in range(len(J)) if row not in with_cut]
    free = [free[i] for i in independent_rows(J[free])]
    G_a, G_p = J[np.ix_(free, a)], J[np.ix_(free, p)]
    condition = float(np.linalg.cond(G_p)) if G_p.shape[0] == G_p.shape[1] else np.inf
    f, n = len(a), chain.n
    G, drift = np.full((len(p), f), np.nan), np.full(n, np.nan)
    drift[list(a)] = 0.0
    motion = np.zeros((n, f))
    motion[list(a)] = np.eye(f)
    if condition < SINGULAR_CONDITION:
        G = -np.linalg.solve(G_p, G_a)
        drift[list(p)] = -np.linalg.solve(G_p, Jdot_v[free])
    motion[list(p)] = G
    G_c = J[np.ix_(with_cut, c)]
    rest = [*a, *p]
    motion[list(c)] = -np.linalg.solve(G_c, J[np.ix_(with_cut, rest)] @ motion[rest])
    drift[list(c)] = -np.linalg.solve(
        G_c, J[np.ix_(with_cut, rest)] @ drift[rest] + Jdot_v[with_cut]
    )
    return ConstraintEquations(
        a, p, c, G, motion[list(c)], motion, np.stack([J_i @ motion for J_i in J_arms]), drift,
        condition,
    )  # fmt: skip


def scheme(chain: ClosedChain, actuated: Sequence[str]) -> tuple[int, ...]:
    """Indices of the independent joints.

    UnknownNameError: an unknown joint. InvalidValueError: a joint given twice, or more or fewer
    than the degrees of freedom.
    """
    motors, freedom = motor_indices(chain, actuated), chain.n - chain.loops.rank
    if len(motors) != freedom:
        raise InvalidValueError(
            f"actuated: found {len(motors)} joints, needs {freedom}, the degrees of freedom"
        )
    return motors


def motor_indices(chain: ClosedChain, actuated: Sequence[str]) -> tuple[int, ...]:
    """Indices of joints that are driven by motors.

    UnknownNameError: an unknown joint. InvalidValueError: a passive joint, or a joint given twice.
    """
    joints = chain.joint_names
    require_known("joint", actuated, joints, "actuated: ")
    for name in actuated:
        if joints.index(name) in chain.passive:
            raise InvalidValueError(f"actuated: '{name}' is a passive joint and has no motor")
    repeated = sorted({name for name in actuated if list(actuated).count(name) > 1})
    if repeated:
        raise InvalidValueError(f"actuated: {', '.join(repeated)} given more than once")
    return tuple(joints.index(name) for name in actuated)


def _cut_joints(chain: ClosedChain, cut: Sequence[str], actuated: Sequence[str]) -> tuple[int, ...]:
    joints, names = chain.joint_names, list(cut)
    if not names:
        names = [_last_free_joint(chain, frame, actuated) for frame in chain.frames[1:]]
    if len(names) != len(chain.arms) - 1:
        raise InvalidValueError(
            f"cut: found {len(names)} joints, needs {len(chain.arms) - 1}, one for each loop"
        )
    require_known("joint", names, joints, "cut: ")
    for name, frame in zip(names, chain.frames[1:], strict=True):
        if name in actuated:
            raise InvalidValueError(f"cut: '{name}' is actuated; cut the loop elsewhere")
        if name not in _carriers(chain, frame):
            raise InvalidValueError(f"cut: '{name}' is not on the arm of its loop")
    return tuple(joints.index(name) for name in names)


def _carriers(chain: ClosedChain, frame: int) -> list[str]:
    """Names of the joints that carry a frame and not arm 0's, base first: they move the loop."""
    model = chain.model
    reference = set(model.supports[model.frames[chain.frames[0]].parentJoint])
    carriers = model.supports[model.frames[frame].parentJoint]
    return [model.names[j] for j in carriers if j > 0 and j not in reference]


def _last_free_joint(chain: ClosedChain, frame: int, actuated: Sequence[str]) -> str:
    free = [name for name in _carriers(chain, frame) if name not in actuated]
    if not free:
        raise InvalidValueError("actuated: leaves no joint of an arm at which to cut its loop")
    return free[-1]


def _rows_in_cut_frames(
    chain: ClosedChain, q: Array, v: Array, cut: Sequence[int]
) -> tuple[Array, Array, list[Array]]:
    """J_c and Jdot_c v with each loop's rows in its cut joint's frame, and J of each arm."""
    model, data = chain.model, chain.model.createData()
    pin.forwardKinematics(model, data, q, v, np.zeros(chain.n))
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    world = pin.LOCAL_WORLD_ALIGNED
    J_arms = [pin.getFrameJacobian(model, data, f, world) for f in chain.frames]
    drift = [
        pin.getFrameClassicalAcceleration(model, data, f, world).vector.copy() for f in chain.frames
    ]
    rows, terms = [], []
    for i, joint in enumerate(cut, start=1):
        X_WC = data.oMi[model.getJointId(chain.joint_names[joint])]
        lever = X_WC.translation - data.oMf[chain.frames[i]].translation
        to_cut = pin.SE3(X_WC.rotation, lever).toActionMatrixInverse()
        rows.append(to_cut @ (J_arms[i] - J_arms[0]))
        terms.append(to_cut @ (drift[i] - drift[0]))
    return np.vstack(rows), np.concatenate(terms), J_arms
