"""The phases of a loop, each begun where the robot is then, and braking to rest.

A scenario says where the object is in the hands by ``object_in_hand`` or ``object.pose``, for its
own start. Links, encoders and grasp of the robot are some millimetres off that; then the object is
where the hands have it in the mean, and each hand holds it there. Where the scenario says nothing,
each hand holds it midway between the hands, as ever.

When braking, all joints slow down as fast as they may, and the loops stay closed,

    minimise |v|^2   subject to   J_c v = -kappa e,  limits,  |v - v_before| <= a dt

by the QP law of the same problem without its tasks. Where one tick is enough to stop, v = 0, which
without acceleration limits is at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.assessment.assessment import allowed_acceleration
from coopqp.assessment.thresholds import ACCELERATION_UNLIMITED
from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.spec import Array, Pose, finite, vector
from coopqp.controller import Command, Controller, ControlProblem, InternalForceControl, Law
from coopqp.controllers import QPController
from coopqp.execution.phase_run import Measured, PhaseRun, begin_phase
from coopqp.limit import Limit
from coopqp.limits import JointAcceleration, JointPosition
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import grasp_of_each
from coopqp.model.state import Memory, State
from coopqp.online.arrivals import Arrivals
from coopqp.online.beginning import check_hands, check_range, check_resumed
from coopqp.online.faults import FaultMonitor
from coopqp.scenario.input import Arrival
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status

#: Acceleration limit of joints without a motor, which bounds nothing [rad/s2].
PASSIVE = 1e4


def with_acceleration(
    limits: Sequence[Limit], chain: ClosedChain, speed_up: float | None
) -> tuple[Limit, ...]:
    """The limits, with one on accelerations if there is none among them."""
    if speed_up is None or any(isinstance(limit, JointAcceleration) for limit in limits):
        return tuple(limits)
    allowed = allowed_acceleration(chain.velocity, speed_up)
    allowed[chain.passive] = PASSIVE
    joints = dict(zip(chain.joint_names, allowed.tolist(), strict=True))
    margin = max((x.margin for x in limits if isinstance(x, JointPosition)), default=0.0)
    others = float(ACCELERATION_UNLIMITED)
    return *limits, JointAcceleration(max=others, joints=joints, margin=margin)


def acceleration_limits(problem: ControlProblem) -> Array:
    """Largest acceleration of each joint, infinite where there is none, (n,) [rad/s2, m/s2]."""
    most = np.full(problem.chain.n, np.inf)
    for limit in problem.limits:
        if isinstance(limit, JointAcceleration):
            own = [limit.joints.get(name, limit.max) for name in problem.chain.joint_names]
            np.minimum(most, own, out=most)
    return most


class _Kept:
    """Internal force control that keeps the hands' distance and ignores the force."""

    memory_sizes: Mapping[str, int] = {}
    note = ""

    def __init__(self, squeezer: InternalForceControl) -> None:
        self.along = squeezer.along

    def update(self, state: State) -> Status | None:
        return None


class Braking:
    """Brings the joints of a law's problem to rest."""

    def __init__(self, own: Law) -> None:
        problem, squeezer = own.problem, own.squeezer
        still = replace(problem, tasks=(), wrenches=(), secondary=())
        self._law = QPController().build(still)
        self._law.squeezer = _Kept(squeezer) if squeezer else None
        self._law.observer = own.observer
        self._memory = Memory(self._law.memory_sizes)
        self._step = acceleration_limits(problem) * problem.dt  # of the velocity in one tick
        self._still = Command(problem.chain.n)

    def can_stop(self, state: State) -> bool:
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


#: Name of the input with the readings of force sensors; ``State.hand_wrench``.
HAND_WRENCH = "hand_wrench"


