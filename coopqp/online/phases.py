"""The phases of a loop, each begun where the robot is then, and braking to rest.

A scenario says where the object is in the hands by ``object_in_hand`` or ``object.pose``, for its
own start. Links, encoders and grasp of the robot are some millimetres off that; then the object is
where the hands have it in the mean, and each hand holds it there. Where the scenario says nothing,
each hand holds it midway between the hands, as ever.

When braking, all joints slow down as fast as they may, and the loops stay closed,

    minimise |v|^2   subject to   J_c v = -kappa e,  limits,  |v - v_before| <= a dt

by the QP law of the same problem without its tasks. Where one tick is enough to stop, v = 0, which
without acceleration limits is at once. Where a joint fails, all motion pulls at the hands: a limit
of acceleration that is only the loop's own then gives way, step by step. Arms that are moved by
torques come to rest and stay by the torque QP, see :class:`Holding`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from coopqp.assessment.assessment import allowed_acceleration
from coopqp.assessment.thresholds import ACCELERATION_UNLIMITED
from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.spec import Array, Pose, finite, vector
from coopqp.base.wording import message_of
from coopqp.controller import Command, Controller, ControlProblem, InternalForceControl, Law
from coopqp.controllers import QPController, TorqueQp
from coopqp.controllers.passive_grasp_pid import TorquePid
from coopqp.controllers.torque_qp import TorqueQpLaw
from coopqp.execution.controller_run import Measured, PhaseRun, begin_phase
from coopqp.execution.instants import parts_of
from coopqp.grasp import pose_matrix
from coopqp.limit import Limit
from coopqp.limits import JointAcceleration, JointPosition
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import grasp_of_each
from coopqp.model.state import Memory, State
from coopqp.online.arrivals import Arrivals
from coopqp.online.beginning import check_hands, check_object, check_range, check_resumed
from coopqp.online.faults import FaultMonitor
from coopqp.scenario.input import Arrival
from coopqp.scenario.scenario import Scenario
from coopqp.scenario.start import pose_at, pose_of, without_tiny
from coopqp.signal import InputValues, Trajectory, of_joints
from coopqp.signals import Input
from coopqp.solver import Status
from coopqp.task import TaskStack
from coopqp.tasks import Posture

#: Acceleration limit of joints without a motor, which bounds nothing [rad/s2].
PASSIVE = 1e4
#: How many times a limit of acceleration that is only the loop's own gives way where a joint fails.
HASTE = 3


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
    upper = np.full(problem.chain.n, np.inf)
    for limit in problem.limits:
        if isinstance(limit, JointAcceleration):
            own = [limit.joints.get(name, limit.max) for name in problem.chain.joint_names]
            np.minimum(upper, own, out=upper)
    return upper


class _FixedDistance:
    """Internal force control that keeps the hands' distance and ignores the force."""

    memory_sizes: Mapping[str, int] = {}
    note = ""

    def __init__(self, force_control: InternalForceControl) -> None:
        self.along, self.wanted = force_control.along, force_control.wanted

    def update(self, state: State) -> None:
        return


class Braking:
    """Brings a law's joints to rest; where one fails, by up to ``haste`` steps a tick."""

    def __init__(self, own: Law, monitor: FaultMonitor, haste: int) -> None:
        problem, force_control = own.problem, own.force_control
        still = replace(problem, tasks=(), wrenches=(), secondary=())
        self._law = QPController().unprepared(still)  # begin would take a third longer otherwise
        self._law.force_control = _FixedDistance(force_control) if force_control else None
        self._law.observer = own.observer
        self._memory = Memory(self._law.memory_sizes)
        self._step = acceleration_limits(problem) * problem.dt  # of the velocity in one tick
        self._still, self._monitor, self._haste = Command(problem.chain.n), monitor, haste

    def can_stop(self, state: State) -> bool:
        return bool((np.abs(state.v) <= self._step).all())

    def tick(self, state: State) -> Command:
        """The next command on the way to rest; the state's kinematics are up to date after it."""
        before, steps = state.v.copy(), float((np.abs(state.v) / self._step).max())
        # It grows by one a tick, and fades so: a jerk shakes the arms more than most faults do.
        fading = int((2.0 * steps + 0.25) ** 0.5 - 0.5)
        for _ in range(max(1, min(self._monitor.failing, self._haste, fading))):
            command = self._slower(state)
            state.v[:] = command.v
        state.v[:] = before
        return command

    def _slower(self, state: State) -> Command:
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


