"""Telling the loop to stop: whatever is said, whoever says it, it stops."""

from __future__ import annotations

import os
import signal
import sys
import threading
from typing import Any

import numpy as np
import pytest
from forking import program
from online_loops import Scripted, follows, go, simulated

from coopqp.limits import JointAcceleration
from coopqp.online.loop import LoopTicks, OnlineLoop
from coopqp.solver import Status

NEAR = {"target": [0.15, 0.01, 0.05]}


class Mute:
    """Cannot say what it is."""

    def __str__(self) -> str:
        raise RuntimeError("says nothing")


@pytest.mark.parametrize("why", ["", " ", None, 3, 0, Mute(), ValueError()])
@pytest.mark.parametrize("way", ["stop", "end"])
def test_it_stops_for_any_reason_and_for_none(way: str, why: Any) -> None:
    loop, robot = simulated(follows())
    go(loop, robot, 30, NEAR)
    assert np.abs(loop.command.v).max() > 0.1
    getattr(loop, way)(why)
    assert loop.stopped
    go(loop, robot, 30, NEAR)
    assert loop.at_rest
    assert loop.status is Status.STOPPED
    assert loop.note == loop.stopped
    assert loop.running == (way == "stop")


def test_threads_that_tick_one_loop_take_turns() -> None:
    """Their ticks are those of one thread that ticks as often."""

    def ticked(threads: int) -> LoopTicks:
        loop, _ = simulated(follows())
        q, each = loop.setpoint.copy(), 120 // threads
        loop.begin(q)
        workers = [
            threading.Thread(target=lambda: [loop.tick(q, NEAR) for _ in range(each)])
            for _ in range(threads)
        ]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        return loop.history.last()

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    alone, together = ticked(1), ticked(2)
    sys.setswitchinterval(before)
    assert np.abs(alone.v).max() > 0.1
    for name in ("number", "t", "q", "v", "causes"):
        np.testing.assert_array_equal(getattr(together, name), getattr(alone, name))


def test_other_threads_may_stop_it_and_let_it_go_on() -> None:
    loop, robot = simulated(follows())
    go(loop, robot, 5, NEAR)
    done = threading.Event()

    def nervous() -> None:
        while not done.is_set():
            loop.stop("wait")
            loop.resume()

    before, seen = sys.getswitchinterval(), set[Any]()
    sys.setswitchinterval(1e-5)
    other = threading.Thread(target=nervous)
    other.start()
    try:
        for _ in range(1000):
            go(loop, robot, 1, NEAR)
            seen |= set(loop.command.causes)
            if Status.STOPPED in loop.command.causes:
                assert loop.note == "wait"
    finally:
        done.set()
        other.join()
        sys.setswitchinterval(before)
    assert seen <= {Status.OPTIMAL, Status.STOPPED, Status.TASKS_RELAXED}
    loop.end("enough")
    loop.resume()
    go(loop, robot, 30)
    assert not loop.running


TERMINATED = """\
    import os, signal, sys
    import coopqp

    class Robot:
        def __init__(self, q):
            self.q, self.v, self.writes = q.copy(), q * 0, 0
        def read(self):
            return self.q.copy()
        def write(self, q, v):
            self.q[:], self.v, self.writes = q, v.copy(), self.writes + 1
            if self.writes == 30:
                print("fast", abs(v).max() > 0.02, flush=True)
                os.kill(os.getpid(), signal.SIGTERM)

    scenario = coopqp.load("point_on_point")
    robot = Robot(scenario.chain.q_start)
    ended = coopqp.real_time(coopqp.OnlineLoop(scenario), robot)
    print(ended.why, robot.v.any(), flush=True)
"""


def test_sigterm_leaves_the_robot_at_rest() -> None:
    with program(TERMINATED) as process:
        assert process.out.read().splitlines() == ["fast True", "SIGTERM False"]
        assert process.ended() == 0


def test_signals_are_given_back_and_the_second_one_ends_at_once() -> None:
    before = signal.getsignal(signal.SIGTERM)
    loop, robot = simulated(follows())
    go(loop, robot, 3)
    with loop:
        os.kill(os.getpid(), signal.SIGTERM)
        assert loop.stopped == "SIGTERM"
        with pytest.raises(SystemExit):
            os.kill(os.getpid(), signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) is before


def test_it_stops_and_goes_on_from_where_the_robot_is_then() -> None:
    scenario = follows()
    loop = OnlineLoop(scenario, clock=None)
    robot = Scripted(scenario.chain.q_start)
    for _ in range(50):
        robot.write(loop.setpoint, loop.tick(robot.read(), NEAR).v)
    loop.stop("lunch")
    for _ in range(50):
        robot.write(loop.setpoint, loop.tick(robot.read(), NEAR).v)
    assert loop.at_rest
    assert (loop.status, loop.note) == (Status.STOPPED, "lunch")
    t = loop.state.t
    robot.q += 0.01  # somebody leans on it
    loop.resume()
    loop.tick(robot.read(), NEAR)
    assert loop.status is Status.OPTIMAL
    assert loop.state.t == t
    np.testing.assert_array_equal(loop.state.q, robot.q)
    (limit,) = (k for k in loop.problem.limits if isinstance(k, JointAcceleration))
    assert np.abs(loop.command.v).max() <= 0.01 * max(limit.joints.values())


def test_ending_is_for_good() -> None:
    loop, robot = simulated(follows())
    go(loop, robot, 50, NEAR)
    loop.end("done")
    assert loop.running
    go(loop, robot, 40)
    loop.resume()
    assert not loop.running
    assert loop.stopped == "done"
    loop.reset()
    go(loop, robot, 3)
    assert loop.running
    assert loop.ticks == 3
