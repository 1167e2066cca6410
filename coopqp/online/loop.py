"""The loop for a real robot: measure, take what has arrived, solve, verify, record; once a tick.

    with OnlineLoop(scenario, controller="qp") as loop:
        while loop.running:
            command = loop.tick(robot.read(), inputs={"target": target})
            robot.write(loop.setpoint, command.v)
            ...  # wait for the next period

A tick raises nothing and prints nothing: what is wrong is said by the command's status and note,
and the robot comes to rest where it must not go on. :func:`coopqp.online.real_time.real_time` does
all of this, keeps the time, and tells the robot to stand still at the end.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from coopqp.assessment.thresholds import SPEED_UP
from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.wording import raised
from coopqp.controller import Command, ControlProblem, Law
from coopqp.execution.controller_run import controller_of
from coopqp.execution.phase_run import PhaseRun
from coopqp.model.state import State
from coopqp.online.arrivals import Readings
from coopqp.online.braking import with_acceleration
from coopqp.online.history import History
from coopqp.online.options import HowHeld, PhasesEnd, Reference, check_options
from coopqp.online.phases import Phases
from coopqp.online.session import Keeper, Record, scenario_text
from coopqp.online.stops import Interrupts, Stops
from coopqp.online.watch import Waiting, Watch
from coopqp.scenario.scenario import Phase, Scenario
from coopqp.solver import Status

Clock = Callable[[], float]
"""Seconds, by a clock that never goes back."""


class OnlineLoop:
    """One controller of a scenario, tick by tick, on whatever gives it measured joints.

    Args:
        scenario: from :func:`coopqp.load`. What it says of plant, duration and feeds of inputs does
            not matter here.
        controller: its name in the scenario, or any controller's type name.
        reference: from what the next command is reckoned. "commanded": from where the joints were
            told to be, as robots that hold one object firmly need it (docs/real_robots.md);
            what is measured teaches the gap. "measured": from where they are, for joints that do
            exactly as told, and for arms that yield and must be followed.
        grasp: "as_held": each hand holds the object where it is at the first tick; "as_written":
            as at the scenario's own start, the difference taken for the model's error.
        speed_up: time in which a joint may get from rest to its velocity limit [s], which is an
            acceleration limit where the scenario has none; None for none.
        clock: of ticks and of what is sent to inputs; None counts ticks, as in simulation, where
            none is late or early.
        silent_after: how long the last word of a robot counts that speaks less often [s].
        patience: time without measurement or tick after which it stops until :meth:`resume` [s].
        keep: how much of the past is kept in memory, an hour at most [s].
        phases: "by_time": as the scenario says; "asked": when :meth:`next_phase` says.
        out: folder for what is needed to play the session again (:mod:`coopqp.online.session`).
        record: makes a recording when the loop has begun.

    Attributes:
        command, status, note: of the last tick; the gravest, and what else is to be said of it.
        setpoint: where the joints shall be at the end of the period, shape (n,) [rad, m].
        history: the last ticks.
        watch: late and early ticks counted, the longest named.
        ticks, begun: how many there have been, early ones not counted; whether the object is held.
        patience, simulated: as given; simulated without a clock. measured: what was last believed.

    Raises:
        CoopqpError: an option is none; the controller cannot be built, or commands torques.
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
    ) -> None:
        check_options(locals())
        self._chosen = controller_of(scenario, controller)
        if self._chosen.commands_torques:
            words = "commands torques; the loop for robots commands velocities and positions"
            raise InvalidValueError(f"controller '{controller}' {words}")
        own, self.controller = scenario.held_by(controller), controller
        limits = with_acceleration(own.limits, own.chain, speed_up)
        self._given = replace(own, limits=limits)
        self._observed, self._as_held = reference == "commanded", grasp == "as_held"
        self._clock, self._by_time = clock, phases == "by_time"
        self.patience, self.simulated = patience, clock is None
        chain, dt = self._given.chain, self._given.dt
        self.history = History(chain, max(1, round(keep / dt)))
        self._readings, self._stops = Readings(chain, silent_after), Stops(patience)
        self.measured = self._readings.q
        self.setpoint, self._nothing = chain.q_start.copy(), np.full(chain.n, np.nan)
        self._refusal, self._holding = Command(chain.n), Command(chain.n)
        self._waiting = Waiting()
        self._keeper = Keeper(self, None if out is None else Path(out), record)
        self._interrupts = Interrupts(self.end)
        self.reset()

    def reset(self) -> None:
        """Forget all but the history; the next tick begins anew, where the robot is then."""
        self._keeper.close()
        self._phases = Phases(
            self._given, self._chosen, observed=self._observed, by_time=self._by_time
        )
        self._readings.forget()
        self._waiting.forget()
        self._stops.forget()
        self.watch = Watch(self._given.dt)
        self.ticks, self.begun, self._built = 0, False, False
        self._moved = False
        self.setpoint[:] = self._phases.now.problem.chain.q_start
        self._say(self._refuse(Status.OPTIMAL, ""))

    @property
    def scenario(self) -> Scenario:
        """As begun: its start is where the robot was."""
        return self._phases.scenario

    @property
    def source(self) -> str:
        """Its text, with what the loop has changed; empty where it was made in Python."""
        begun = self.scenario
        if not begun.source:
            return ""
        return scenario_text(begun, self._given, self.controller, (), {}, Path())

    @property
    def phases(self) -> tuple[PhaseRun, ...]:
        """The phases so far, the last one that which runs; none before the beginning."""
        return self._phases.done

    @property
    def state(self) -> State:
        """What the last tick decided from: commanded joints, kinematics, inputs."""
        return self._phases.now.state

    @property
    def law(self) -> Law:
        """The controller, built for this phase."""
        return self._phases.now.law

    @property
    def problem(self) -> ControlProblem:
        """What it was built for."""
        return self._phases.now.problem

    @property
    def phase(self) -> Phase:
        """The phase that runs."""
        return self._phases.now.phase

    @property
    def now(self) -> float:
        """By the loop's clock [s]."""
        return self._clock() if self._clock else self.ticks * self._given.dt

    @property
    def at_rest(self) -> bool:
        """Whether the last command was to stand still."""
        return not self.command.v.any()

    @property
    def stopped(self) -> str:
        """Why it does not go on until :meth:`resume`; empty while it goes on."""
        return self._stops.told

    @property
    def stopped_by_itself(self) -> bool:
        """Whether nobody has told it to stop: it has waited in vain, or could not go on."""
        return self._stops.by_itself and bool(self.stopped)

    @property
    def running(self) -> bool:
        """False once :meth:`end` was called and the robot is at rest."""
        return not (self._stops.ends and self.at_rest)

    def stop(self, why: object = "") -> None:
        """Come to rest, and stay there; references wait. Any thread may say so."""
        self._stops.stop(why)

    def end(self, why: object = "") -> None:
        """Come to rest for good; then :attr:`running` is False. Any thread may say so."""
        self._stops.end(why)

    def resume(self) -> None:
        """Go on: from where the robot is then, if it has come to rest. Any thread may say so."""
        self._stops.resume()

    def next_phase(self) -> None:
        """Go on to the next phase, as soon as the joints are slow enough to stop in one tick.

        Raises:
            InvalidValueError: there is none.
        """
        self._phases.ask()

    def begin(self, q: ArrayLike) -> None:
        """Take hold where the robot is; the first tick does it, if nobody has done it before.

        Args:
            q: measured, shape (n,), or that of the robot's own joints.

        Raises:
            CoopqpError: q is none, the object cannot be held so, or nothing can be written.
        """
        if self.begun:
            raise InvalidValueError("the loop has begun; reset it first")
        wrong = self._readings.take(q, self._given.chain.q_start, self.now)
        if wrong:
            raise InvalidValueError(f"q: {self._readings.note or wrong.value}")
        self._begin()

    def tick(self, q: Any, inputs: Mapping[str, Any] | None = None) -> Command:
        """One period.

        Called again before its period is over, it holds the last command and says ``EARLY``; what
        has come counts for the next tick.

        Args:
            q: where the joints are, shape (n,) [rad, m], or those of the robot alone without the
                grasps' passive joints; None where the robot says nothing.
            inputs: what has arrived since the last tick, by name: a value, or a value and when it
                was sent by the loop's clock [s]; ``hand_wrench`` where hands squeeze by it.

        Returns:
            The command for the next period; its arrays are reused. :attr:`setpoint` is where it
            leads.
        """
        before, now = time.perf_counter_ns(), self.now
        if left := self.watch.left(now):
            self._waiting.keep(q, inputs)
            return self._hold(left)
        try:
            command = self._tick(*self._waiting.take(q, inputs), now)
        except Exception as error:  # noqa: BLE001 - a robot must not be left alone with its speed
            command = self._refuse(Status.RAISED, raised(error))
        self._say(command)
        self._led = command
        state = self._phases.now.state
        np.multiply(command.v, self._phases.now.problem.dt, out=self.setpoint)
        np.add(state.q, self.setpoint, out=self.setpoint)
        us = 1e-3 * (time.perf_counter_ns() - before)
        heard = self._nothing if self._wrong else self._readings.q
        self.history.add(now, state, heard, command, us)
        self._keeper.tick(state, command, us)
        self.ticks += 1
        if self._built:
            self.watch.forget()
        self._built = False
        return command

    def flush(self) -> None:
        """Write out what is new of the session; in the time that a period leaves."""
        self._keeper.flush()

    def replay(self) -> Scenario:
        """The scenario that plays again what is on disk of the session so far; flushes it.

        Raises:
            InvalidValueError: there is no session.
        """
        if self._keeper.session is None:
            raise InvalidValueError("nothing is written: give the loop a folder, out")
        self.flush()
        return self._keeper.session.replay(self.phases)

    def close(self) -> None:
        """Write the record.

        Raises:
            CoopqpError: it could not be written.
        """
        self._keeper.close()
        if self._keeper.fault:
            raise CoopqpError(self._keeper.fault)

    def __reduce__(self) -> NoReturn:
        """Neither copied nor sent: two loops of one robot would both move it."""
        raise CoopqpError("a loop cannot be copied; make another from its scenario")

    def __enter__(self) -> OnlineLoop:
        """Ctrl-C and SIGTERM end the loop at rest from now on; the second one at once."""
        self._interrupts.take()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._interrupts.give_back()
        self.close()

    def _begin(self) -> None:
        self._phases.begin(self._readings.q.copy(), held=self._as_held)
        self._keeper.begin(self._given)
        self.begun = self._built = True

    def _tick(self, q: Any, inputs: Any, now: float) -> Command:
        self._advance()
        if self._stops.look():
            self._readings.forget()
        is_late = self.watch.tick(self.ticks, now)
        self._wrong = self._readings.take(q, self.state.q, now)
        self._stops.heard(self._wrong, now, self.watch.elapsed)
        if not self.begun:
            refused = self._try_to_begin()
            if refused:
                return refused
        self._go_by_measurement()
        if is_late:
            self._phases.arrivals.age(self.watch.elapsed - self.problem.dt)
        command = self._decide(inputs, now)
        if is_late:
            _add(command, Status.LATE)
        return command

    def _try_to_begin(self) -> Command | None:
        if self._wrong:
            return self._refuse(self._wrong, self._readings.note)
        if not self._stops.why:
            try:
                self._begin()
                return None
            except CoopqpError as error:  # not again by itself, when somebody moves the robot
                self._stops.halt(str(error))
                self._readings.forget()
        return self._refuse(Status.NOT_BEGUN, self._stops.why)

    def _advance(self) -> None:
        """Make of the last command what it has led to; while it only brakes, time stands still."""
        if self.begun:
            state, t = self.state, self.state.t
            state.advance(self._led.v, self.problem.dt)
            if not self._moved:
                state.t = t

    def _go_by_measurement(self) -> None:
        """Put what was measured where it belongs; begin anew after a stop, or with a new phase."""
        heard = None if self._wrong else self._readings.q
        if self._stops.goes_on_again and heard is not None and not self._stops.why:
            self._stops.goes_on_again = False
            if not self._led.v.any():
                self._phases.take_up(heard.copy())
                self._keeper.go_on()
        if self._observed:
            self.state.q_measured = self._nothing if heard is None else heard
        elif heard is not None:
            self.state.q[:] = heard
        if heard is None or self._stops.why or not self._phases.over:
            return
        self._built = self._phases.hand_over(heard.copy())
        if self._built and not self._phases.fault:
            self._keeper.go_on()
        elif self._phases.fault:
            self._stops.halt(self._phases.fault)

    def _decide(self, inputs: Any, now: float) -> Command:
        phases, run = self._phases, self._phases.now
        self._keeper.arrived(phases.take(inputs, now))
        halts = [cause for cause in (self._wrong, self._stops.cause) if cause]
        if phases.over:
            halts.append(Status.STOPPED)
        self._moved = not halts
        if not halts:
            run.ticks += 1
            return run.law.tick(run.state)
        command = phases.braking.tick(run.state)
        if not command.v.any():
            phases.rest_inputs()
        own = (c for c in command.causes if c not in (Status.OPTIMAL, Status.NOT_MEASURED, *halts))
        command.say(*dict.fromkeys(halts), *own)
        waits = f"before phase {run.index + 2}" if phases.over else ""
        notes = (self._readings.note, self._stops.why, waits, *run.state.inputs.refused)
        command.note = "; ".join(note for note in notes if note)
        return command

    def _refuse(self, why: Status, note: str) -> Command:
        """Stand still at once, where nothing is known."""
        command, self._moved = self._refusal, False
        self._led, self._wrong = command, why
        command.v[:] = 0.0
        command.say(why)
        command.note = note
        return command

    def _hold(self, left: float) -> Command:
        """Go on as the last command says: who ticks too often must not move faster."""
        held = self._holding
        held.v[:] = 0.0 if self.watch.stands else self._led.v  # else it might never end
        held.say(Status.EARLY)
        held.note = f"{1e3 * left:.3g} ms of the period are left; wait for its end"
        return self._say(held)

    def _say(self, command: Command) -> Command:
        self.command, self.status, self.note = command, command.status, command.note
        return command


def _add(command: Command, cause: Status) -> None:
    command.say(*(c for c in command.causes if c is not Status.OPTIMAL), cause)
