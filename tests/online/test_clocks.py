"""Clocks that fail in the midst of a session: the arms come to rest, and it is said why."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from decimal import Decimal
from itertools import count
from typing import Any

import numpy as np
import pytest
from online_loops import Machine, Scripted, follows

import coopqp.online.real_time
from coopqp import OnlineLoop, Status
from coopqp.assessment.thresholds import SPEED_UP
from coopqp.online.real_time import real_time
from coopqp.online.stops import LoopTime

DT = 0.01
NEAR = {"target": [0.15, 0.01, 0.05]}
FAULTY = 40
"""The first reading of which something is wrong: the arms are at speed."""


class Broken:
    """A clock that goes on by a period a tick, and from a tick on says what is given.

    ``says`` makes of the k-th tick since then, and of the right time, what the clock says.
    """

    def __init__(self, says: Callable[[int, float], Any]) -> None:
        self.tick, self._says = 0, says

    def __call__(self) -> Any:
        right = 100.0 + DT * self.tick
        return right if self.tick < FAULTY else self._says(self.tick - FAULTY, right)


def raises(k: int, right: float) -> float:
    """Another library's clock may do this."""
    raise OSError("no time server")


class Mute(float):
    """A number that fails."""

    def __float__(self) -> float:
        raise RuntimeError

    def __lt__(self, other: object) -> bool:
        raise RuntimeError


SAYS: dict[str, tuple[Callable[[int, float], Any], str]] = {
    "nan": (lambda k, t: math.nan, "the clock says nan, needs seconds"),
    "infinite": (lambda k, t: math.inf, "the clock says inf"),
    "none": (lambda k, t: None, "the clock says None"),
    "text": (lambda k, t: "12:00", "the clock says '12:00'"),
    "true": (lambda k, t: True, "the clock says True"),
    "complex": (lambda k, t: 1j, "the clock says 1j"),
    "huge": (lambda k, t: 10**400, "the clock says 1000"),
    "too large": (lambda k, t: 1e300, "the clock says 1e+300"),
    "array": (lambda k, t: np.array([t]), "the clock says array"),
    "decimal": (lambda k, t: Decimal(1), "the clock says Decimal"),
    "mute": (lambda k, t: Mute(t), "the clock says 100."),
    "raises": (raises, "raises OSError: no time server"),
    "stands": (lambda k, t: 100.0 + DT * FAULTY, "the clock stands at 100.4 s"),
    "counts down": (lambda k, t: 200.0 - t, "the clock went back by 0.01 s"),
}


def ticks(clock: Broken, loop: OnlineLoop, robot: Scripted, most: int) -> Iterator[Status]:
    """Periods, in which the robot does as told."""
    for _ in range(most):
        command = loop.tick(robot.read(), NEAR)
        robot.write(robot.q + DT * command.v, command.v)  # as one that takes velocities
        clock.tick += 1
        yield command.status


def begun(says: Callable[[int, float], Any]) -> tuple[Broken, OnlineLoop, Scripted]:
    """A loop at speed, whose clock is about to fail."""
    clock = Broken(says)
    loop, robot = OnlineLoop(follows(), clock=clock), Scripted(follows().chain.q_start)
    assert set(ticks(clock, loop, robot, FAULTY)) == {Status.OPTIMAL}
    assert np.abs(loop.command.v).max() > 0.1
    return clock, loop, robot


@pytest.mark.parametrize("case", SAYS)
def test_the_arms_come_to_rest_and_it_is_said_why(case: str) -> None:
    says, words = SAYS[case]
    clock, loop, robot = begun(says)
    notes, found = [], []
    for status in ticks(clock, loop, robot, 60):
        notes.append(loop.note)
        found.append(status)
    assert set(found[2:]) == {Status.CLOCK_WRONG}
    assert Status.STOPPED in loop.command.causes
    assert all(words in note for note in notes[2:])
    assert loop.stopped == "for 0.25 s the clock did not say the time"
    assert_slows_down(robot)
    assert not robot.written[-1].any()
    assert math.isfinite(loop.now)


def assert_slows_down(robot: Scripted) -> None:
    """No joint is slower or faster than one tick of braking makes it, nor holds its speed."""
    v = np.array(robot.written[FAULTY - 1 :])
    slowing = follows().chain.velocity / SPEED_UP * DT
    assert (np.abs(np.diff(v, axis=0)) <= 1.01 * slowing).all()
    assert np.abs(v[2:]).max() < np.abs(v[0]).max()


