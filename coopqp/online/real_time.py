"""The loop with a robot and a clock: it keeps the period, and leaves the robot at rest.

A garbage collection stops Python for 20 ms and more with all that a scenario has built, at any
time. So all garbage is collected before the first tick, what is left is frozen and the collector
switched off; the little garbage of ticks is collected in the rest of a period.

Sleeping is not exact, so the last part of a period is a busy wait. After a late tick the next comes
a whole period later: ticks in quick succession would ask for as much motion in less time.
"""

from __future__ import annotations

import gc
import inspect
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.spec import Array
from coopqp.base.wording import raised
from coopqp.controller import Command
from coopqp.online.loop import OnlineLoop
from coopqp.online.options import time_fault


class Robot(Protocol):
    """A driver of a robot; any class with these two methods.

    A third, ``grip(grippers)``, is called after ``write`` where it is there, whenever an arm's
    gripper shall "open" or "close": :attr:`coopqp.controller.Command.grippers`.
    """

    def read(self) -> ArrayLike | None:
        """Measured joints, shape (n,) [rad, m], in the chain's order; None without a measurement.

        The grasps' passive joints may be missing. It returns what came last and does not wait. If
        that came before the last tick, None is the better answer, with ``silent_after`` of the
        loop: a joint may have gone farther in many ticks than in one.
        """

    def write(self, q: Array, v: Array) -> None:
        """Command joint positions or velocities, whichever the robot takes.

        Args:
            q: at the end of the period, shape (n,) [rad, m].
            v: until then, shape (n,) [rad/s, m/s]; zero to stand still.
        """


class TorqueRobot(Protocol):
    """A driver of a robot whose motors take torques."""

    def read(self) -> ArrayLike | None:
        """As of :class:`Robot`, joints and their velocities, shape (2, n) [rad, m; rad/s, m/s]."""

    def apply(self, tau: Array) -> None:
        """Command torques, shape (n,) [N m, N], gravity's among them.

        The last one, at the loop's end, holds the arms at rest; nothing corrects it after that.
        """


#: Busy wait at the end of a period [s].
AWAKE = 1.5e-4
#: Time between garbage collections and between writings of the session [s]; the rest of a period
#: that one of them needs, as a share of it.
EVERY, LEFT = 0.25, 0.4
#: From a tick so late, as a share of a period, the next is a whole period away.
BEHIND = 0.4
#: A period by the loop's clock is waited for no longer than so many by the machine's, unless told.
LONGEST = 2.0

InputsNow = Callable[[], Mapping[str, Any] | None]
"""What has arrived since the last call, as :meth:`OnlineLoop.tick` takes it; never waits."""


@dataclass(frozen=True)
class Ended:
    """How a loop ended: the longest time between two ticks [s], the number of the tick after it."""

    why: str
    ticks: int
    late: int
    longest: float
    longest_tick: int

    def __str__(self) -> str:
        if not self.ticks:
            return self.why
        slow = f"the longest wait was {1e3 * self.longest:.2f} ms, before tick {self.longest_tick}"
        return f"{self.why}; {self.late} of {self.ticks} ticks late, {slow}"


def real_time(
    loop: OnlineLoop,
    robot: Robot | TorqueRobot,
    *,
    inputs: InputsNow | None = None,
    duration: float | None = None,
    slowest: float | None = None,
) -> Ended:
    """Run a loop on a robot until something ends it; the robot is then commanded to stand still.

    It ends, at rest, at Ctrl-C and SIGTERM, after the duration, at :meth:`OnlineLoop.end`, and when
    the loop has stopped by itself, as after a silence of the robot. After :meth:`OnlineLoop.stop`
    it waits at rest for :meth:`OnlineLoop.resume`.

    Args:
        loop: not begun yet, or at rest; with a clock.
        robot: its driver.
        inputs: what has arrived; nothing does when omitted.
        duration: [s]; without an end when omitted.
        slowest: what a period by the loop's clock may take of the machine's time, where that is the
            clock of a slow simulation; two periods when omitted [s].

    Raises:
        InvalidValueError: an argument is none; the loop counts ticks, or has ended.
        CoopqpError: the loop cannot begin where the robot is, or the record could not be written.
        Exception: what the robot, or ``inputs``, has raised, after the robot came to rest; at once
            where it was ``write``.
    """
    _check(loop, robot, inputs, duration, slowest)
    run = _Run(loop, robot, inputs, duration, slowest)
    with loop:
        try:
            run.begin()
            with _collecting_when_told():
                run.until_the_end()
        finally:
            with suppress(Exception):  # nobody is left to be told
                run.stand()
    if run.user.fault:
        raise run.user.fault
    watch = loop.watch
    return Ended(loop.stopped, loop.ticks, watch.late, watch.longest, watch.longest_tick)


