"""The loop for a real robot: measure, take what has arrived, solve, verify, record; once a tick.

    with OnlineLoop(scenario, controller="qp") as loop:
        while loop.running:
            command = loop.tick(robot.read(), inputs={"target": target})
            robot.write(loop.setpoint, command.v)
            ...  # wait for the next period

A tick raises nothing and prints nothing: the command's status and note say what is wrong, and the
robot comes to rest where it must not go on. :func:`coopqp.online.real_time.real_time` does all of
this, keeps the period, and stops the robot at the end.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopqp.assessment.thresholds import SPEED_UP
from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.spec import Array, Pose
from coopqp.base.wording import raised
from coopqp.controller import Command, ControlProblem, Law
from coopqp.execution.controller_run import PhaseRun, controller_of
from coopqp.kernel import native
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.loop_observer import Observer
from coopqp.model.notes import Why
from coopqp.model.state import State
from coopqp.online.arrivals import Readings
from coopqp.online.faults import Fault, Reaction, checked_reactions
from coopqp.online.options import HowHeld, PhasesEnd, Reference, check_options
from coopqp.online.phases import HASTE, Phases, with_acceleration
from coopqp.online.session import Keeper, Record, scenario_text
from coopqp.online.stops import Clock as Clock
from coopqp.online.stops import Interrupts, LoopTime, Stops, Waiting, Watch
from coopqp.scenario.scenario import Phase, Scenario
from coopqp.scenario.start import pose_of
from coopqp.solver import Status

#: Share of its speed at which a loop goes on that a fault slows down, and its ramp [s].
SLOW, SLOWING = 0.25, 0.5

_STATUSES = tuple(Status)


@dataclass(frozen=True)
class LoopTicks:
    """Some ticks, oldest first; T of them."""

    number: NDArray[np.int64]  # since the loop was made, shape (T,)
    clock: Array  # start by the loop's clock, shape (T,) [s]
    t: Array  # time of the references, shape (T,) [s]
    q: Array  # configuration before the tick, shape (T, n)
    v: Array  # command, shape (T, n)
    measured: Array  # joints; NaN without a usable reading, shape (T, n)
    position: Array  # of the object at q, shape (T, 3) [m]
    rotation: Array  # of the object at q, shape (T, 3, 3)
    loop_position: Array  # largest loop error, shape (T,) [m]
    loop_orientation: Array  # largest loop error, shape (T,) [rad]
    us: Array  # computing time, shape (T,) [us]
    causes: NDArray[np.int64]  # one bit for each status, in their order, shape (T,)

    def causes_at(self, k: int) -> tuple[Status, ...]:
        """Statuses of a tick, in their order, not by severity."""
        bits = int(self.causes[k])
        return tuple(status for i, status in enumerate(_STATUSES) if bits >> i & 1)


@cache
def _bits(causes: tuple[Status, ...]) -> int:
    return sum(1 << _STATUSES.index(cause) for cause in set(causes))


class History:
    """A ring buffer of the last ticks."""

    def __init__(self, chain: ClosedChain, capacity: int, dt: float) -> None:
        self.capacity, self.count, self._dt = capacity, 0, dt
        shapes = {"position": (3,), "rotation": (3, 3)}
        shapes |= dict.fromkeys(("q", "v", "measured"), (chain.n,))
        numbers = dict.fromkeys(("number", "causes"), np.int64)
        self._all = LoopTicks(*(
            np.zeros((capacity, *shapes.get(name, ())), numbers.get(name, float))
            for name in LoopTicks.__dataclass_fields__
        ))  # fmt: skip
        self.us, found = self._all.us, native.module()
        self._quick = found and found.Ring(vars(self._all)).add

    def add(
        self, clock: float, state: State, measured: Array, command: Command, setpoint: Array
    ) -> int:
        """Add a tick, and write where its command leads; returns its row, for the time it took."""
        kept, i, q, v, dt = self._all, self.count % self.capacity, state.q, command.v, self._dt
        if self._quick:
            place = state.p_WO, state.R_WO, state.closed_error
            self._quick(i, clock, state.t, q, v, measured, *place, setpoint, dt)
        else:
            kept.clock[i], kept.t[i] = clock, state.t
            kept.q[i], kept.v[i], kept.measured[i] = q, v, measured
            kept.position[i], kept.rotation[i] = state.p_WO, state.R_WO
            kept.loop_position[i] = state.loop_position_error
            kept.loop_orientation[i] = state.loop_orientation_error
            setpoint[:] = q + dt * v
        kept.number[i], kept.causes[i] = self.count, _bits(command.causes)
        self.count += 1
        return i

    def last(self, ticks: int | None = None) -> LoopTicks:
        """A copy of the last ticks, all that are kept when omitted."""
        kept = min(self.count, self.capacity)
        count = kept if ticks is None else max(0, min(ticks, kept))
        rows = np.arange(self.count - count, self.count) % self.capacity
        return LoopTicks(*(column[rows] for column in vars(self._all).values()))


class OnlineLoop:
    """One controller of a scenario, tick by tick, with measured joints from any robot.

    Args:
        scenario: from :func:`coopqp.load`; its plant, duration and feeds of inputs are not used.
        controller: its name in the scenario, or any controller's type name.
        reference: configuration that commands are computed from. "commanded": the last command's,
            for robots that hold one object firmly (docs/real_robots.md); measurements update the
            estimated loop-closure offset. "measured": for joints that track exactly, and for
            compliant arms that must be followed. Torques are always computed from measured joints.
        grasp: "as_held": each hand holds the object where it is at the first tick; "as_written":
            as at the scenario's own start; the difference counts as model error.
        speed_up: time in which a joint may get from rest to its velocity limit [s], which is an
            acceleration limit where the scenario has none; None for none, as by torques.
        clock: of ticks and of what is sent to inputs; None counts ticks, as in simulation, where
            none is late or early.
        silent_after: how long the last reading counts where a robot sends less often [s].
        patience: time without measurement or tick after which it stops until :meth:`resume` [s].
        keep: length of the history in memory, an hour at most [s].
        phases: "by_time": as in the scenario; "asked": at :meth:`next_phase`.
        out: folder for what is needed to play the session again (:mod:`coopqp.online.session`).
        record: makes a recording when the loop has begun.
        reactions: what is done about a kind of fault, "go_on", "slow_down" or "rest", where it
            shall not be that of :data:`coopqp.online.faults.REACTIONS`.
        observer: of the loop-closure offset, instead of the scenario's.

    Attributes:
        command, status: of the last tick; its most severe status.
        setpoint: joints at the end of the period, shape (n,) [rad, m].
        history: the last ticks. watch: counts late and early ticks, and has the longest period.
        ticks, begun: number of ticks without early calls; whether the object is held.
        by_torques: whether commands are torques, ``command.tau``.
        patience, simulated: as given; whether without a clock. measured: last accepted reading.

    Raises:
        CoopqpError: an option is none, or the controller cannot be built.
    """

    def __init__(
        self,
        scenario: Scenario,
        controller: str = "qp",
        *,
        reference: Reference = "commanded",
        grasp: HowHeld = "as_held",
        speed_up: float | None = SPEED_UP,
        clock: Clock | None = time.monotonic,
        silent_after: float = 0.0,
        patience: float = 0.25,
        keep: float = 30.0,
        phases: PhasesEnd = "by_time",
        out: Path | str | None = None,
        record: Callable[[OnlineLoop], Record] | None = None,
        reactions: Mapping[str, Reaction] | None = None,
        observer: Observer | None = None,
    ) -> None:
        check_options(locals())
        self._turn = threading.RLock()
        self._reactions = checked_reactions(reactions)
        chosen = controller_of(scenario, controller)
        own, self.controller = scenario.held_by(controller), controller
        self.by_torques = torques = chosen.commands_torques
        limits = own.limits if torques else with_acceleration(own.limits, own.chain, speed_up)
        self._given = own.changed(limits=limits, observer=observer or own.observer)
        self._observed = reference == "commanded" and not torques
        self._new_phases = partial(
            Phases, self._given, chosen,
            observed=self._observed, by_time=phases == "by_time", held=grasp == "as_held",
            haste=HASTE if len(limits) > len(own.limits) else 1,
        )  # fmt: skip
        self._time = LoopTime(clock or (lambda: self.ticks * own.dt), own.dt)
        self.patience, self.simulated = patience, clock is None
        chain, dt = self._given.chain, self._given.dt
        self.history = History(chain, max(1, round(keep / dt)), dt)
        self._readings, self._stops = Readings(chain, silent_after, rates=torques), Stops(patience)
        self.measured = self._readings.q
        self.setpoint, self._no_reading = chain.q_start.copy(), np.full(chain.n, np.nan)
        self._idle_q = self._no_reading.copy()  # before it has begun
        self._refusal, self._holding = Command(chain.n), Command(chain.n)
        self._waiting = Waiting()
        self._keeper = Keeper(self, None if out is None else Path(out), record)
        self._interrupts = Interrupts(self.end)
        self.reset()

    def reset(self) -> None:
        """Forget all but the history; the next tick begins where the robot is then."""
        with self._turn:
            self._keeper.close()
            self._phases = self._new_phases()
            for part in (self._readings, self._waiting, self._stops, self._time):
                part.forget()
            self.watch = Watch(self._given.dt)
            self.ticks, self.begun, self._built = 0, False, False
            self._moved, self._behind, self._forgives = False, 0.0, False
            self._pace = self._pace_before = 1.0
            self.setpoint[:], self._idle_q[:] = self._phases.now.problem.chain.q_start, np.nan
            self._say(self._refuse(Status.OPTIMAL, ""))

    @property
    def scenario(self) -> Scenario:
        """As begun: it starts where the robot was."""
        return self._phases.scenario

    @property
    def source(self) -> str:
        """The scenario's text with the loop's changes; empty where it was made in Python."""
        return scenario_text(self, self._given)

    @property
    def phases(self) -> tuple[PhaseRun, ...]:
        """The phases so far, the running one last; none before the beginning."""
        return self._phases.done

    @property
    def state(self) -> State:
        """State before the last tick's command: commanded joints, kinematics, inputs."""
        return self._phases.now.state

    @property
    def law(self) -> Law:
        """The controller built for this phase."""
        return self._phases.now.law

    @property
    def problem(self) -> ControlProblem:
        """The problem it was built for."""
        return self._phases.now.problem

    @property
    def phase(self) -> Phase:
        """The running phase."""
        return self._phases.now.phase

    @property
    def now(self) -> float:
        """Time by the loop's clock [s]; what it would say where it fails."""
        return self._time.read()

    @property
    def note(self) -> str:
        """What else is to be said of the last tick, see ``Command.note``; empty if OPTIMAL."""
        return self.command.note

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Faults of the robot that were found since it began or went on, oldest first."""
        return self._phases.monitor.faults

    @property
    def at_rest(self) -> bool:
        """Whether the last command was to stand still."""
        holding = self._phases.holding
        if holding and self.begun:
            return not self._moved and holding.rests(self.state)
        return not self.command.v.any()

    @property
    def stopped(self) -> str:
        """Why it stands still until :meth:`resume`; empty while it goes on."""
        return self._stops.requested

    @property
    def stopped_by_itself(self) -> bool:
        """Whether it stopped without a request: after its patience, or as it could not go on."""
        return self._stops.by_itself and bool(self.stopped)

    @property
    def running(self) -> bool:
        """False once :meth:`end` was called and the robot is at rest."""
        return not (self._stops.ended and self.at_rest)

    def stop(self, why: object = "") -> None:
        """Come to rest, and stay there; references wait. Thread-safe."""
        self._stops.stop(why)

    def end(self, why: object = "") -> None:
        """Come to rest for good; then :attr:`running` is False. Thread-safe."""
        self._stops.end(why)

    def resume(self) -> None:
        """Forget faults and go on, after a rest from where the robot is then. Thread-safe."""
        self._stops.resume()
        self._forgives = True

    def next_phase(self) -> None:
        """Go on to the next phase, as soon as the joints are slow enough to stop in one tick.

        InvalidValueError: there is none.
        """
        self._phases.request_next()

    def begin(self, q: ArrayLike, object_pose: Pose | ArrayLike | None = None) -> None:
        """Take hold at measured joints q, as in :meth:`tick`; else the first tick does it.

        ``object_pose`` is where the object was measured, as in :meth:`Scenario.placed`.
        CoopqpError: q or the pose is none, the object cannot be held so, nothing is written.
        """
        pose = None if object_pose is None else pose_of(object_pose, self._given.chain)
        with self._turn:
            if self.begun:
                raise InvalidValueError("the loop has begun; reset it first")
            if wrong := self._readings.take(q, self._given.chain.q_start, self.now):
                raise InvalidValueError(f"q: {self._readings.note or wrong.value}")
            self._begin(pose)

    def tick(self, q: Any, inputs: Mapping[str, Any] | None = None) -> Command:
        """One period.

        Called before its period is over, it holds the last command with status ``EARLY``; what has
        come counts for the next tick. Threads take turns.

        Args:
            q: measured joints, shape (n,) [rad, m], or those of the robot alone without the
                grasps' passive joints; where torques are commanded joints and their velocities,
                shape (2, n). None without a measurement.
            inputs: what has arrived since the last tick, by name: a value, or a value and when it
                was sent by the loop's clock [s]; ``hand_wrench`` for internal force control,
                ``object_pose`` for where the object stands that no arm holds (docs/phases.md).

        Returns:
            The command for the next period, whose arrays are reused; it leads to :attr:`setpoint`.
            ``command.grippers`` says which hands shall be open and which closed.
            Torques are in ``tau``, which is None before the loop has begun.
        """
        with self._turn:
            before, now = time.perf_counter_ns(), self._time.tick()
            if left := self.watch.left(now):
                self._waiting.keep(q, inputs)
                return self._hold(left)
            try:
                command = self._say(self._tick(*self._waiting.take(q, inputs), now))
                self._keep(command, now, before)
            except Exception as error:  # noqa: BLE001 - a robot must not keep its speed alone
                command = self._say(self._refuse(Status.RAISED, raised(error)))
                with suppress(Exception):  # the state's own arrays may be others by now
                    self._keep(command, now, before)
            self._last = command
            self.ticks += 1
            if self._built:
                self.watch.forget()
            self._built = False
            return command

    def _keep(self, command: Command, now: float, before: int) -> None:
        state, history = self._phases.now.state, self.history
        measured = self._no_reading if self._wrong else self._readings.q
        i = history.add(now, state, measured, command, self.setpoint)
        if not self.begun and np.isfinite(self._idle_q).all():
            self.setpoint[:] = self._idle_q  # servos that are sent there stay
        history.us[i] = us = 1e-3 * (time.perf_counter_ns() - before)
        self._keeper.tick(state, command, us)

    def flush(self) -> None:
        """Write what is new of the session, in the rest of a period."""
        self._keeper.flush()

    def replay(self) -> Scenario:
        """The scenario that plays the session so far again; InvalidValueError: there is none."""
        if self._keeper.session is None:
            raise InvalidValueError("nothing is written: give the loop a folder, out")
        self.flush()
        return self._keeper.session.replay()

    def close(self) -> None:
        """Write the record; CoopqpError: it could not be written."""
        self._keeper.close()
        if self._keeper.fault:
            raise CoopqpError(self._keeper.fault)

    def __reduce__(self) -> NoReturn:
        """Refused: two loops of one robot would both move it."""
        raise CoopqpError("a loop cannot be copied; make another from its scenario")

    def __enter__(self) -> OnlineLoop:
        """Ctrl-C and SIGTERM end the loop at rest from now on; the second one at once."""
        self._interrupts.take()
        return self

    def __exit__(self, *error: object) -> None:
        self._interrupts.give_back()
        self.close()

    def _begin(self, pose: Pose | None = None) -> None:
        self._phases.begin(self._readings.q.copy(), pose)
        self._keeper.begin(self._given)
        self.begun = self._built = True

    def _tick(self, q: Any, inputs: Any, now: float) -> Command:
        self._advance()
        others, hand_wrench = self._phases.sense(inputs, now, self._time.ahead)
        if self._stops.look():
            self._readings.forget()
        if self._forgives:  # it may have been slowed down, not stopped
            self._forgives = False
            self._phases.monitor.forget()
        is_late = self.watch.tick(self.ticks, now)
        self._wrong = self._readings.take(q, self.state.q, now)
        if self._time.wrong:
            self._wrong = Status.CLOCK_WRONG
        self._stops.wait(self._wrong, now, self.watch.elapsed)
        if not self.begun and (refused := self._try_to_begin()):
            return refused
        self._go_by_measurement()
        if is_late:
            self._phases.arrivals.age(self.watch.elapsed - self.problem.dt)
        self._keeper.arrived(self._phases.take(others, hand_wrench, now, self._time.ahead))
        command = self._decide()
        command.messages, self._phases.missed = (*command.messages, *self._phases.missed), ()
        if faults := self.faults:
            command.add(Status.FAULT, *(fault.note for fault in faults))
        if is_late:
            command.add(Status.LATE, f"{1e3 * self.watch.elapsed:.3g} ms after the last tick")
        return command

    def _try_to_begin(self) -> Command | None:
        if self._wrong:
            return self._refuse(self._wrong, self._time.wrong or self._readings.note)
        self._idle_q[:] = self._readings.q
        if not self._stops.why:
            try:
                self._begin(self._phases.object_pose)
                return None
            except CoopqpError as error:  # not again by itself, when somebody moves the robot
                self._stops.halt(str(error))
                self._readings.forget()
        return self._refuse(Status.NOT_BEGUN, self._stops.why)

    def _advance(self) -> None:
        """Integrate the last command; the loop's time stands still while it brakes."""
        if not self.begun:
            return
        state, t, dt = self.state, self.state.t, self.problem.dt
        if holding := self._phases.holding:
            holding.foresee(state, moved=self._moved)
        else:
            state.advance(self._last.v, dt)
        state.t = t + self._pace * dt if self._moved else t

    def _go_by_measurement(self) -> None:
        """Use the measurement; begin anew after a stop, or with a new phase."""
        measured, stops = None if self._wrong else self._readings.q, self._stops
        if stops.goes_on_again and measured is not None and not stops.why:
            stops.goes_on_again = False
            rests = self._phases.holding or not self._last.v.any()
            if rests and not self._goes_on(self._phases.take_up, measured.copy()):
                self._readings.forget()
        if self._observed:
            self.state.q_measured = self._no_reading if measured is None else measured
        elif measured is not None:
            self.state.q[:] = measured
            if self.by_torques:
                self.state.v[:] = self._readings.v
        if measured is not None and not stops.why and self._phases.can_hand_over:
            self._built = True
            self._goes_on(self._phases.hand_over, measured.copy())

    def _goes_on(self, begin: Callable[[Array], None], q: Array) -> bool:
        """Whether it can begin anew at joints q; else it stops."""
        try:
            begin(q)
            self._keeper.go_on()
        except CoopqpError as error:
            self._stops.halt(str(error))
            return False
        return True

    def _decide(self) -> Command:
        phases, run = self._phases, self._phases.now
        self._look_for_faults()
        halts = [self._wrong] if self._wrong else []
        if self._stops.why or phases.over:
            halts.append(Status.STOPPED)
        # Braking begins while it is not known yet whether there is a fault.
        kind, _, doubt = self._phases.monitor.doubt or ("", (), "")
        doubt = doubt if not halts and kind and self._reactions[kind] == "rest" else ""
        if doubt:
            halts.append(Status.JOINT_DOUBTED)
        self._moved = not halts
        if not halts:
            return self._at_pace(run)
        command = phases.braking.tick(run.state)
        if not command.v.any():
            phases.rest_inputs()
        own = (c for c in command.causes if c not in (Status.OPTIMAL, Status.NOT_MEASURED, *halts))
        command.say(*dict.fromkeys(halts), *own)
        for why in command.messages:
            if isinstance(why, Why):  # the reading's own note has it
                why.leave_out(Status.NOT_MEASURED)
        waits = f"slows down for phase {phases.next_name}" if phases.over else ""
        wrong = self._time.wrong, self._readings.note, self._stops.why, doubt
        notes = (*wrong, waits, *run.state.inputs.refused)
        command.messages = (*filter(None, notes), *command.messages)
        return command

    def _look_for_faults(self) -> None:
        """Come to rest, slow down or go on where a fault of the robot shows."""
        monitor = self._phases.monitor
        readings, q = self._readings, None if self._wrong else self._readings.q
        fault = monitor.update(self.state, q, readings.misread)
        if fault and self._reactions[fault.kind] == "rest":
            self._stops.halt(fault.note)
        if not monitor.faults and self._pace == 1.0:
            return
        slow = any(self._reactions[fault.kind] == "slow_down" for fault in monitor.faults)
        if slow and self.by_torques:  # a torque has no pace
            slow = False
            self._stops.halt(monitor.faults[-1].note)
        step = self.problem.dt / SLOWING
        self._pace = max(SLOW, self._pace - step) if slow else min(1.0, self._pace + step)

    def _at_pace(self, run: PhaseRun) -> Command:
        """The law's command; slowed down, the same path in more time, references with it."""
        pace, state = self._pace, run.state
        if holding := self._phases.holding:
            holding.let_go()
        self._behind += pace
        if self._behind >= 1.0:
            self._behind -= 1.0
            run.ticks += 1
        if pace == 1.0 and self._pace_before == 1.0:
            return run.law.tick(state)
        state.v /= self._pace_before  # as if at full speed, which limits of acceleration refer to
        command = run.law.tick(state)
        state.v *= self._pace_before
        command.v *= pace
        self._pace_before = pace
        return command

    def _refuse(self, why: Status, note: str) -> Command:
        command, self._moved = self._refusal, False
        self._last, self._wrong = command, why
        command.v[:] = 0.0
        if self.by_torques and self.begun:
            self.law.hold_still(self.state)
            command.tau = self.law.command.tau
        command.say(why)
        command.note = note
        return command

    def _hold(self, left: float) -> Command:
        held = self._holding
        held.v[:], held.tau = self._last.v, self._last.tau
        held.say(Status.EARLY)
        held.note = f"{1e3 * left:.3g} ms of the period are left; wait for its end"
        return self._say(held)

    def _say(self, command: Command) -> Command:
        command.grippers = self._phases.grippers
        self.command, self.status = command, command.status
        return command