def test_a_clock_that_goes_to_and_fro_is_named_every_time() -> None:
    clock, loop, robot = begun(lambda k, t: t - 5.0 * (k % 2))
    found = list(ticks(clock, loop, robot, 60))
    assert found.count(Status.CLOCK_WRONG) == 30
    assert not set(found) - {Status.CLOCK_WRONG, Status.STOPPED, Status.OPTIMAL}


@pytest.mark.parametrize(
    ("says", "wrong"),
    [
        (lambda k, t: t - 5.0, [0]),
        (lambda k, t: t - 1e9, [0]),
        (lambda k, t: math.nan if k < 3 else t, [0, 1, 2]),
        (lambda k, t: t if k > 5 else 100.0 + DT * FAULTY, [2, 3, 4, 5]),
    ],
)
def test_it_goes_on_by_itself_when_the_clock_is_right_again(
    says: Callable[[int, float], Any], wrong: list[int]
) -> None:
    clock, loop, robot = begun(says)
    found = list(ticks(clock, loop, robot, 200))
    assert [k for k, status in enumerate(found) if status is Status.CLOCK_WRONG] == wrong
    assert found[-1] is Status.OPTIMAL
    assert not loop.stopped


def test_after_its_patience_it_goes_on_when_it_is_told_to() -> None:
    clock, loop, robot = begun(lambda k, t: None if k < 50 else t)
    assert list(ticks(clock, loop, robot, 60))[-1] is Status.STOPPED
    loop.resume()
    assert list(ticks(clock, loop, robot, 60))[-1] is Status.OPTIMAL
    assert np.abs(loop.command.v).max() > 0.01


def test_a_clock_that_jumps_ahead_is_a_pause() -> None:
    clock, loop, robot = begun(lambda k, t: t + 3600.0)
    assert list(ticks(clock, loop, robot, 60))[-1] is Status.STOPPED
    assert not loop.command.v.any()
    assert loop.stopped == "no tick came for 3.6e+03 s"


def test_stamps_are_by_the_clock_also_after_it_was_set_back() -> None:
    clock, loop, robot = begun(lambda k, t: t - 5.0)
    for k in range(50):
        command = loop.tick(robot.read(), {"target": (NEAR["target"], clock() - 0.002)})
        robot.write(loop.setpoint, command.v)
        clock.tick += 1
        assert Status.INPUT_REFUSED not in command.causes
        assert loop.now == clock()
        sent, _ = loop.state.inputs.arrived["target"]
        assert k == 0 or sent == pytest.approx(loop.state.t - 0.002, abs=1e-9)


def test_times_go_on_whatever_a_clock_says(rng: np.random.Generator) -> None:
    said = [math.nan, None, "x", math.inf, -math.inf, 10**400, 0, -5, 1e17, True, 7.0, 7.0, 7]
    for _ in range(200):
        steps = iter(
            [
                said[rng.integers(len(said))] if rng.random() < 0.5 else float(rng.normal())
                for _ in range(30)
            ]
        )
        time, before = LoopTime(lambda steps=steps: next(steps), DT), -math.inf  # type: ignore[misc]
        stood = 0
        for _ in range(30):
            now = time.tick()
            assert math.isfinite(now)
            assert now >= before
            stood = stood + 1 if now == before else 0
            assert stood <= 1
            assert (now - before >= DT * (1.0 - 1e-9)) or not time.wrong
            before = now


@pytest.mark.each_value
@pytest.mark.parametrize("began", [0.0, 4321.987, 1e6 / 3.0, 1.8e9])
@pytest.mark.parametrize("breaks", ["stands", "back", "raises"])
def test_in_real_time_a_robot_does_not_wait_for_a_clock_that_has_failed(
    breaks: str, began: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine, calls = Machine(began), count()
    monkeypatch.setattr(coopqp.online.real_time, "time", machine)

    def clock() -> float:
        if next(calls) < 1500:
            return machine.monotonic()
        if breaks == "raises":
            raise OSError
        return -7.0 if breaks == "stands" else machine.monotonic() - 1e4 - 10.0 * next(calls)

    robot = Scripted(follows().chain.q_start)
    loop = OnlineLoop(follows(), clock=clock)
    ended = real_time(loop, robot, inputs=lambda: NEAR, duration=20.0)
    assert ended.why == "for 0.25 s the clock did not say the time"
    assert machine.now - began < 5.0
    assert not robot.written[-1].any()
