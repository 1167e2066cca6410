"""A check before the grasp: each joint moves a little, and what it measures must be that.

One joint after the other goes forth by 20 mrad (10 mm where it slides) towards the middle of its
range, rests, and comes back. At rest neither lag nor delay of the servos count, and sag is the same
before and after, so that

    r_i = (mean of q_i while there - mean of q_i before and after) / way

is 1 for the joint that is moved and 0 for all others.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.base.wording import raised
from coopqp.online.arrivals import Readings
from coopqp.online.beginning import check_range
from coopqp.online.loop import OnlineLoop
from coopqp.online.phases import acceleration_limits
from coopqp.online.real_time import Robot, check_driver
from coopqp.online.stops import Interrupts

#: How far joints go [rad], [m]; less where half of the range is less.
WAY, WAY_SLIDING = 0.02, 0.01
#: A joint with less of a range is locked.
LOCKED = 1e-4
#: How fast at most [rad/s; half as much in metres], and as shares of the limits.
SPEED, ACCELERATION, SHARE = 0.1, 1.0, 0.5
#: Time for lag and delay to pass, and for a mean, of so many readings at least [s].
SETTLE, MEAN, READINGS = 0.3, 0.15, 10
#: A joint farther off than so many ways has gone astray, and is called back.
ASTRAY = 3.0
#: Largest r of a joint that counts as still; least and largest r of one that follows.
STILL, LEAST, MOST = 0.3, 0.7, 1.3
#: So many standard errors of r must be less than STILL, or noise is too large to tell.
SURE = 4.0


@dataclass(frozen=True)
class JointCheck:
    """What a check of the joints has found; its text is what to tell people.

    Attributes:
        joints: that were to be checked, k of them.
        response: r of all joints (columns) to each (rows), NaN if not checked, shape (k, k).
        faults: by joint, what is wrong with it.
        stopped: why it did not come to its end; empty if it did.
    """

    joints: tuple[str, ...]
    response: Array
    faults: dict[str, str]
    stopped: str

    @property
    def ok(self) -> bool:
        """Whether every joint was checked and follows."""
        return not (self.faults or self.stopped)

    def __str__(self) -> str:
        lines = [f"{joint} {words}" for joint, words in self.faults.items()]
        missed = int(np.isnan(self.response).any(axis=1).sum())
        if self.stopped:
            lines.append(f"stopped, with {missed} joints not checked: {self.stopped}")
        return "\n".join(lines) or f"all {len(self.joints)} joints follow"


def check_joints(loop: OnlineLoop, robot: Robot) -> JointCheck:
    """Move each joint forth and back by 20 mrad, to find wrong signs, units and orders of joints.

    The hands must hold nothing, and nothing be within a few centimetres: only joints have limits
    here. It takes some 1.5 s a joint, keeps the loop's period, velocity and acceleration limits,
    and always leaves the robot commanded to stand still: after Ctrl-C, SIGTERM, a silence longer
    than the loop's patience, and errors of the driver, which are raised.

    Args:
        loop: not begun; nothing of it changes.
        robot: its driver, as of :func:`coopqp.real_time`.

    Raises:
        InvalidValueError: the loop has begun; joints are out of their range; no driver.
    """
    check_driver(robot)
    if loop.begun:
        raise InvalidValueError("the loop has begun, and its hands hold the object; reset it first")
    check = _Check(loop, robot)
    interrupts = Interrupts(check.end)
    interrupts.take()
    try:
        found = check.run()
    finally:
        interrupts.give_back()
        with suppress(Exception):  # nobody is left to be told
            check.stand()
    if check.fault:
        raise check.fault
    return found


@dataclass
class _Rest:
    """Readings at rest: mean and standard error of each joint."""

    mean: Array
    error: Array


@dataclass
class _Check:
    loop: OnlineLoop
    robot: Robot
    stopped: str = ""
    faults: dict[str, str] = field(default_factory=dict)
    fault: Exception | None = None

    def __post_init__(self) -> None:
        loop, problem = self.loop, self.loop.problem
        self._chain, self._dt = problem.chain, problem.dt
        chain, slides = self._chain, np.array([unit == "m" for unit in self._chain.joint_units])
        self._way = np.minimum(
            np.where(slides, WAY_SLIDING, WAY), 0.5 * (chain.upper - chain.lower)
        )
        with np.errstate(invalid="ignore"):  # of a joint without limits
            self._middle = 0.5 * (chain.lower + chain.upper)
        self._own = np.setdiff1d(np.flatnonzero(self._way > LOCKED), chain.passive)
        slower = np.where(slides, WAY_SLIDING / WAY, 1.0)
        self._speed = np.minimum(SPEED * slower, SHARE * np.abs(chain.velocity))
        most = acceleration_limits(problem)
        self._step = np.minimum(ACCELERATION * slower, SHARE * most) * self._dt
        self._readings = Readings(chain)
        self._q, self._v = chain.q_start.copy(), np.zeros(chain.n)
        self._gone = np.zeros(chain.n)  # farthest from rest
        self._rest: Array | None = None
        self._moves, self._silent, self._due = False, 0.0, loop.now

    def end(self, why: str) -> None:
        self.stopped = self.stopped or why

    def stand(self) -> None:
        """Command to stay, whatever the driver does."""
        if self._moves:
            self.robot.write(self._q.copy(), np.zeros_like(self._q))

    def run(self) -> JointCheck:
        names, own = self._chain.joint_names, self._own
        joints, response = tuple(names[i] for i in own), np.full((len(own), len(own)), np.nan)
        try:
            before = self._look()
            if not self.stopped:
                self._begin(before)
                before = self._look(SETTLE)
                self._stays(before)
            for k, i in enumerate(own):
                if self.stopped:
                    break
                answer, before = self._ask(int(i), before)
                if not self.stopped:
                    response[k] = answer
        finally:
            self._brake()
        return JointCheck(joints, response, self.faults, self.stopped)

    def _begin(self, first: _Rest) -> None:
        """Hold the robot where it is; nothing is written before."""
        if not self.loop.scenario.start_outside:
            check_range(self._chain, first.mean)
        self._q[:], self._rest, self._moves = first.mean, first.mean, True

    def _ask(self, i: int, before: _Rest) -> tuple[Array, _Rest]:
        """The answer r of the robot's joints to one that is moved, and the rest after it."""
        way = -self._way[i] if self._q[i] > self._middle[i] else self._way[i]
        home, self._rest, self._gone[:] = self._q[i], before.mean, 0.0
        farthest = self._go(i, home + way)
        there = None if self._astray() else self._look(SETTLE)
        self._go(i, home, back=True)
        after = self._look(SETTLE)
        self._stays(after)
        if there is None:
            gone = np.where(np.abs(self._gone) > self._way, self._gone, 0.0)
            moved, error = gone / farthest, np.zeros_like(gone)
        else:
            moved = (there.mean - 0.5 * (before.mean + after.mean)) / way
            error = np.sqrt(there.error**2 + 0.5 * (before.error**2 + after.error**2)) / abs(way)
        if not self.stopped and (words := self._judge(i, moved, error)):
            self.faults[self._chain.joint_names[i]] = words
        return moved[self._own], after

    def _judge(self, i: int, moved: Array, error: Array) -> str:
        """What is wrong with a joint, by r of all joints and its standard error."""
        names, r = self._chain.joint_names, moved[i]
        if SURE * error[i] > STILL:
            return f"cannot be judged: noise, {SURE * error[i]:.2g} of its way, is too large"
        others = [int(k) for k in self._own if k != i and abs(moved[k]) > STILL]
        others = [k for k in others if abs(moved[k]) > SURE * error[k]]
        if abs(r) < STILL and others:
            k = max(others, key=lambda k: abs(moved[k]))
            way = ", the other way" if moved[k] < 0.0 else ""
            return f"does not move, and {names[k]} does instead{way}: are they swapped?"
        if abs(r) < STILL:
            asks = "is its motor on, its encoder alive, its command in other units, as degrees?"
            return f"does not move: {100.0 * r:.0f} % of its way; {asks}"
        words = []
        if r < 0.0:
            words.append("moves the other way: sign of its encoder or motor?")
        if not LEAST <= abs(r) <= MOST:
            units = "degrees?" if abs(r) > ASTRAY else "gear ratio, units?"
            words.append(f"moves {abs(r):.2g} times as far as commanded: {units}")
        if others:
            words.append(f"moves {', '.join(names[k] for k in others)}, too")
        return "; ".join(words)

    def _stays(self, found: _Rest) -> None:
        """Stop where a joint is elsewhere than it was told to stay."""
        assert self._rest is not None
        off = found.mean - self._rest
        k = int(self._own[np.argmax(np.abs(off / self._way)[self._own])])
        if not self.stopped and abs(off[k]) > self._way[k]:
            name, unit = self._chain.joint_names[k], self._chain.joint_units[k]
            words = f"is {off[k]:+.2g} {unit} from where it was told to stay"
            self.faults[name] = f"{words}: sign or units of its commands?"
            self.end(f"{name} does not stay")

    def _go(self, i: int, goal: float, *, back: bool = False) -> float:
        """Move a joint until it is there, astray or stopped; how far it was sent at most."""
        began, farthest = self._q[i], 1e-9
        while not self.stopped and (back or not self._astray()):
            left = goal - self._q[i]
            if abs(left) < 1e-12 and not self._v[i]:
                break
            self._period(i, self._toward(i, left))
            farthest = max(farthest, abs(self._q[i] - began), key=abs)
        return float(np.copysign(farthest, goal - began))

    def _toward(self, i: int, left: float) -> float:
        """The next speed: the largest from which it stops in time, within both limits."""
        step, dt = self._step[i], self._dt
        stops = np.sqrt(0.25 * step**2 + 2.0 * step * abs(left) / dt) - 0.5 * step
        wish = np.copysign(min(stops, abs(left) / dt, self._speed[i]), left)
        return float(np.clip(wish, self._v[i] - step, self._v[i] + step))

    def _brake(self) -> None:
        while self._moves and self._v.any():
            i = int(np.argmax(np.abs(self._v)))
            self._period(i, self._v[i] - float(np.clip(self._v[i], -self._step[i], self._step[i])))

    def _astray(self) -> bool:
        return bool((np.abs(self._gone) > ASTRAY * self._way)[self._own].any())

    def _look(self, wait: float = 0.0) -> _Rest:
        """Rest, and take the mean of what is measured after a while."""
        n, t, found = self._chain.n, 0.0, list[Array]()
        while not self.stopped and (t < wait + MEAN or len(found) < READINGS):
            reading, t = self._period(), t + self._dt
            if reading is not None and t > wait:
                found.append(reading)
        if len(found) < 2:
            return _Rest(self._q.copy(), np.full(n, np.inf))
        return _Rest(np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / len(found) ** 0.5)

    def _period(self, i: int = 0, v: float = 0.0) -> Array | None:
        """Command one joint's velocity for a period; what is measured at its end, if anything."""
        self._v[:] = 0.0
        self._v[i] = v
        self._q += self._dt * self._v
        if self._moves:
            self.robot.write(self._q.copy(), self._v.copy())
        self._wait()
        self._readings.forget()
        wrong = self._readings.take(self._read(), self._q, self.loop.now)
        self._silent = self._silent + self._dt if wrong else 0.0
        if self._silent > self.loop.patience:
            words = self._readings.note
            self.end(f"no usable measurement for {self.loop.patience:g} s: {words}")
        if wrong:
            return None
        reading = self._readings.q.copy()
        if self._rest is not None:
            off = reading - self._rest
            self._gone = np.where(np.abs(off) > np.abs(self._gone), off, self._gone)
        return reading

    def _read(self) -> object:
        """What the driver says; None once it has raised."""
        if self.fault:
            return None
        try:
            return self.robot.read()
        except Exception as error:  # noqa: BLE001 - the robot has to come to rest first
            self.fault = error
            self.end(raised(error))
            return None

    def _wait(self) -> None:
        """Sleep until the period is over, by the loop's clock."""
        if self.loop.simulated:
            return
        self._due = max(self._due + self._dt, self.loop.now)
        time.sleep(min(max(self._due - self.loop.now, 0.0), self._dt))
