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
from dataclasses import dataclass

import numpy as np

from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain
from coopqp.online.arrivals import Readings
from coopqp.online.beginning import check_range, posed_mistake, staying_mistake
from coopqp.online.loop import OnlineLoop
from coopqp.online.phases import acceleration_limits
from coopqp.online.real_time import Robot, UserCode, check_driver
from coopqp.online.stops import Interrupts

Rest = tuple[Array, Array]
"""Mean and standard error of what each joint measures at rest."""

#: How far joints go [rad], [m]; less where half of the range is less.
WAY, WAY_SLIDING = 0.02, 0.01
#: A joint that seems not to follow goes again, so many times as far: backlash of a degree takes up
#: most of the way of a sound one.
AGAIN = 5.0
#: A joint with less of a range is locked.
LOCKED = 1e-4
#: How fast at most [rad/s; half as much in metres], and as shares of the limits.
SPEED, ACCELERATION, SHARE = 0.1, 1.0, 0.5
#: Time for lag and delay to pass, and for a mean, of so many readings at least [s].
SETTLE, MEAN, READINGS = 0.3, 0.15, 10
#: A joint farther off than so many ways has gone astray, and is called back.
ASTRAY = 3.0
#: A joint that rests elsewhere than before by more ways than backlash explains does not stay.
ELSEWHERE = 1.5
#: By so much a joint may be off where arms are put by hand [rad]; metres slide by as much.
POSED = 0.2
#: Largest r of a joint that counts as still; least and largest r of one that follows.
STILL, LEAST, MOST = 0.3, 0.7, 1.3
#: So many standard errors of r must be less than STILL, or noise is too large to tell.
SURE = 4.0


@dataclass(frozen=True)
class JointCheck:
    """What a check of the joints has found; its text is what to tell people."""

    joints: tuple[str, ...]  #: That were to be checked, k of them.
    response: Array  #: r of all joints (columns) to each (rows), NaN if not checked, shape (k, k).
    faults: dict[str, str]  #: By joint, what is wrong with it.
    stopped: str  #: Why it did not come to its end; empty if it did.

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

    The first command is to stay. A joint that runs away at it ends the check at the second reading,
    and the command stands: with what is read wrong, another one could lead it farther.

    Args:
        loop: not begun; nothing of it changes.
        robot: its driver, as of :func:`coopqp.real_time`.

    Raises:
        InvalidValueError: the loop has begun, or commands torques; joints are out of their range;
            no driver.
    """
    check_driver(robot)
    if loop.by_torques:
        words = "commands torques; check joints by a loop of a controller that commands velocities"
        raise InvalidValueError(f"controller '{loop.controller}' {words}, such as qp")
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
    if check.user.fault:
        raise check.user.fault
    return found


def first_reading(loop: OnlineLoop, robot: Robot) -> Array:
    """The first joints (n,) that a robot measures; CoopqpError after the loop's patience."""
    check_driver(robot)
    readings, t = Readings(loop.problem.chain), 0.0
    while readings.take(robot.read(), loop.problem.chain.q_start, t):
        if t > loop.patience:
            words = f"no usable measurement for {loop.patience:g} s"
            raise CoopqpError(f"{words}: {readings.note}")
        t += loop.problem.dt
        time.sleep(loop.problem.dt)
    return readings.q


def pose_faults(chain: ClosedChain, q: Array) -> dict[str, str]:
    """What joints q (n,) of arms that are put by hand as at the chain's start have wrong, by joint.

    It sees what reading and commanding have wrong alike, to which :func:`check_joints` is blind, of
    joints that are :data:`POSED` and more from zero there, and from each other.
    """
    start, whole = chain.q_start, posed_mistake(chain, q, POSED)
    faults = dict[str, str]()
    for i in np.flatnonzero(~(np.abs(q - start) <= POSED)).tolist():
        own = "its sign" if abs(q[i] + start[i]) <= POSED else "its zero, units or place"
        unit = chain.joint_units[i]
        words = f"reads {q[i]:.3g} {unit} where it is put to {start[i]:.3g} {unit}"
        faults[chain.joint_names[i]] = f"{words}: {whole or own}?"
    return faults


