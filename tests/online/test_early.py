"""Ticks before their time: nothing moves faster by the wall clock than the joints may."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from online_loops import Scripted, Told, follows, go, simulated

import coopqp
from coopqp.online.loop import OnlineLoop
from coopqp.solver import Status

NEAR = {"target": [0.15, 0.01, 0.05]}
README = Path(__file__).parents[2] / "README.md"


@pytest.mark.parametrize("share", [0.01, 0.3, 0.45, 0.6, 0.8, 0.95])
def test_setpoints_keep_the_speed_limits_by_the_clock(share: float) -> None:
    clock = Told()
    loop, robot = OnlineLoop(follows(), clock=clock), Scripted(follows().chain.q_start)
    most, began, ends, times = loop.problem.chain.velocity, clock.t, [], []
    while clock.t < began + 0.6:
        command = loop.tick(robot.read(), NEAR)
        robot.write(loop.setpoint, command.v)
        ends.append(loop.setpoint.copy())
        times.append(clock.t)
        assert command.status in (Status.OPTIMAL, Status.EARLY)
        assert (np.abs(command.v) <= most + 1e-9).all()
        clock.t += share * 0.01
    q, t = np.array(ends), np.array(times)
    assert loop.watch.early > 0
    assert loop.ticks == pytest.approx(60, abs=3)
    apart = np.abs(q[-1] - q) / (t[-1] - t + 0.01)[:, None]
    assert (apart <= 1.02 * most).all()
    assert np.abs(q[-1] - q[0]).max() > 0.05


def test_an_early_tick_is_none_and_says_so() -> None:
    clock = Told()
    loop, robot = simulated(follows(), clock=clock)
    for _ in range(30):
        go(loop, robot, 1, NEAR)
        clock.t += 0.01
    go(loop, robot, 1, NEAR)
    v, setpoint, t = loop.command.v.copy(), loop.setpoint.copy(), loop.state.t
    clock.t += 0.002
    held = loop.tick(robot.read(), NEAR)
    assert held.causes == (Status.EARLY,)
    assert held.status.usable
    assert loop.note == "8 ms of the period are left; wait for its end"
    np.testing.assert_array_equal(held.v, v)
    np.testing.assert_array_equal(loop.setpoint, setpoint)
    assert (loop.state.t, loop.ticks, loop.watch.early, loop.history.count) == (t, 31, 1, 31)
    clock.t += 0.008
    go(loop, robot, 1, NEAR)
    assert loop.status is Status.OPTIMAL
    assert loop.state.t == pytest.approx(0.31)


def test_what_came_early_counts_for_the_next_tick() -> None:
    clock = Told()
    loop, robot = simulated(follows(), clock=clock)
    go(loop, robot, 1, NEAR)
    clock.t += 0.002
    new = [0.16, 0.0, 0.06]
    assert loop.tick(robot.read(), {"target": (new, clock.t)}).status is Status.EARLY
    clock.t += 0.008
    assert loop.tick(None).status is Status.OPTIMAL
    sent, value = loop.state.inputs.arrived["target"]
    assert sent == pytest.approx(loop.state.t - 0.008)
    np.testing.assert_array_equal(value, new)


@pytest.mark.parametrize("pace", [0.99, 1.01])
def test_jitter_and_another_clock_are_no_fault(pace: float, rng: Any) -> None:
    clock = Told()
    loop, robot = simulated(follows(), clock=clock)
    for k in range(1, 300):
        go(loop, robot, 1, NEAR)
        assert loop.status is Status.OPTIMAL, k
        clock.t = 100.0 + 0.01 * (pace * k + 0.4 * rng.random())


def test_the_loop_of_the_readme_runs_as_written_and_keeps_the_period() -> None:
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    (code,) = (block for block in blocks if "while loop.running" in block)
    scenario, names = coopqp.load("point_on_point"), dict[str, Any]()
    times: list[float] = []

    class Robot(Scripted):
        def read(self) -> Any:
            times.append(time.monotonic())  # not where it writes: the first tick builds its law
            if len(times) == 25:
                names["loop"].end()
            return super().read()

    robot = Robot(scenario.chain.q_start)
    names |= {"coopqp": coopqp, "scenario": scenario, "robot": robot}
    exec(code, names)
    loop: OnlineLoop = names["loop"]
    assert loop.watch.early == 0
    assert times[-1] - times[0] >= 0.98 * scenario.dt * (len(times) - 1)
    assert not robot.written[-1].any()
    assert np.abs(robot.written).max() > 0.02
