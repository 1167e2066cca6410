"""What squeezes and loads arms with masses where they rest, as the statics tell it.

With delta = q_c - q, from where the joints are to where they were told to be, servos of stiffness K
and feed-forward F hold arms of weight Gamma against the wrench lambda between the hands, while the
observer has brought the commanded loops to where the measured ones are:

    K delta + J' lambda = Gamma(q) - F(q),     J delta = J n

Without noise n all that squeezes is the feed-forward's error Gamma - F: of the object's mass, and
of the model. Each measurement has noise of deviation sigma; of it the observer's first-order filter
with share s lets sigma sqrt(s / (2 - s)) through. Nothing of this knows the QP law.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coopqp.checked import Array
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.loop_observer import TICKS, TIME
from coopqp.plants._dynamic import DynamicModel
from coopqp.plants._servo import fair_shares


@dataclass(frozen=True)
class Squeeze:
    """Largest internal force of a hand, and the motors' torques.

    Attributes:
        weight: force by the feed-forward's error [N].
        noise: root mean square of what noise adds to it [N].
        tau: K delta + F, were the motors strong enough, shape (n,) [N m].
    """

    weight: float
    noise: float
    tau: Array


def squeeze(plant: DynamicModel, dt: float) -> Squeeze:
    """What the statics say where a plant is.

    Args:
        plant: at rest.
        dt: control period [s].
    """
    true, disturbance = plant.true, plant.disturbance
    chain, servo = true.chain, plant.servo
    dynamics = ClosedLoopDynamics(
        chain, shares=fair_shares(chain), mass_scale=disturbance.object_mass
    )
    rest, n = np.zeros(chain.n), chain.n
    dynamics.update(true.q, rest)
    true.update()
    J = true.J_rel[: chain.loops.closed]
    forward = servo.weight(true.q)
    matrix = np.block([[np.diag(servo.stiffness), J.T], [J, np.zeros((len(J),) * 2)]])
    rhs = np.zeros((n + len(J), n + 1))
    rhs[:n, 0], rhs[n:, 1:] = dynamics.gravity(true.q) - forward, J
    found = np.linalg.lstsq(matrix, rhs, rcond=None)[0]
    wrenches: Array = np.zeros((len(true.J_rel), n + 1))
    wrenches[: len(J)] = found[n:]
    # What the hands do to the object is linear in the wrenches but for its weight, which cancels.
    forces = np.stack(
        [dynamics.object_wrenches(rest, column).internal[:, :3] for column in wrenches.T], axis=2
    )
    share = dt / max(TIME, TICKS * dt)
    passed = disturbance.noise_position * np.sqrt(share / (2.0 - share))
    return Squeeze(
        weight=float(np.linalg.norm(forces[:, :, 0], axis=1).max()),
        noise=float(passed * np.sqrt((forces[:, :, 1:] ** 2).sum(axis=(1, 2)).max())),
        tau=servo.stiffness * found[:n, 0] + forward,
    )
