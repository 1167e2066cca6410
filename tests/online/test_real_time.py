"""The loop with a clock: it keeps the period, and always leaves the robot at rest."""

from __future__ import annotations

import gc
import math
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from online_loops import Machine, Scripted, follows, go, simulated

import coopqp
import coopqp.online.real_time
from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.online.loop import OnlineLoop
from coopqp.online.real_time import real_time
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status

TARGET = {"target": [0.15, 0.01, 0.05]}


@pytest.fixture
def scenario() -> Scenario:
    return follows()


@pytest.fixture(autouse=True)
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    """Its time is the loop's, so that no test depends on how busy the real one is."""
    simulated_time = Machine(4321.987)
    monkeypatch.setattr(coopqp.online.real_time, "time", simulated_time)
    monkeypatch.setitem(OnlineLoop.__init__.__kwdefaults__, "clock", simulated_time.monotonic)
    return simulated_time


def _raise(error: Exception) -> Callable[[], Any]:
    def raising() -> Any:
        raise error

    return raising


def test_it_keeps_the_period_and_ends_at_rest(scenario: Scenario, machine: Machine) -> None:
    loop, robot = OnlineLoop(scenario), Scripted(scenario.chain.q_start)
    began = machine.now
    ended = real_time(loop, robot, inputs=lambda: TARGET, duration=0.4)
    assert ended.why == "the time is up"
    assert 41 <= ended.ticks <= 41 + 25  # those that it took to come to rest
    assert machine.now - began == pytest.approx(scenario.dt * ended.ticks, abs=scenario.dt)
    assert ended.late == 0
    assert np.abs(robot.written).max() > 0.02
    assert not robot.written[-1].any()
    assert "ticks late" in str(ended)
    assert gc.isenabled()


def test_ctrl_c_ends_it_at_rest_with_the_record_on_disk(scenario: Scenario, tmp_path: Path) -> None:
    def interrupt() -> Any:
        os.kill(os.getpid(), signal.SIGINT)
        return robot.q.copy()

    before = signal.getsignal(signal.SIGINT)
    robot = Scripted(scenario.chain.q_start, {40: interrupt})
    loop = OnlineLoop(scenario, out=tmp_path / "out")
    ended = real_time(loop, robot, inputs=lambda: TARGET)
    assert ended.why == "Ctrl-C"
    assert signal.getsignal(signal.SIGINT) is before
    changes = np.abs(np.diff(robot.written, axis=0)) / scenario.dt
    assert (changes <= loop.problem.chain.velocity / 0.2 + 1e-9).all()
    assert not robot.written[-1].any()
    assert coopqp.load(tmp_path / "out" / "scenario.yaml").inputs["target"].feed_file


def test_ctrl_c_in_a_loop_of_ones_own(scenario: Scenario) -> None:
    with simulated(scenario)[0] as loop:
        q, ticks = scenario.chain.q_start, 0
        while loop.running:
            loop.tick(q, TARGET)
            q, ticks = loop.setpoint.copy(), ticks + 1
            if ticks == 30:
                os.kill(os.getpid(), signal.SIGINT)
    assert 30 < ticks < 60
    assert loop.at_rest


@pytest.mark.few(1)
@pytest.mark.parametrize("who", ["read", "inputs"])
def test_what_others_raise_comes_out_after_the_arms_have_stopped(
    scenario: Scenario, who: str
) -> None:
    asked = iter(range(10_000))

    def inputs() -> Any:
        if who == "inputs" and next(asked) == 40:
            raise OSError("unplugged")
        return TARGET

    says: dict[int, Any] = {40: OSError("unplugged")} if who == "read" else {}
    robot = Scripted(scenario.chain.q_start, says)
    with pytest.raises(OSError, match="unplugged"):
        real_time(OnlineLoop(scenario), robot, inputs=inputs)
    speeds = np.abs(robot.written).max(axis=1)
    assert speeds[38] > 0.05
    assert (np.abs(np.diff(robot.written, axis=0)) <= 1.25).all()
    assert not robot.written[-1].any()
    assert gc.isenabled()


