"""A check before the grasp finds every joint that does not do as told, and nothing else."""

from __future__ import annotations

import os
import signal
from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from online_loops import Scripted, follows

import coopqp
from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.online.joint_check import JointCheck, check_joints
from coopqp.online.loop import OnlineLoop
from coopqp.online.phases import acceleration_limits
from coopqp.online.simulated import SimulatedRobot
from coopqp.scenario.scenario import Scenario

NOISE, DELAY, LAG, SAG = 1e-3, 5, 0.03, 1.5e-3  # [rad], ticks, [s], [rad]


class FreeArms:
    """Arms that hold nothing: servos with lag and delay that sag by their weight; noisy encoders.

    Args:
        motor: what of each command the motors do, shape (n, n).
        encoder: what of each joint's way from the start the encoders say, shape (n, n).
    """

    def __init__(self, scenario: Scenario, motor: Any = 1.0, encoder: Any = 1.0) -> None:
        chain, self._dt = scenario.chain, scenario.dt
        self._rng, self._start = np.random.default_rng(3), chain.q_start.copy()
        self._motor, self._encoder = motor * np.eye(chain.n), encoder * np.eye(chain.n)
        self._model, self._data = chain.model, chain.model.createData()
        weight = pin.computeGeneralizedGravity(self._model, self._data, self._start)
        self._yield = SAG / max(np.abs(weight).max(), 1e-9)
        self.q = self._start - self._sag(self._start)
        self._waiting = deque([self._start.copy()] * (DELAY + 1))
        self._servo = self._start.copy()
        self.noise: Any = NOISE
        self.written: list[tuple[Array, Array]] = []

    def _sag(self, q: Array) -> Array:
        weight = pin.computeGeneralizedGravity(self._model, self._data, q)
        return np.asarray(self._yield * weight)

    def read(self) -> Array:
        """The joints as their encoders have them."""
        said = self._start + self._encoder @ (self.q - self._start)
        return said + self.noise * self._rng.normal(size=len(said))

    def write(self, q: Array, v: Array) -> None:
        """Follow for a period."""
        self.written.append((q.copy(), v.copy()))
        self._waiting.append(q.copy())
        wanted = self._start + self._motor @ (self._waiting.popleft() - self._start)
        self._servo += (wanted - self._servo) * (1.0 - np.exp(-self._dt / LAG))
        self.q = self._servo - self._sag(self._servo)


def _check(scenario: Scenario, **faults: Any) -> tuple[JointCheck, FreeArms]:
    loop, robot = OnlineLoop(scenario, clock=None), FreeArms(scenario, **faults)
    return check_joints(loop, robot), robot


@pytest.fixture(scope="module", params=["point_on_point", "two_pandas"])
def scenario(request: pytest.FixtureRequest) -> Scenario:
    return coopqp.load(request.param)


def test_a_sound_robot_has_no_fault_and_is_moved_within_all_limits(scenario: Scenario) -> None:
    found, robot = _check(scenario)
    assert found.ok
    assert str(found) == f"all {scenario.chain.n} joints follow"
    np.testing.assert_allclose(found.response, np.eye(scenario.chain.n), atol=0.15)
    q, v = (np.array(each) for each in zip(*robot.written, strict=True))
    chain, dt = scenario.chain, scenario.dt
    assert ((chain.lower <= q) & (q <= chain.upper)).all()
    assert (np.abs(v) <= 0.5 * chain.velocity + 1e-9).all()
    most = acceleration_limits(OnlineLoop(scenario).problem)
    changes = np.abs(np.diff(v, axis=0, prepend=0.0 * v[:1])) / dt
    assert (changes <= np.minimum(1.0, 0.5 * most) * (1.0 + 1e-6)).all()
    np.testing.assert_allclose(np.diff(q, axis=0), dt * v[1:], atol=1e-12)
    assert not v[-1].any()
    np.testing.assert_allclose(np.ptp(q, axis=0), 0.02, atol=1e-9)
    assert ((v != 0.0).sum(axis=1) <= 1).all()


@pytest.mark.parametrize("seed", range(5))
def test_sound_robots_never_alarm(scenario: Scenario, seed: int) -> None:
    loop, robot = OnlineLoop(scenario, clock=None), FreeArms(scenario)
    robot._rng = np.random.default_rng(100 + seed)
    assert check_joints(loop, robot).ok


@pytest.mark.few(1)
@pytest.mark.parametrize("part", ["motor", "encoder"])
def test_every_reversed_joint_is_named_and_no_other(scenario: Scenario, part: str) -> None:
    names = scenario.chain.joint_names
    for i, name in enumerate(names):
        signs = np.ones(len(names))
        signs[i] = -1.0
        found, _ = _check(scenario, **{part: signs})
        assert list(found.faults) == [name]
        assert found.faults[name] == "moves the other way: sign of its encoder or motor?"


def _swapped(n: int, i: int, j: int) -> Array:
    order = np.arange(n)
    order[[i, j]] = j, i
    return np.eye(n)[order]


def _of_joint(n: int, i: int, value: float) -> Array:
    found = np.ones(n)
    found[i] = value
    return found


#: What is eight times too far by the encoder multiplies what the arms sag, too, and is seen then.
FAR = {"motor": "times as far as commanded: degrees?", "encoder": "to stay: its sign, units or "}