#: Gain of the joints on their way to rest and there, at most, and its share of 1/dt [1/s].
HOLD, HOLD_SHARE = 10.0, 0.1
#: Joints that are held rest below this speed [rad/s, m/s], and after so long, however noisy [s].
RESTS, SURELY = 0.01, 2.0
#: The input by which the held pose reaches its task.
HELD = "held"


class Holding:
    """Brings arms that are moved by torques to rest, and holds their pose there.

    It is the torque QP of the same problem, in which one task leads all joints, by its reference
    model with gain g, to where

        v' = -g v,   q_rest = q + v/g

    brings them, so that none turns back, and keeps them there; gravity, cones, limits and wanted
    internal wrenches are those of the problem. It goes on with what the integral of the law has
    learned, such as a heavier object. Without a reading joints are taken to move so, too.
    """

    def __init__(self, own: Law) -> None:
        assert isinstance(own, TorqueQpLaw | TorquePid)
        self._own = own
        problem, n = own.problem, own.problem.chain.n
        self._gain, self._dt = min(HOLD, HOLD_SHARE / problem.dt), problem.dt
        pose = Posture(name=HELD, goal=Input(name=HELD), gain=self._gain)
        settings = own.settings if isinstance(own, TorqueQpLaw) else TorqueQp()
        settings = replace(
            settings, external_wrench="unknown", observer_gain=TorqueQp.observer_gain
        )
        self._law = settings.build(replace(problem, tasks=(pose,), secondary=()))
        self._memory = Memory(self._law.memory_sizes)
        self._integral_gain = settings.integral * self._gain**3
        kind = of_joints(problem.chain.joint_names)
        self._pose, self._inputs = Trajectory(kind, np.zeros(n)), InputValues()
        self._inputs[HELD] = self._pose
        self._ticks = 0

    def can_stop(self, state: State) -> bool:
        return True  # the next phase begins at whatever speed

    def let_go(self) -> None:
        self._ticks = 0

    def rests(self, state: State) -> bool:
        slow = bool((np.abs(state.v) <= RESTS).all())
        return self._ticks > 0 and (slow or self._ticks * self._dt > SURELY)

    def foresee(self, state: State, *, moved: bool) -> None:
        state.advance(state.v if moved else (1.0 - self._gain * self._dt) * state.v, self._dt)

    def tick(self, state: State) -> Command:
        own = state.memory, state.inputs
        if not self._ticks:
            self._memory.numbers[:] = 0.0
            self._memory["model_rate"][:] = state.v
            if self._integral_gain and own[0].sizes == self._own.memory_sizes:
                self._memory["integral"][:] = -self._own.learned(state) / self._integral_gain
            np.copyto(self._pose.value, state.q + state.v / self._gain)
        self._ticks += 1
        state.memory, state.inputs = self._memory, self._inputs
        command = self._law.tick(state)
        state.memory, state.inputs = own
        return command


Gripper = Literal["open", "close"]

#: Name of the input with the readings of force sensors; ``State.hand_wrench``.
HAND_WRENCH = "hand_wrench"
#: Name of the input that says where the object stands, :func:`coopqp.scenario.start.pose_of`.
OBJECT_POSE = "object_pose"


