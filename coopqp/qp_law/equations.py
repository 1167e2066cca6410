"""The formulas of the QP's matrices, arrays in and out.

Letters: n joints, k task rows, m loop rows; w their weights.
"""

from __future__ import annotations

import numpy as np

from coopqp.checked import Array

#: Cost of a missing share of what may be done in part, far above any soft task.
SCALE_WEIGHT = 1e3
#: A share of the drift correction from here on is all of it.
ALL_OF_IT = 1.0 - 1e-6
#: Speed below which what is scaled counts as at rest [m/s, rad/s].
LEAST_SPEED = 1e-4


def normal_equations(J: Array, w: Array, wanted: Array, damping: float, P: Array, q: Array) -> None:
    """Write sum_i w_i (J_i v - wanted_i)^2 + damping |v|^2 as 1/2 v' P v + q' v, halved.

    Args:
        J: task Jacobian, shape (k, n).
        w: weights, shape (k,).
        wanted: J v that is asked for, shape (k,).
        damping: cost of |v|^2.
        P: written, J' W J + damping I, shape (n, n).
        q: written, -J' W wanted, shape (n,).
    """
    weighted = J * w[:, None]
    P[:] = weighted.T.dot(J)
    add_damping(P, damping)
    np.negative(wanted.dot(weighted), out=q)


def add_damping(P: Array, damping: float | Array) -> None:
    """Add to the diagonal of P, shape (n, n); one number for all joints or one each."""
    diagonal = np.einsum("ii->i", P)
    diagonal += damping


def step_damping(bend: float, dt: float, share: float) -> float:
    """Damping with which a step does not overshoot where the arms are stretched, share dt bend.

    A tick is a Gauss-Newton step. About the pose where it should rest, along a direction u that
    the tasks hardly see, it goes a = dt (g s^2 + u'S u) / (s^2 + d) of the way, with s^2 = u'J'W J
    u, the damping d, and S what the tasks' second derivatives add, |S| <= bend
    (:meth:`coopqp.task.TaskStack.bend`). Above a = 2 it swings farther each time until a bound
    stops it; d = dt bend keeps a below 1, and half of that below 2.

    Args:
        bend: of the level's tasks.
        dt: control period [s].
        share: of the damping that rules out any overshoot.
    """
    return share * dt * bend


def drift_damping(drift: Array, kappa: float, dt: float, reach: float, corrected: float) -> float:
    """Damping with which a drift correction that is done in part does not overshoot.

    Its share has the cost w (1 - s)^2. Near a singular pose what is left of a millimetre would ask
    for full speed, and for full speed back in the next tick. By the argument of
    :func:`step_damping` dt w L / |kappa e| is enough for one arm, twice that for two.

    Args:
        drift: e, shape (m,).
        kappa: its gain [1/s].
        dt: control period [s].
        reach: L of the arms [m].
        corrected: share that the last tick did; nothing is added where it did all.
    """
    if corrected >= ALL_OF_IT:
        return 0.0
    wanted = kappa * float(np.sqrt(drift.dot(drift)))
    return 2.0 * dt * SCALE_WEIGHT * reach / max(wanted, LEAST_SPEED)


def loop_rows(J_loop: Array, drift: Array, kappa: float, A: Array, b: Array) -> None:
    """Write J_c v = -kappa e, eq. (14) with the drift correction.

    Args:
        J_loop: shape (m, n).
        drift: e, what the loops must lose, shape (m,).
        kappa: gain of the drift correction [1/s].
        A: written, shape (m, n).
        b: written, shape (m,).
    """
    A[:] = J_loop
    np.multiply(drift, -kappa, out=b)


def slowed_loop_rows(J_loop: Array, drift: Array, kappa: float, A: Array, b: Array) -> None:
    """Write J_c v + s kappa e = 0 with a share s of the drift correction as the last variable.

    Args:
        J_loop: shape (m, n).
        drift: e, shape (m,).
        kappa: its gain [1/s].
        A: written, shape (m, n + 1).
        b: written, shape (m,).
    """
    A[:, :-1] = J_loop
    np.multiply(drift, kappa, out=A[:, -1])
    b[:] = 0.0