@pytest.mark.parametrize("part", FAR)
def test_other_faults_are_named(part: str) -> None:
    scenario = coopqp.load("point_on_point")
    names, n = scenario.chain.joint_names, scenario.chain.n
    cases: list[tuple[Any, dict[str, str]]] = [
        (_of_joint(n, 3, 0.0), {names[3]: "does not move: "}),
        (_of_joint(n, 3, 2.0), {names[3]: "moves 2 times as far as commanded: gear ratio"}),
        (_of_joint(n, 3, -2.0), {names[3]: "moves the other way"}),
        (_of_joint(n, 3, np.pi / 180.0), {names[3]: "does not move: "}),
        (_of_joint(n, 3, 8.0), {names[3]: FAR[part]}),
    ]
    for fault, wanted in cases:
        found, robot = _check(scenario, **{part: fault})
        assert found.faults.keys() == wanted.keys(), str(found)
        assert all(words in found.faults[name] for name, words in wanted.items())
    # What is fifty times too far is so from the first command, which only asks to stay.
    found, _ = _check(scenario, **{part: _of_joint(n, 3, 180.0 / np.pi)})
    assert found.stopped.startswith(f"{names[3]} does not stay; the arm may go on moving: switch")
    assert "although it is told to stay: its sign, units or place in" in found.faults[names[3]]
    matrix = _swapped(n, 2, 7)
    loop, robot = OnlineLoop(scenario, clock=None), FreeArms(scenario)
    setattr(robot, f"_{part}", matrix)
    found = check_joints(loop, robot)
    assert found.faults == {
        names[2]: f"does not move, and {names[7]} does instead: are they swapped?",
        names[7]: f"does not move, and {names[2]} does instead: are they swapped?",
    }


def test_a_joint_that_runs_at_the_first_command_ends_it_at_the_second_reading() -> None:
    scenario = replace(coopqp.load("point_on_point"), start_outside=True)
    loop, robot = OnlineLoop(scenario, clock=None), FreeArms(scenario)
    i, signs = int(np.argmax(np.abs(robot.q))), np.ones(scenario.chain.n)
    signs[i] = -1.0
    true = robot.read
    robot.read = lambda: signs * true()  # type: ignore[method-assign]
    robot._waiting = deque([robot._start.copy()])  # no delay
    found = check_joints(loop, robot)
    assert list(found.faults) == [scenario.chain.joint_names[i]]
    written = np.array([q for q, _ in robot.written])
    assert len(written) <= 5
    np.testing.assert_array_equal(written, np.broadcast_to(written[0], written.shape))


@pytest.mark.parametrize("noise", [0.01, 0.02, 0.1])
def test_what_noise_hides_is_not_judged(noise: float) -> None:
    scenario = coopqp.load("point_on_point")
    loop, robot = OnlineLoop(scenario, clock=None), FreeArms(scenario)
    robot.noise = noise
    found = check_joints(loop, robot)
    assert len(found.faults) == scenario.chain.n
    assert all("noise" in words for words in found.faults.values())


def test_one_noisy_joint_hides_no_other() -> None:
    scenario = coopqp.load("point_on_point")
    loop, robot = OnlineLoop(scenario, clock=None), FreeArms(scenario)
    robot.noise = np.where(np.arange(scenario.chain.n) == 3, 0.05, NOISE)
    assert list(check_joints(loop, robot).faults) == [scenario.chain.joint_names[3]]


def test_a_simulated_robot_on_ideal_joints_passes() -> None:
    loop = OnlineLoop(follows(), clock=None)
    robot = SimulatedRobot(loop)
    assert check_joints(loop, robot).ok
    loop.begin(robot.read())
    with pytest.raises(InvalidValueError, match="the loop has begun"):
        check_joints(loop, robot)


def test_ctrl_c_stops_it_at_rest_and_it_says_so() -> None:
    scenario = coopqp.load("point_on_point")

    def interrupt() -> Any:
        os.kill(os.getpid(), signal.SIGINT)
        return robot.q.copy()

    before, robot = signal.getsignal(signal.SIGINT), Scripted(scenario.chain.q_start)
    robot.says[75] = interrupt
    found = check_joints(OnlineLoop(scenario, clock=None), robot)
    assert found.stopped == "Ctrl-C"
    assert not found.ok
    assert "stopped, with 10 joints not checked: Ctrl-C" in str(found)
    assert signal.getsignal(signal.SIGINT) is before
    v = np.array(robot.written)
    assert v[-3:].any() or v[-20:-3].any()  # it was in motion
    assert not v[-1].any()
    assert (np.abs(np.diff(v, axis=0)) <= 1.0 * scenario.dt + 1e-12).all()


def test_a_driver_that_raises_or_falls_silent_is_left_at_rest() -> None:
    scenario = coopqp.load("point_on_point")
    robot = Scripted(scenario.chain.q_start, {75: OSError("unplugged")})
    with pytest.raises(OSError, match="unplugged"):
        check_joints(OnlineLoop(scenario, clock=None), robot)
    assert not robot.written[-1].any()
    silent = Scripted(scenario.chain.q_start, dict.fromkeys(range(75, 1000)))
    found = check_joints(OnlineLoop(scenario, clock=None), silent)
    assert found.stopped == "no usable measurement for 0.25 s: read() gave None"
    assert not silent.written[-1].any()


def test_joints_out_of_their_range_are_refused_before_anything_is_written() -> None:
    scenario = coopqp.load("point_on_point")
    robot = Scripted(np.degrees(scenario.chain.q_start))
    with pytest.raises(InvalidValueError, match=r"above its range: degrees\?"):
        check_joints(OnlineLoop(scenario, clock=None), robot)
    assert not robot.written


def test_it_keeps_the_period_by_the_clock() -> None:
    scenario = follows()
    loop, robot = OnlineLoop(scenario), Scripted(scenario.chain.q_start)
    robot.says[60] = lambda: os.kill(os.getpid(), signal.SIGTERM)
    began = loop.now
    assert check_joints(loop, robot).stopped == "SIGTERM"
    assert loop.now - began > 0.9 * 60 * scenario.dt