class Phases:
    """The phases so far of a scenario as ``given``; ``held`` is whether it is ``as_held``.

    Attributes:
        scenario: as begun.
        done: the phases so far, the running one last; none before the beginning.
        now: the running phase. arrivals: at its inputs. braking: brings it to rest. holding: the
            same of torques, else None. monitor: of the robot's faults.
        grippers: what each arm's gripper shall do in this phase, "open" or "close".
        missed: which tasks of the phase before ended out of tolerance, for its first tick to say.
        object_pose: where it was last seen in this phase; None where it was not.
    """

    def __init__(
        self, given: Scenario, controller: Controller, *, observed: bool, by_time: bool, held: bool,
        haste: int,
    ) -> None:  # fmt: skip
        self.scenario = self._given = given
        self._controller, self._observed, self._by_time = controller, observed, by_time
        self._requested, self._held, self._haste = False, held, haste
        self.done: tuple[PhaseRun, ...] = ()
        self.object_pose: Pose | None = None
        self._pose_faults: tuple[str, ...] = ()
        self._enter(None, None)

    def begin(self, q: Array, pose: Pose | None) -> None:
        given = self._given
        if pose and not self._held:
            raise InvalidValueError(
                'object_pose: needs grasp="as_held"; "as_written" has the object where the '
                "scenario says"
            )
        if pose or not np.array_equal(q, given.chain.q_start):
            if not given.start_outside:
                check_range(given.chain, q)
            if self._held:
                self.scenario = as_held(given, q, pose)
            else:
                check_hands(given.chain, q, placed=False)
        self._enter(None, q)
        self.done = (self.now,)

    def _enter(self, before: PhaseRun | None, q: Array | None) -> None:
        X_WO = None if self.object_pose is None else pose_matrix(self.object_pose)
        robot = Measured(q, self._observed, X_WO)
        self.now = now = begin_phase(self.scenario, self._controller, before, robot=robot)
        self._start = State(now.problem.chain, now.state.q, now.state.t)
        self._start.inputs, self.object_pose = now.state.inputs, None
        self._is_last = now.is_last
        self.missed: tuple[str, ...] = ()
        hold = now.problem.chain.hold
        self.grippers: dict[str, Gripper] = {
            arm.name: "close" if arm.name in hold.holders else "open" for arm in hold.robot.arms
        }
        names = {*self.scenario.inputs, HAND_WRENCH, OBJECT_POSE}
        self.arrivals = Arrivals(now.inputs, names, now.since)
        known = self.monitor if before else None
        self.monitor: FaultMonitor = FaultMonitor(now.law, known, observed=self._observed)
        self.holding = Holding(now.law) if self._controller.commands_torques else None
        self.braking = self.holding or Braking(now.law, self.monitor, self._haste)

    def request_next(self) -> None:
        if self.now.is_last:
            raise InvalidValueError(f"phase '{self.now.phase.name}' is the last")
        self._requested = True

    @property
    def over(self) -> bool:
        return not self._is_last and (self._requested or (self._by_time and self.now.over))

    @property
    def next_name(self) -> str:
        """Of the next phase, quoted, or its number counted from 1."""
        number = self.now.index + 1
        name = self.scenario.schedule[number].name
        return f"'{name}'" if name else str(number + 1)

    @property
    def can_hand_over(self) -> bool:
        """Whether the next phase may begin, as the arms can stop in a tick."""
        return self.over and self.braking.can_stop(self.now.state)

    def hand_over(self, q: Array) -> None:
        """Begin the next phase at the present speed; CoopqpError where it cannot begin."""
        self._requested, missed = False, self._out_of_tolerance()
        try:
            self._enter(self.now, q)
        except CoopqpError as error:
            raise CoopqpError(f"phase '{self.now.phase.name}' does not end: {error}") from error
        self.done, self.missed = (*self.done, self.now), missed

    def _out_of_tolerance(self) -> tuple[str, ...]:
        """Which tasks end how far from their references; empty where none is, or nobody knows."""
        problem, state, found = self.now.problem, self.now.state, []
        try:
            state.update()
            stack = TaskStack(problem.tasks, self._start)
            stack.update(state)
        except Exception:  # noqa: BLE001 - tasks may be a user's; the law has said what they raise
            return ()
        for info, rows in parts_of(problem.tasks, problem.chain):
            off = float(np.linalg.norm(stack.e[rows]))
            if not info.springs and not off <= info.tolerance:
                found.append(f"{info.name} by {off:.2g} {info.unit}")
        name = self.now.phase.name or self.now.index + 1
        return (f"phase {name} ended with tasks missed: {', '.join(found)}",) if found else ()

    def take_up(self, q: Array) -> None:
        """Go on from where the robot is, at rest; CoopqpError where it cannot be there."""
        now, before = self.now, self.now.state
        check_resumed(now.problem.chain, q, outside=self._given.start_outside)
        now.state = Measured(q, self._observed).start(now.law)
        now.state.t, now.state.inputs = before.t, before.inputs
        now.state.observer_state[0] = before.observer_state[0]
        if self.holding and before.memory.sizes == now.state.memory.sizes:
            now.state.memory["integral"][:] = before.memory["integral"]
        self.rest_inputs()
        self.monitor.forget()

    def sense(self, inputs: Any, now: float, ahead: float) -> tuple[Any, Any]:
        """Take where the object was seen, before a phase may begin by it; times as in `take`.

        Returns the other inputs, and the readings of force sensors, whatever these are.
        """
        try:
            others = {} if inputs is None else dict(inputs)
        except Exception:  # noqa: BLE001 - a mapping of a user's class; who reads it says so
            return inputs, None
        pose, hand_wrench = others.pop(OBJECT_POSE, None), others.pop(HAND_WRENCH, None)
        try:
            if type(pose) is tuple and len(pose) == 2:
                pose, sent = pose
                self.arrivals.check_stamp(OBJECT_POSE, sent, now, ahead)
            if pose is not None:
                self.object_pose = pose_of(pose, self._given.chain)
        except Exception as error:  # noqa: BLE001 - anything can come from a camera
            self._pose_faults = (
                message_of(error) or f"object_pose: found a {type(pose).__name__}",
            )
        return others, hand_wrench

    def take(self, inputs: Any, hand_wrench: Any, now: float, ahead: float) -> list[Arrival]:
        """Pass on what has come since the last tick, as :meth:`Arrivals.read` takes it."""
        state = self.now.state
        state.hand_wrench, state.inputs.refused = hand_wrench, ()
        if type(inputs) is dict and not (inputs or self._pose_faults or self.now.inputs.move):
            return []
        arrivals = self.arrivals.read(inputs, state.t, now, ahead)
        self.now.inputs.step(state, arrivals)
        state.inputs.refused = (*self._pose_faults, *self.arrivals.refused, *state.inputs.refused)
        self._pose_faults = ()
        return arrivals

    def rest_inputs(self) -> None:
        """Hold the references that follow inputs where they are."""
        for channel in self.now.inputs.channels.values():
            channel.rate[:] = channel.acceleration[:] = 0.0
            if channel.kind.velocity:
                channel.value[:] = 0.0
        for clock in self.now.inputs.clocks.values():
            clock.rate[:] = 0.0