class _Check:
    def __init__(self, loop: OnlineLoop, robot: Robot) -> None:
        self.loop, self.robot, self.stopped = loop, robot, ""
        self.faults = dict[str, str]()
        self.user = UserCode(self.end)
        self._chain, self._dt = chain, dt = loop.problem.chain, loop.problem.dt
        scale = np.where(np.array(chain.joint_units) == "m", WAY_SLIDING / WAY, 1.0)
        self._way = np.minimum(WAY * scale, 0.5 * (chain.upper - chain.lower))
        self._own = np.setdiff1d(np.flatnonzero(self._way > LOCKED), chain.passive)
        self._ours = np.isin(np.arange(chain.n), self._own)
        self._speed = np.minimum(SPEED * scale, SHARE * np.abs(chain.velocity))
        max_acceleration = SHARE * acceleration_limits(loop.problem)
        self._step = np.minimum(ACCELERATION * scale, max_acceleration) * dt
        self._readings, self._rest = Readings(chain), chain.q_start
        self._q, self._v, self._gone = chain.q_start.copy(), np.zeros(chain.n), np.zeros(chain.n)
        self._noise, self._unsure, self._margin = np.zeros((3, chain.n))
        self._moves, self._silent, self._due = False, 0.0, loop.now

    def end(self, why: str) -> None:
        self.stopped = self.stopped or why

    def stand(self) -> None:
        if self._moves:
            self.robot.write(self._q.copy(), np.zeros_like(self._q))

    def run(self) -> JointCheck:
        names, own = self._chain.joint_names, self._own
        response = np.full((len(own), len(own)), np.nan)
        try:
            before, error = self._look()
            if not self.stopped:  # nothing is written before
                if not self.loop.scenario.start_outside:
                    check_range(self._chain, before)
                self._q[:], self._rest, self._moves = before, before, True
                self._unsure = SURE * error / np.maximum(self._way, LOCKED)
                self._margin = np.where(self._unsure > STILL, SURE * self._noise, 0.0)
                rest = self._look(SETTLE, runs=True)
                self._stays(rest[0])
            for k, i in enumerate(own):
                if self.stopped:
                    break
                answer, rest = self._test_joint(int(i), rest)
                if not self.stopped:
                    response[k] = answer
        finally:
            while self._moves and self._v.any():
                i = int(np.argmax(np.abs(self._v)))
                self._period(i, self._toward(i, 0.0))
        return JointCheck(tuple(names[i] for i in own), response, self.faults, self.stopped)

    def _test_joint(self, i: int, rest: Rest) -> tuple[Array, Rest]:
        """The answer r of the robot's joints to one that is moved, and the rest after it."""
        if self._unsure[i] > STILL:  # it would seem to go astray: it stays
            self.faults[self._chain.joint_names[i]] = _hidden(self._unsure[i])
            return np.full(len(self._own), np.nan), rest
        moved, error, rest = self._moved(i, rest)
        alone = np.abs(np.delete(moved, i)).max(initial=0.0) < STILL
        if not self.stopped and -STILL < moved[i] < LEAST and alone:  # maybe for its backlash
            moved, error, rest = self._moved(i, rest, times=AGAIN)
        if not self.stopped and (words := self._judge(i, moved, error)):
            self.faults[self._chain.joint_names[i]] = words
        return moved[self._own], rest

    def _moved(self, i: int, rest: Rest, *, times: float = 1.0) -> tuple[Array, Array, Rest]:
        """How far all joints go by the way of one, the standard error, and the rest after it."""
        before, error = rest
        home, lower, upper = self._q[i], self._chain.lower[i], self._chain.upper[i]
        far = min(times * self._way[i], 0.5 * (upper - lower))
        way = -far if home - lower > upper - home else far
        self._rest, self._gone[:] = before, 0.0
        farthest = self._go(i, home + way)
        there = None if self._astray() else self._look(SETTLE)
        self._go(i, home, back=True)
        after, error_after = rest = self._look(SETTLE)
        self._stays(after)
        if there is None:
            gone = np.abs(self._gone) > self._way + self._margin
            moved = np.where(gone, self._gone, 0.0) / farthest
            error = np.zeros_like(moved)
        else:
            moved = (there[0] - 0.5 * (before + after)) / way
            error = np.sqrt(there[1] ** 2 + 0.5 * (error**2 + error_after**2)) / abs(way)
        return moved, error, rest

    def _judge(self, i: int, moved: Array, error: Array) -> str:
        names, r = self._chain.joint_names, moved[i]
        if SURE * error[i] > STILL:
            return _hidden(SURE * error[i])
        others = [int(k) for k in self._own if k != i and abs(moved[k]) > STILL]
        others = [k for k in others if abs(moved[k]) > SURE * error[k]]
        if abs(r) < STILL and others:
            k = max(others, key=lambda k: abs(moved[k]))
            way = ", the other way" if moved[k] < 0.0 else ""
            return f"does not move, and {names[k]} does instead{way}: are they swapped?"
        if abs(r) < STILL:
            asks = "is its motor on, its encoder alive, its command in other units, as degrees?"
            return f"does not move: {round(100.0 * r)} % of its way; {asks}"
        words = []
        if r < 0.0:
            words.append("moves the other way: sign of its encoder or motor?")
        if not LEAST <= abs(r) <= MOST:
            units = "degrees?" if abs(r) > ASTRAY else "gear ratio, units?"
            words.append(f"moves {abs(r):.2g} times as far as commanded: {units}")
        if others:
            words.append(f"moves {', '.join(names[k] for k in others)}, too")
        return "; ".join(words)

    def _stays(self, mean: Array) -> None:
        """Stop where a joint is elsewhere than it was told to stay."""
        off = mean - self._rest
        far = np.abs(off) - self._margin
        k = int(self._own[np.argmax((far / self._way)[self._own])])
        if not self.stopped and far[k] > ELSEWHERE * self._way[k]:
            name, unit = self._chain.joint_names[k], self._chain.joint_units[k]
            words = "its sign, units or place in the order of joints are wrong"
            hint = staying_mistake(self._chain, self._rest, np.where(self._ours, off, 0.0))
            # One joint's way back through zero does not tell a sign from a unit.
            words = words if hint in ("", f"sign of {name}") else f"{hint}?"
            self.faults[name] = (
                f"moves by {off[k]:+.2g} {unit} although it is told to stay: {words}"
            )
            self.end(f"{name} does not stay; the arm may go on moving: switch its motors off")

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

    def _astray(self) -> bool:
        return bool((np.abs(self._gone) > ASTRAY * self._way + self._margin)[self._own].any())

    def _look(self, wait: float = 0.0, *, runs: bool = False) -> Rest:
        """Rest; mean and standard error of what each joint measures after a while.

        With ``runs`` a joint may run away, and two readings of it are enough to stop.
        """
        n, t, found, astray = self._chain.n, 0.0, list[Array](), 0
        while not self.stopped and (t < wait + MEAN or len(found) < READINGS):
            self._gone[:] = 0.0 if runs else self._gone
            reading, t = self._period(), t + self._dt
            if runs and reading is not None:
                astray = astray + 1 if self._astray() else 0
                if astray == 2:  # one may be noise
                    self._stays(reading)
            if reading is not None and t > wait:
                found.append(reading)
        if len(found) < 2:
            return self._q.copy(), np.full(n, np.inf)
        self._noise = np.std(found, axis=0, ddof=1)
        return np.mean(found, axis=0), self._noise / len(found) ** 0.5

    def _period(self, i: int = 0, v: float = 0.0) -> Array | None:
        """Command one joint's velocity for a period; what is measured at its end, if anything."""
        self._v[:] = 0.0
        self._v[i] = v
        self._q += self._dt * self._v
        if self._moves:
            self.robot.write(self._q.copy(), self._v.copy())
        if not self.loop.simulated:
            self._due = max(self._due + self._dt, self.loop.now)
            time.sleep(min(max(self._due - self.loop.now, 0.0), self._dt))
        self._readings.forget()
        wrong = self._readings.take(self.user.ask(self.robot.read), self._q, self.loop.now)
        self._silent = self._silent + self._dt if wrong else 0.0
        if self._silent > self.loop.patience:
            seconds = f"{self.loop.patience:g} s"
            self.end(f"no usable measurement for {seconds}: {self._readings.note}")
        if wrong:
            return None
        reading = self._readings.q.copy()
        off = reading - self._rest
        self._gone = np.where(np.abs(off) > np.abs(self._gone), off, self._gone)
        return reading


def _hidden(share: float) -> str:
    return f"cannot be judged: noise, {share:.2g} of its way, is too large"
