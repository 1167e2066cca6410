"""One tick of the loop for robots: what it does, and what it says of what is wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pinocchio as pin
import pytest
from online_loops import FOLLOWS, Scripted, Told, follows, go, simulated
from scenario_files import needs_robots

import coopqp
import coopqp.online.phases
from coopqp.base.errors import CoopqpError, GraspError, InvalidValueError
from coopqp.execution.controller_run import run
from coopqp.limits import JointAcceleration
from coopqp.model.state import State
from coopqp.online.arrivals import FASTER, NOISE, Readings
from coopqp.online.loop import OnlineLoop
from coopqp.plants import RigidBody
from coopqp.solver import Status

NEAR = [0.15, 0.01, 0.05]


@pytest.mark.parametrize("name", ["point_on_point", pytest.param("regrasp", marks=needs_robots)])
def test_it_does_what_a_comparison_does_to_the_last_bit(name: str) -> None:
    scenario = coopqp.load(name)
    ticks = scenario.first_ticks[-1] + 5
    loop, robot = simulated(scenario, speed_up=None)
    q, _ = go(loop, robot, ticks)
    trace = run(scenario, controller="qp")
    np.testing.assert_array_equal(q, trace.commanded[:ticks])
    assert len(loop.phases) == len(scenario.schedule)


def test_so_it_does_on_a_plant_with_masses_and_errors_that_is_measured() -> None:
    scenario = coopqp.load("calibration_error")
    scenario = replace(scenario, plant=RigidBody(), duration=0.3)
    loop, robot = simulated(scenario, reference="commanded", grasp="as_written", speed_up=None)
    q, v = go(loop, robot, 30)
    trace = run(scenario, controller="qp")
    np.testing.assert_array_equal(q, trace.commanded)
    np.testing.assert_array_equal(v, trace.v)
    np.testing.assert_array_equal(loop.history.last().measured, trace.measured)


def test_kinematics_are_those_of_the_tick() -> None:
    loop, robot = simulated(follows())
    go(loop, robot, 40, {"target": NEAR})
    here = loop.problem.chain.object_pose(loop.state.q)
    np.testing.assert_allclose(loop.state.p_WO, here.translation, atol=1e-14)
    np.testing.assert_array_equal(loop.setpoint, robot.state.q)


BAD = {
    "nothing": (None, Status.ROBOT_SILENT, ""),
    "a NaN": (np.full(10, np.nan), Status.NOT_MEASURED, "no finite number for RShoulderPitch"),
    "too few": (np.zeros(3), Status.NOT_MEASURED, "found shape (3,), needs (10,)"),
    "words": ("hello", Status.NOT_MEASURED, "found a text, needs numbers"),
    "an object": (object(), Status.NOT_MEASURED, "found object, needs numbers"),
    "ragged": ([[1.0], [1.0, 2.0]], Status.NOT_MEASURED, "lists of different lengths"),
    "complex": (np.full(10, 0.5 + 1j), Status.NOT_MEASURED, "found complex numbers"),
    "true or false": (np.full(10, True), Status.NOT_MEASURED, "found true or false"),
    "masked": (np.ma.masked_greater(np.arange(10.0), 5.0), Status.NOT_MEASURED, "masked values"),
    "Nones": ([None] * 10, Status.NOT_MEASURED, "found list, needs numbers"),
    "far away": (np.full(10, 2.0), Status.MEASURED_JUMPED, " rad in 0."),
}


@pytest.mark.parametrize("reference", ["commanded", "measured"])
@pytest.mark.parametrize("case", BAD)
def test_a_bad_measurement_brings_the_arms_to_rest(case: str, reference: Any) -> None:
    loop, robot = simulated(follows(), reference=reference)
    _, v = go(loop, robot, 60, {"target": NEAR})
    assert np.abs(v[-1]).max() > 0.1
    said, status, words = BAD[case]
    before, most = v[-1], _accelerations(loop)
    for k in range(60):
        command = loop.tick(said, None)
        assert command.status is status
        assert words in command.note
        assert command.note.count("no finite number") == (case == "a NaN")
        assert (np.abs(command.v - before) <= most * 0.01 + 1e-9).all()
        assert loop.state.loop_position_error < 1e-4
        before = command.v.copy()
        robot.write(loop.setpoint, command.v)
        if k * 0.01 < 0.2:
            assert not loop.stopped
    assert loop.at_rest
    assert "for 0.25 s" in loop.stopped
    go(loop, robot, 1)
    assert loop.status is Status.STOPPED
    loop.resume()
    _, v = go(loop, robot, 150, {"target": NEAR})
    assert loop.status is Status.OPTIMAL
    np.testing.assert_allclose(loop.state.p_WO, NEAR, atol=2e-3)


def test_one_missing_reading_is_no_stop() -> None:
    loop, robot = simulated(follows())
    go(loop, robot, 50, {"target": NEAR})
    robot.write(loop.setpoint, loop.tick(None).v)
    assert loop.status is Status.ROBOT_SILENT
    go(loop, robot, 1, {"target": NEAR})
    assert loop.status is Status.OPTIMAL
    assert not loop.stopped


def _accelerations(loop: OnlineLoop) -> Any:
    (limit,) = (x for x in loop.problem.limits if isinstance(x, JointAcceleration))
    return np.array([limit.joints[name] for name in loop.problem.chain.joint_names])


def test_no_speed_jumps_unless_it_was_switched_off() -> None:
    scenario = coopqp.load("joint_limit_stress")
    loop, robot = simulated(scenario)
    _, v = go(loop, robot, 150)
    change, most = _changes(v) / scenario.dt, loop.problem.chain.velocity / 0.2
    kept = loop.history.last()
    said = [Status.ACCELERATION_GIVEN_UP in kept.causes_at(k) for k in range(150)]
    assert sum(said) <= 1  # where the loops leave no other motion
    assert (change[~np.array(said)] <= most + 1e-6).all()
    loop, robot = simulated(scenario, speed_up=None)
    _, v = go(loop, robot, 150)
    assert (_changes(v) / scenario.dt > 2.0 * most).any()


def _changes(v: Any) -> Any:
    return np.abs(np.diff(v, axis=0, prepend=np.zeros_like(v[:1])))


def test_an_acceleration_limit_of_the_scenario_counts() -> None:
    own = JointAcceleration(max=3.0)
    scenario = coopqp.load("point_on_point")
    scenario = replace(scenario, limits=(*scenario.limits, own))
    assert OnlineLoop(scenario).problem.limits == scenario.limits


INPUTS: dict[str, tuple[Any, str]] = {
    "wrong shape": ([1.0, 2.0], "target: found shape (2,), needs 3 numbers"),
    "NaN": ([np.nan, 0.0, 0.0], "target: has NaN or infinite values"),
    "words": ("there", "target: found 'there', needs 3 numbers"),
    "nothing": (None, "target: found None, needs 3 numbers"),
    "complex": ([0.15, 0.0, 0.05 + 1j], "target: found [0.15, 0.0, (0.05+1j)], needs 3 numbers"),
    "true or false": ([True, False, True], "target: found [True, False, True], needs 3 numbers"),
    "masked": (np.ma.masked_less([0.15, -1.0, 0.05], 0.0), "target: found masked_array"),
    "nowhere": ([1e9, 0.0, 0.0], "target: found 1e+09, which is nowhere"),
    "from the future": ((NEAR, 1e6), "is from the future"),
    "from the past": ((NEAR, -1.0), "is older than the last"),
    "without a time": ((NEAR, "now"), "needs a value, or a value and when it was sent"),
}


@pytest.mark.parametrize("case", INPUTS)
def test_bad_inputs_are_refused_and_said(case: str) -> None:
    loop, robot = simulated(follows())
    go(loop, robot, 5, {"target": (NEAR, 0.0)})
    given, words = INPUTS[case]
    go(loop, robot, 1, {"target": given})
    assert Status.INPUT_REFUSED in loop.command.causes
    assert words in loop.note
    go(loop, robot, 1, {"target": NEAR})
    assert loop.status is Status.OPTIMAL


def test_what_is_no_rotation_is_refused_and_all_spellings_of_a_pose_are_one(tmp_path: Path) -> None:
    path = tmp_path / "carry.yaml"
    task = "pose: {name: follow, goal: {input: target}"
    text = FOLLOWS.replace("point_on_point: {name: follow, goal: {input: target}", task)
    path.write_text(text.replace("PLANT", "kinematic"), encoding="utf-8")
    loop, robot = simulated(coopqp.load(path))
    mirrored = np.diag([1.0, 1.0, -1.0, 1.0])
    for wrong in (mirrored, [*NEAR, 0.0, 0.0, 0.0, 0.5], 2.0 * np.eye(4)):
        go(loop, robot, 1, {"target": wrong})
        assert Status.INPUT_REFUSED in loop.command.causes
    X = pin.SE3(pin.rpy.rpyToMatrix(np.array([0.1, 0.2, 0.3])), np.array(NEAR))
    numbers = pin.SE3ToXYZQUAT(X)
    for spelled in (X, X.homogeneous, numbers, numbers.tolist()):
        go(loop, robot, 1, {"target": (spelled, loop.now)})
        assert loop.status is Status.OPTIMAL
        sent, value = loop.state.inputs.arrived["target"]
        assert sent == loop.state.t
        np.testing.assert_allclose(value, numbers, atol=1e-15)


def test_an_unknown_input_is_named_once() -> None:
    scenario = follows()
    more = {**scenario.inputs, "of_another_phase": scenario.inputs["target"]}
    loop, robot = simulated(replace(scenario, inputs=more))
    go(loop, robot, 1, {"of_another_phase": NEAR, "target": NEAR})
    assert loop.status is Status.OPTIMAL
    go(loop, robot, 1, {"taget": NEAR})
    assert Status.INPUT_REFUSED in loop.command.causes
    assert loop.note == "unknown input 'taget'; did you mean 'target'?"
    go(loop, robot, 1, {"taget": NEAR, "target": NEAR})
    assert loop.status is Status.OPTIMAL
    go(loop, robot, 1, [1, 2])
    assert "inputs: found a list" in loop.note


def test_an_input_that_goes_stale_brings_the_arms_to_rest_and_says_so() -> None:
    loop, robot = simulated(follows())
    go(loop, robot, 40, {"target": NEAR})
    _, v = go(loop, robot, 150)
    assert loop.status is Status.INPUT_STALE
    assert np.abs(loop.state.inputs["target"].rate).max() < 1e-15
    assert np.linalg.norm(loop.state.J_task[:3] @ v[-1]) < 1e-5
    assert not loop.stopped
    assert np.linalg.norm(loop.state.p_WO - NEAR) > 5e-4  # it was not there yet


def test_the_age_of_a_value_counts_and_not_the_loops_own_time() -> None:
    clock = Told()
    loop, robot = simulated(follows(), clock=clock)
    for k in range(30):  # each tick comes a period late: the loop's time falls behind
        go(loop, robot, 1, {"target": (NEAR, clock.t - 0.001)})
        assert Status.INPUT_REFUSED not in loop.command.causes, k
        assert Status.INPUT_STALE not in loop.command.causes
        clock.t += 0.02
    go(loop, robot, 1, {"target": (NEAR, clock.t - 0.3)})
    assert Status.INPUT_REFUSED in loop.command.causes


def test_a_value_without_a_stamp_is_sent_when_it_arrives() -> None:
    loop, robot = simulated(follows())
    go(loop, robot, 30, {"target": NEAR})
    for stamp in (-5.0, loop.now - 0.02):
        go(loop, robot, 1, {"target": ([0.151, 0.0, 0.06], stamp)})
        assert Status.INPUT_REFUSED in loop.command.causes
        assert "is older than the last" in loop.note
    np.testing.assert_array_equal(loop.state.inputs["target"].target, NEAR)
    go(loop, robot, 1, {"target": ([0.151, 0.0, 0.06], loop.now)})
    assert loop.status is Status.OPTIMAL


def test_a_loop_that_is_late_does_not_take_old_values_for_new() -> None:
    clock = Told()
    loop, robot = simulated(follows(), clock=clock)
    go(loop, robot, 1, {"target": NEAR})
    for _ in range(5):  # 0.05 s of the loop's time, 0.375 s by the clock
        clock.t += 0.075
        go(loop, robot, 1)
    assert Status.INPUT_STALE in loop.command.causes
    assert Status.LATE in loop.command.causes


def test_late_ticks_are_counted_and_the_longest_named() -> None:
    clock = Told()
    loop, robot = simulated(follows(), clock=clock)
    for k in range(40):
        go(loop, robot, 1, {"target": NEAR})
        assert (Status.LATE in loop.command.causes) == (k in (11, 31))
        clock.t += {10: 0.05, 30: 0.08}.get(k, 0.0101)
    assert (loop.watch.late, loop.watch.longest_tick) == (2, 31)
    assert loop.watch.longest == pytest.approx(0.08)
    assert loop.state.t == pytest.approx(0.39)  # references have waited
    assert not loop.stopped
    clock.t += 1.0
    go(loop, robot, 1)
    assert "no tick came for 1.01 s" in loop.stopped


def test_the_last_word_of_a_slow_robot_counts_for_a_while() -> None:
    scenario, clock = follows(), Told()
    loop = OnlineLoop(scenario, clock=clock, silent_after=0.05)
    robot = Scripted(scenario.chain.q_start)
    for k in range(60):
        said = robot.read() if k % 4 == 0 else None
        robot.write(loop.setpoint, loop.tick(said, {"target": NEAR}).v)
        assert loop.status is Status.OPTIMAL, k
        clock.t += 0.01
    assert np.abs(robot.q - scenario.chain.q_start).max() > 0.01
    far = robot.q + 1.0
    for said in (far, None, None, far, None):  # what is not believed is so until there is better
        loop.tick(said, {"target": NEAR})
        assert loop.status is Status.MEASURED_JUMPED
        assert "by +" in loop.note
        clock.t += 0.01
    clock.t += 0.05
    loop.tick(None)
    assert loop.status is Status.ROBOT_SILENT


def test_what_has_jumped_counts_again_once_it_jumps_back() -> None:
    """Arms that brake come to where an encoder that slipped has them, which is no return."""
    chain = follows().chain
    readings, q = Readings(chain), chain.q_start.copy()
    assert readings.take(q, q, 0.0) is None
    slipped = NOISE + 0.01 * FASTER * chain.velocity[0] + 6e-3
    for k in range(1, 20):
        q[0] -= 5e-3
        off = np.where(np.arange(chain.n), q, q + slipped)
        assert readings.take(off, q, 0.01 * k) is Status.MEASURED_JUMPED, k
    assert readings.take(q, q, 0.2) is None


def test_the_object_is_taken_as_it_is_held() -> None:
    scenario = coopqp.load("point_on_point")
    q = scenario.chain.q_start + 0.05
    loop = OnlineLoop(scenario, clock=None)
    loop.tick(q)
    assert loop.status is Status.OPTIMAL
    chain = loop.problem.chain
    np.testing.assert_array_equal(chain.q_start, q)
    assert np.abs(State(chain).loop_error).max() < 1e-12
    assert np.abs(loop.state.loop_offset).max() < 1e-12


def test_a_written_grasp_is_taken_a_little_off_and_refused_far_off() -> None:
    scenario = coopqp.load("point_on_point")
    X = scenario.chain.object_pose(scenario.chain.q_start)
    pose = coopqp.Pose(position=tuple(X.translation.tolist()))
    scenario = replace(scenario, held=replace(scenario.held, pose=pose))
    q = scenario.chain.q_start.copy()
    q[0] += 0.02
    loop = OnlineLoop(scenario, clock=None)
    loop.begin(q)
    chain = loop.problem.chain
    assert np.abs(State(chain).loop_error).max() < 1e-12
    seen = scenario.chain.object_pose(q)
    assert np.linalg.norm(pin.log6(seen.actInv(chain.object_pose(q))).vector) < 1e-9
    loop.reset()
    with pytest.raises(GraspError, match=r"the hands are \d+ mm and \d+ mrad from how"):
        loop.begin(scenario.chain.q_start + np.linspace(0.0, 0.5, 10))
    loop.tick(scenario.chain.q_start + np.linspace(0.0, 0.5, 10))
    assert loop.status is Status.NOT_BEGUN
    assert not loop.command.v.any()
    loop.tick(q)  # never by itself
    assert loop.status is Status.NOT_BEGUN
    loop.resume()
    loop.tick(q)
    assert loop.status is Status.OPTIMAL


def test_passive_joints_need_not_be_measured() -> None:
    scenario = coopqp.load("rigid_vs_passive")
    name = next(name for name in scenario.controllers if name not in scenario.grasp_of)
    loop = OnlineLoop(scenario, name, clock=None)
    chain = loop.problem.chain
    assert len(chain.passive)
    own = np.setdiff1d(np.arange(chain.n), chain.passive)
    loop.tick(chain.q_start[own])
    assert loop.status is Status.OPTIMAL
    np.testing.assert_array_equal(loop.history.last().measured[0], chain.q_start)


@needs_robots
def test_phases_wait_to_be_asked() -> None:
    scenario = coopqp.load("regrasp")
    loop, robot = simulated(scenario, phases="asked")
    go(loop, robot, scenario.first_ticks[1] + 20)
    assert loop.phase is scenario.schedule[0]
    loop.next_phase()
    go(loop, robot, 1)
    assert loop.phase is scenario.schedule[1]
    loop.next_phase()
    loop.stop()
    go(loop, robot, 30)
    assert loop.phase is scenario.schedule[1]
    loop.resume()
    go(loop, robot, 2)
    assert loop.phase is scenario.schedule[2]


@needs_robots
def test_a_phase_that_could_not_begin_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = coopqp.load("regrasp")
    loop, robot = simulated(scenario, phases="asked")
    go(loop, robot, scenario.first_ticks[1] + 20)

    def refuse(*given: Any, **keys: Any) -> NoReturn:
        raise CoopqpError("the hand is empty")

    with monkeypatch.context() as now:
        now.setattr(coopqp.online.phases, "begin_phase", refuse)
        loop.next_phase()
        go(loop, robot, 1)
    assert loop.stopped.endswith("does not end: the hand is empty")
    assert loop.phase is scenario.schedule[0]
    loop.next_phase()
    loop.resume()
    go(loop, robot, 20)
    assert loop.phase is scenario.schedule[1]
    assert not loop.stopped


@needs_robots
@pytest.mark.parametrize("share", [0.5, 1.0])
def test_notes_of_the_change_of_phases(share: float) -> None:
    scenario = coopqp.load("pick_and_place")
    phases = tuple(replace(p, duration=round(share * p.duration, 2)) for p in scenario.phases)
    loop, robot = simulated(scenario.changed(phases=phases))
    notes = []
    for _ in range(round(260 / 0.5 * share)):
        go(loop, robot, 1)
        notes += [(loop.status.name, loop.note)] if loop.note else []
    assert loop.phase.name == "reach"
    if share == 1.0:
        assert not notes
        return
    assert set(notes[:-1]) == {("STOPPED", "slows down for phase 'reach'")}
    status, note = notes[-1]
    assert status == "OPTIMAL"
    assert note.startswith("phase approach ended with tasks missed: left above.position by 0.00")


def test_what_cannot_be_asked_for_is_refused_at_once() -> None:
    bad: dict[str, Any] = {"reference": "mesured", "patience": 0.0, "keep": np.inf}
    with pytest.raises(InvalidValueError) as refused:
        OnlineLoop(follows(), **bad)
    assert str(refused.value).splitlines() == [
        "reference: unknown choice 'mesured'; did you mean 'measured'?",
        "patience: found 0.0 s; needs a finite time, more than 0",
        "keep: found inf s; needs a finite time, more than 0 and at most 3600 s",
    ]


def test_the_history_is_bounded_and_in_order() -> None:
    loop, robot = simulated(follows(), keep=0.2)
    _, v = go(loop, robot, 50, {"target": NEAR})
    kept = loop.history.last()
    np.testing.assert_array_equal(kept.number, np.arange(30, 50))
    np.testing.assert_array_equal(kept.v, v[30:])
    assert kept.causes_at(-1) == (Status.OPTIMAL,)
    assert len(loop.history.last(3).t) == 3


RUBBISH: list[Any] = [
    None, "x", b"", object(), [], [[1.0]], np.full(10, np.inf), {}, lambda: 1, 1e308, (1, 2),
    np.zeros((10, 10)), [None] * 10, np.array([1 + 1j] * 10), True,
]  # fmt: skip


def test_nothing_is_raised_or_printed(capfd: Any, rng: Any) -> None:
    loop, robot = simulated(follows())
    go(loop, robot, 3)
    for _ in range(200):
        q = RUBBISH[rng.integers(len(RUBBISH))] if rng.random() < 0.3 else robot.read()
        value = RUBBISH[rng.integers(len(RUBBISH))]
        inputs = [{"target": value}, {"target": (value, value)}, value, {value.__class__: value}]
        command = loop.tick(q, inputs[rng.integers(4)])
        assert np.isfinite(command.v).all()
        robot.write(loop.setpoint, command.v)
        if loop.stopped:
            loop.resume()
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("bad", [np.zeros(3), None, "x", np.zeros((10, 10))])
@pytest.mark.parametrize("of", ["state", "loop"])
def test_arrays_of_another_shape_are_an_error_of_the_tick(bad: Any, of: str) -> None:
    """Whoever puts them into the state, or in the setpoint's place, leaves the arms at rest."""
    scenario = follows()
    loop, q = OnlineLoop(scenario, clock=None), scenario.chain.q_start
    for _ in range(5):
        loop.tick(q)
    setattr(*((loop.state, "q", bad) if of == "state" else (loop, "setpoint", bad)))
    for _ in range(3):
        assert loop.tick(q).causes == (Status.RAISED,)
        assert not loop.command.v.any()