class Phases:
    """The phases so far.

    Args:
        given: the scenario as written.
        controller: its settings.
        observed: whether commands may differ from what is measured.
        by_time: whether a phase ends by itself.

    Attributes:
        scenario: as begun.
        done: the phases so far, the running one last; none before the beginning.
        now: the running phase. arrivals: at its inputs. braking: brings it to rest. monitor: of
            the robot's faults.
        fault: why the next phase could not begin; empty if it could.
    """

    def __init__(
        self, given: Scenario, controller: Controller, *, observed: bool, by_time: bool
    ) -> None:
        self.scenario = self._given = given
        self._controller, self._observed, self._by_time = controller, observed, by_time
        self._asked, self.fault = False, ""
        self.done: tuple[PhaseRun, ...] = ()
        self._enter(None, None)

    def begin(self, q: Array, *, held: bool) -> None:
        given = self._given
        if not np.array_equal(q, given.chain.q_start):
            if not given.start_outside:
                check_range(given.chain, q)
            if held:
                self.scenario = as_held(given, q)
            else:
                check_hands(given.chain, q, placed=False)
        self._enter(None, q)
        self.done = (self.now,)

    def _enter(self, before: PhaseRun | None, q: Array | None) -> None:
        robot = Measured(q, self._observed)
        self.now = now = begin_phase(self.scenario, self._controller, before, robot=robot)
        self._is_last = now.is_last
        names = {*self.scenario.inputs, HAND_WRENCH}
        self.arrivals = Arrivals(now.inputs, names, now.since)
        self.braking = Braking(now.law)
        monitor = FaultMonitor(now.law, observed=self._observed)
        if before is not None:
            monitor.take_over(self.monitor)
        self.monitor: FaultMonitor = monitor

    def ask(self) -> None:
        if self.now.is_last:
            raise InvalidValueError(f"phase '{self.now.phase.name}' is the last")
        self._asked = True

    @property
    def over(self) -> bool:
        """Whether the next phase is due."""
        return not self._is_last and (self._asked or (self._by_time and self.now.over))

    def hand_over(self, q: Array) -> bool:
        """Begin the next phase at the present speed, if the arms can stop in a tick.

        Returns whether it was tried; :attr:`fault` says why it failed.
        """
        if not self.braking.can_stop(self.now.state):
            return False
        self._asked = False
        try:
            self._enter(self.now, q)
        except CoopqpError as error:
            self.fault = f"phase '{self.now.phase.name}' does not end: {error}"
            return True
        self.done = (*self.done, self.now)
        return True

    def take_up(self, q: Array) -> None:
        """Go on from where the robot is, at rest, at the time when the phase stopped.

        Raises:
            CoopqpError: as of :func:`coopqp.online.beginning.check_resumed`.
        """
        now, before = self.now, self.now.state
        check_resumed(now.problem.chain, q, outside=self._given.start_outside)
        now.state = Measured(q, self._observed).start(now.law)
        now.state.t, now.state.inputs = before.t, before.inputs
        now.state.felt[0] = before.felt[0]
        self.rest_inputs()
        self.monitor.forget()

    def take(self, inputs: Any, now: float, ahead: float) -> list[Arrival]:
        """Pass on what has come since the last tick, as :meth:`Arrivals.read` takes it."""
        state = self.now.state
        if inputs is None and not self.now.inputs.move:
            state.hand_wrench, state.inputs.refused = None, ()
            return []
        arrivals = self.arrivals.read(self._without_wrench(inputs), state.t, now, ahead)
        self.now.inputs.step(state, arrivals)
        state.inputs.refused = (*self.arrivals.refused, *state.inputs.refused)
        return arrivals

    def _without_wrench(self, inputs: Any) -> Any:
        """Move the readings of force sensors to the state."""
        self.now.state.hand_wrench = None
        with suppress(Exception):  # a mapping of a user's class may fail; who reads it says so
            inputs = dict(inputs)
        if type(inputs) is not dict or HAND_WRENCH not in inputs:
            return inputs
        self.now.state.hand_wrench = inputs[HAND_WRENCH]  # anything; the law looks at it
        return {name: given for name, given in inputs.items() if name != HAND_WRENCH}

    def rest_inputs(self) -> None:
        """Hold the references that follow inputs where they are."""
        for channel in self.now.inputs.channels.values():
            channel.rate[:] = channel.acceleration[:] = 0.0
            if channel.kind.velocity:
                channel.value[:] = 0.0
        for clock in self.now.inputs.clocks.values():
            clock.rate[:] = 0.0


#: Smallest size of a number in a scenario file that is not zero.
SMALLEST = 1e-30


def as_held(scenario: Scenario, q: Array) -> Scenario:
    """The scenario with its start where the robot is, and the grasp as it is held there.

    Raises:
        GraspError: as of :func:`coopqp.online.beginning.check_hands`.
        InvalidValueError: q is no n finite numbers.
    """
    chain = scenario.chain
    q = _without_tiny(finite("q", vector("q", q, chain.n)))
    start = dict(zip(chain.joint_names, q.tolist(), strict=True))
    grasps = grasp_of_each(scenario.robot_model, scenario.grasps)
    holders = chain.hold.holders
    placed = scenario.held.pose is not None or any(grasps[arm].object_in_hand for arm in holders)
    check_hands(chain, q, placed=placed)
    if not placed:
        return replace(scenario, start=start)
    X = chain.object_pose(q)
    place, angles = _without_tiny(X.translation), _without_tiny(pin.rpy.matrixToRpy(X.rotation))
    pose = Pose(position=tuple(place.tolist()), rpy=tuple(angles.tolist()))
    without_places = {arm: replace(grasps[arm], object_in_hand=None) for arm in holders}
    held, grasps = replace(scenario.held, pose=pose), {**grasps, **without_places}
    return replace(scenario, start=start, held=held, grasps=grasps)


def _without_tiny(numbers: Array) -> Array:
    return np.where(np.abs(numbers) < SMALLEST, 0.0, numbers)