def check_driver(robot: Any, *, by_torques: bool = False) -> None:
    """InvalidValueError where it lacks a method, or has one that takes something else."""
    for name, given in (("read", ""), ("apply", "tau") if by_torques else ("write", "q v")):
        method, arguments = getattr(robot, name, None), given.split()
        if not callable(method):
            raise InvalidValueError(f"robot: a {type(robot).__name__} has no method {name}")
        try:
            inspect.signature(method).bind(*arguments)
        except TypeError as error:  # of a class in the place of an object, for one
            raise InvalidValueError(f"robot: {name}({', '.join(arguments)}): {error}") from None
        except ValueError:  # what is not written in Python may not say what it takes
            continue


def _check(loop: Any, robot: Any, inputs: Any, duration: Any, slowest: Any) -> None:
    if not isinstance(loop, OnlineLoop):
        raise InvalidValueError(f"loop: found a {type(loop).__name__}, needs an OnlineLoop")
    check_driver(robot, by_torques=loop.by_torques)
    if not (inputs is None or callable(inputs)):
        words = "needs a function that says what has arrived"
        raise InvalidValueError(f"inputs: found a {type(inputs).__name__}, {words}")
    for name, given in (("duration", duration), ("slowest", slowest)):
        if fault := time_fault(given, none=True):
            raise InvalidValueError(f"{name}: {fault}")
    if loop.simulated:
        raise InvalidValueError("the loop counts ticks; give it a clock to run in real time")
    if loop.ticks and not loop.running:
        raise InvalidValueError(f"the loop has ended ({loop.stopped}); reset it first")


class UserCode:
    """Calls a robot's driver and others until the first ``fault``, of which ``end`` is told."""

    def __init__(self, end: Callable[[str], None]) -> None:
        self._end = end
        self.fault: Exception | None = None

    def ask(self, who: Callable[[], Any] | None) -> Any:
        if who is None or self.fault:
            return None
        try:
            return who()
        except Exception as error:  # noqa: BLE001 - the robot has to come to rest first
            self.fault = error
            self._end(raised(error))
            return None


class _Run:
    def __init__(
        self, loop: OnlineLoop, robot: Any, inputs: Any, duration: float | None, slowest: Any
    ) -> None:
        self._loop, self._robot, self._inputs = loop, robot, inputs
        self._dt = loop.problem.dt
        self._duration = np.inf if duration is None else duration
        self._slowest = LONGEST * self._dt if slowest is None else slowest
        self.user = UserCode(loop.end)
        self._flushed = self._collected = 0.0
        self._grip: Callable[[Any], Any] | None = getattr(robot, "grip", None)
        self._gripped: Mapping[str, str] = {}

    def begin(self) -> None:
        loop = self._loop
        until = loop.now + loop.patience
        while not loop.begun:
            if (q := self._robot.read()) is not None:
                loop.begin(q)
            elif loop.now > until:
                raise CoopqpError(f"the robot has said nothing for {loop.patience:g} s")
            else:
                time.sleep(self._dt)

    def until_the_end(self) -> None:
        loop, due = self._loop, self._loop.now
        until = due + self._duration
        while loop.running:
            q, given = self.user.ask(self._robot.read), self.user.ask(self._inputs)
            command = loop.tick(q, given)
            self._write(command)
            if self._grip and command.grippers != self._gripped:
                self._gripped = command.grippers
                self.user.ask(partial(self._grip, dict(command.grippers)))
            if loop.stopped_by_itself and loop.at_rest:
                loop.end(loop.stopped)
            elif loop.now >= until:
                loop.end("the time is up")
            began = loop.watch.began
            due = max((began if began - due > BEHIND * self._dt else due) + self._dt, loop.now)
            self._use_what_is_left(due)
            self._wait(due)

    def _write(self, command: Command) -> None:
        if not self._loop.by_torques:
            self._robot.write(self._loop.setpoint, command.v)
        elif command.tau is not None:
            self._robot.apply(command.tau)

    def stand(self) -> None:
        """The last command: to stand still; of torques, those that hold the arms where they are."""
        loop = self._loop
        if not loop.by_torques:
            self._robot.write(loop.setpoint, np.zeros_like(loop.setpoint))
        elif loop.begun:
            loop.law.hold_still(loop.state)
            self._robot.apply(loop.law.command.tau)

    def _use_what_is_left(self, due: float) -> None:
        """Collect garbage, or write the session, if the period leaves time for one of them."""
        now = self._loop.now
        if due - now < LEFT * self._dt:
            return
        if now - self._collected > EVERY:
            self._collected = now
            gc.collect()
        elif now - self._flushed > EVERY:
            self._flushed = now
            self._loop.flush()

    def _wait(self, due: float) -> None:
        until = time.monotonic() + self._slowest  # the loop's clock may stand, or go back
        while (left := due - self._loop.now) > 0.0 and time.monotonic() < until:
            if left > AWAKE:
                time.sleep(min(left - AWAKE, self._dt))


@contextmanager
def _collecting_when_told() -> Iterator[None]:
    """No collection of garbage by itself, and none of what is there already."""
    by_itself = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.unfreeze()
        if by_itself:
            gc.enable()