def test_a_write_that_raises_is_followed_by_one_that_stops(scenario: Scenario) -> None:
    class Breaks(Scripted):
        def write(self, q: Any, v: Any) -> None:
            super().write(q, v)
            if len(self.written) == 30:
                raise OSError("bus off")

    robot = Breaks(scenario.chain.q_start)
    with pytest.raises(OSError, match="bus off"):
        real_time(OnlineLoop(scenario), robot, inputs=lambda: TARGET)
    assert len(robot.written) == 31
    assert not robot.written[-1].any()


def test_a_robot_that_falls_silent_ends_it(scenario: Scenario) -> None:
    robot = Scripted(scenario.chain.q_start, dict.fromkeys(range(30, 10_000)))
    ended = real_time(OnlineLoop(scenario), robot, inputs=lambda: TARGET)
    assert ended.why.endswith("the robot has not said where it is")
    assert not robot.written[-1].any()


def test_it_waits_for_the_first_word_of_a_robot(scenario: Scenario) -> None:
    robot = Scripted(scenario.chain.q_start, dict.fromkeys(range(5)))
    assert real_time(OnlineLoop(scenario), robot, duration=0.05).ticks > 1
    mute = Scripted(scenario.chain.q_start, dict.fromkeys(range(10_000)))
    with pytest.raises(CoopqpError, match=r"the robot has said nothing for 0\.1 s"):
        real_time(OnlineLoop(scenario, patience=0.1), mute)
    assert not np.any(mute.written)


def test_a_late_tick_is_not_made_up_for(scenario: Scenario, machine: Machine) -> None:
    times: list[float] = []

    class Slow(Scripted):
        def read(self) -> Any:
            times.append(machine.now)
            if len(times) == 5:
                machine.sleep(0.05)
            return super().read()

    loop = OnlineLoop(scenario)
    real_time(loop, Slow(scenario.chain.q_start), duration=0.4)
    assert loop.watch.late == 1
    assert loop.watch.longest == pytest.approx(scenario.dt + 0.05, abs=1e-3)
    assert np.diff(times[5:]) == pytest.approx(scenario.dt, abs=1e-3)


def test_a_simulation_slower_than_time_is_waited_for(scenario: Scenario, machine: Machine) -> None:
    """Its clock steps by 10 ms, ten times slower: without ``slowest`` it counts as standing."""

    def statuses(**given: float) -> set[Status]:
        began, said = machine.now, set[Status]()
        clock = lambda: 0.01 * math.floor(10.0 * (machine.monotonic() - began))  # noqa: E731
        loop, robot = OnlineLoop(scenario, clock=clock), Scripted(scenario.chain.q_start)

        def inputs() -> Any:
            said.update(loop.command.causes)
            return TARGET

        real_time(loop, robot, inputs=inputs, duration=0.1, **given)
        return said

    assert Status.CLOCK_WRONG in statuses()
    assert not statuses(slowest=5.0) & {Status.CLOCK_WRONG, Status.EARLY}


def test_counting_ticks_is_no_clock(scenario: Scenario) -> None:
    loop, robot = simulated(scenario)
    with pytest.raises(InvalidValueError, match="give it a clock"):
        real_time(loop, robot)
    go(loop, robot, 1)


def test_what_was_told_to_stop_waits_and_goes_on(scenario: Scenario) -> None:
    loop, rests = OnlineLoop(scenario), list[bool]()

    def inputs() -> Any:
        if loop.ticks == 30:
            loop.stop("lunch")
        if loop.ticks == 80:
            rests.append(loop.at_rest)
            loop.resume()
        if loop.ticks == 120:  # of ticks, not of time: the machine may be busy
            loop.end("it is enough")
        return TARGET

    robot = Scripted(scenario.chain.q_start)
    ended = real_time(loop, robot, inputs=inputs, duration=60.0)
    assert ended.why == "it is enough"
    assert rests == [True]
    assert np.abs(robot.written[100:]).max() > 0.01
    with pytest.raises(InvalidValueError, match=r"has ended \(it is enough\); reset it first"):
        real_time(loop, robot)
    loop.reset()
    assert real_time(loop, robot, duration=0.05).why == "the time is up"