def as_held(scenario: Scenario, q: Array, pose: Pose | None = None) -> Scenario:
    """The scenario with its start at the robot's q, (n,), and the grasp as it is held there.

    ``pose`` is the object's where it has been measured. CoopqpError where it cannot be held so.
    """
    chain = scenario.chain
    q = without_tiny(finite("q", vector("q", q, chain.n)))
    start = dict(zip(chain.joint_names, q.tolist(), strict=True))
    grasps = grasp_of_each(scenario.robot_model, scenario.grasps)
    holders = chain.hold.holders
    placed = scenario.held.pose is not None or any(grasps[arm].object_in_hand for arm in holders)
    check_hands(chain, q, placed=placed)
    if not placed and pose is None:
        return scenario.changed(start=start)
    here = chain.object_pose(q)
    if pose and placed and chain.hold.holders:
        check_object(here, pose_matrix(pose))
    pose = pose or pose_at(here)
    without_places = {arm: replace(grasps[arm], object_in_hand=None) for arm in holders}
    held, grasps = replace(scenario.held, pose=pose), {**grasps, **without_places}
    # The arms' error here counts as the grasps', which turn with the object as the arms' does not.
    own = chain.loop_error_sizes(q)[0] if placed else 0.0
    observer = replace(scenario.observer, most=scenario.observer.most + own)
    return scenario.changed(start=start, held=held, grasps=grasps, observer=observer)
