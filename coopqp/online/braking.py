"""Coming to rest: all joints slow down as fast as they may, and the loops stay closed.

    minimise |v|^2   subject to   J_c v = -kappa e,  limits,  |v - v_before| <= a dt

which is the QP law of the same problem without its tasks. Where one tick is enough to stop, v = 0.
Without acceleration limits that is at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from coopqp.assessment.assessment import allowed_acceleration
from coopqp.assessment.thresholds import ACCELERATION_UNLIMITED
from coopqp.base.spec import Array
from coopqp.controller import Command, ControlProblem, InternalForceControl
from coopqp.controllers import QPController
from coopqp.limit import Limit
from coopqp.limits import JointAcceleration, JointPosition
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import Memory, State
from coopqp.solver import Status

#: For joints without a motor, which bound nothing [rad/s2].
PASSIVE = 1e4


def with_acceleration(
    limits: Sequence[Limit], chain: ClosedChain, speed_up: float | None
) -> tuple[Limit, ...]:
    """The limits, with one on accelerations if there is none among them."""
    if speed_up is None or any(isinstance(limit, JointAcceleration) for limit in limits):
        return tuple(limits)
    most = allowed_acceleration(chain.velocity, speed_up)
    most[chain.passive] = PASSIVE
    by_joint = dict(zip(chain.joint_names, most.tolist(), strict=True))
    margin = max((x.margin for x in limits if isinstance(x, JointPosition)), default=0.0)
    rest = float(ACCELERATION_UNLIMITED)
    return *limits, JointAcceleration(max=rest, joints=by_joint, margin=margin)


def acceleration_of(limits: Sequence[Limit], chain: ClosedChain) -> Array:
    """Each joint's acceleration limit, shape (n,) [rad/s2, m/s2]; infinite where there is none."""
    found = np.full(chain.n, np.inf)
    for limit in limits:
        if isinstance(limit, JointAcceleration):
            own = [limit.joints.get(name, limit.max) for name in chain.joint_names]
            np.minimum(found, own, out=found)
    return found


class _Kept:
    """Hands that squeeze stay as close as they are, while nobody looks at the force."""

    memory_sizes: Mapping[str, int] = {}
    note = ""

    def __init__(self, squeezer: InternalForceControl) -> None:
        self.along = squeezer.along

    def update(self, state: State) -> Status | None:
        return None


class Braking:
    """The law that brings a problem's joints to rest."""

    def __init__(
        self, problem: ControlProblem, squeezer: InternalForceControl | None = None
    ) -> None:
        still = replace(problem, tasks=(), wrenches=(), secondary=())
        self._law = QPController().build(still)
        self._law.squeezer = _Kept(squeezer) if squeezer else None
        self._memory = Memory(self._law.memory_sizes)
        self._step = acceleration_of(problem.limits, problem.chain) * problem.dt
        self._still = Command(problem.chain.n)

    def can_stop(self, state: State) -> bool:
        """Whether every joint could stop in one tick."""
        return bool((np.abs(state.v) <= self._step).all())

    def tick(self, state: State) -> Command:
        """The next command on the way to rest; the state's kinematics are up to date after it."""
        if self.can_stop(state):
            return self._stand(state)
        memory, state.memory = state.memory, self._memory
        command = self._law.tick(state)
        state.memory = memory
        return command if command.status.usable else self._stand(state)

    def _stand(self, state: State) -> Command:
        still = self._still
        state.update()
        still.v[:], still.note = 0.0, ""
        still.say(Status.OPTIMAL)
        self._memory.numbers[:] = 0.0
        return still
