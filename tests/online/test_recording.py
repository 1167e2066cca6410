"""Recordings of loops that run: what is in them, also when the process is killed."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import typed
from forking import program
from scenario_files import HEAD, PHASES, TAIL, phased

import coopqp
from coopqp import CoopqpError, InvalidValueError, Law, Scenario, State
from coopqp.kernel import native
from coopqp.online.recording import ROOM, LiveRecording
from coopqp.recordings import format_of, read
from coopqp.recordings.column import cells
from coopqp.scenario.catalog import Catalog
from coopqp.study.trace_file import off_the_record, recorded_tick, state_from_trace


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return coopqp.load("joint_limit_stress")


@pytest.fixture
def law(scenario: Scenario) -> Law:
    return scenario.controllers["qp"].build(scenario.problem())


def drive(law: Law, state: State, recording: LiveRecording, ticks: int) -> list[Any]:
    """A robot whose encoders are 2 mrad off and noisy; the velocities that were commanded."""
    rng, found = np.random.default_rng(7), []
    for _ in range(ticks):
        command = law.tick(state)
        recording.tick(state, command, 100.0)
        found.append(command.v.copy())
        state.advance(command.v, law.problem.dt)
        state.q_measured = state.q + 2e-3 + 1e-4 * rng.normal(size=len(state.q))
    return found


def column(path: Path, name: str) -> list[Any]:
    """A column of a recording; None where it is empty."""
    return cells(format_of(path).read(path).columns[name])


def test_every_tick_is_repeated_bit_for_bit(scenario: Scenario, law: Law, tmp_path: Path) -> None:
    path, state = tmp_path / "live.arrows", law.start(q_measured=scenario.chain.q_start)
    with LiveRecording(path, scenario, law, state, controller="qp", every=0.01) as recording:
        v = drive(law, state, recording, 300)
    assert recording.dropped == 0
    known = format_of(path)
    assert not known.cut_short(path)
    again = known.scenario(path, Catalog()).problem()
    fresh = scenario.controllers["qp"].build(again)
    for tick in (0, 1, 120, 299):
        given = state_from_trace(read(path), "qp", tick, fresh)  # type: ignore[arg-type]
        np.testing.assert_array_equal(fresh.tick(given).v, v[tick])
    exported = tmp_path / "qp.mcap"
    assert typed("export", path, "--to", "mcap").exit_code == 0
    for tick in (0, 200):
        own = recorded_tick(path, scenario, "qp", tick)
        assert recorded_tick(exported, scenario, "qp", tick) == own


def test_a_tick_is_written_the_same_without_the_kernel(
    scenario: Scenario, law: Law, tmp_path: Path
) -> None:
    """Also one with a number that is no float; errors are equal but for rounding."""
    state = law.start(q_measured=scenario.chain.q_start)
    paths = [tmp_path / f"{name}.arrows" for name in ("kernel", "python")]
    first, second = (
        LiveRecording(path, scenario, law, state, controller="qp", every=0.0) for path in paths
    )
    second._quick = None  # type: ignore[assignment]
    for k in range(30):
        command = law.tick(state)
        command.scale = 1 if k == 20 else command.scale
        for recording in (first, second):
            recording.tick(state, command, 100.0)
        state.advance(command.v, law.problem.dt)
        state.q_measured = None if k == 10 else state.q + 1e-3
    first.close(), second.close()
    columns = [format_of(path).read(path).columns for path in paths]
    assert columns[0].keys() == columns[1].keys()
    for name, one in columns[0].items():
        compare = np.testing.assert_array_equal
        if name in ("loop_position", "loop_orientation"):
            compare = partial(np.testing.assert_allclose, rtol=1e-12)
            assert np.asarray(one, float).max() > 0.0
        compare(np.asarray(one), np.asarray(columns[1][name]))


@pytest.mark.skipif(native.module() is None, reason="the kernel is not built")
def test_what_does_not_fit_a_part_is_left_to_python_and_nan_stays() -> None:
    Columns, table = native.module().Columns, np.zeros((4, 2))  # type: ignore[union-attr]
    add = Columns(table, [0, 1, 3], [1, 2, 1], 1).add
    nothing, unknown = np.zeros(12), np.zeros(12)
    unknown[[0, 9]] = np.nan
    assert add(0, [1.0, unknown, np.ones(1)])
    np.testing.assert_array_equal(table[:, 0], [1.0, np.nan, np.nan, 1.0])
    assert not add(1, [1.0, nothing, np.ones(2)])
    assert not add(2, [1.0, nothing, np.ones(1)])
    for first, sizes in (([0, 1, 4], [1, 2, 1]), ([0, 1, 3], [1, 1, 1]), ([0, 1], [1, 2, 1])):
        with pytest.raises(ValueError, match="a part beyond the table"):
            Columns(table, first, sizes, 1)


def test_the_ring_goes_round_and_counts_what_it_cannot_hold(
    scenario: Scenario, law: Law, tmp_path: Path
) -> None:
    path, state = tmp_path / "live.arrows", law.start(q_measured=scenario.chain.q_start)
    held = int(ROOM / scenario.dt)
    recording = LiveRecording(path, scenario, law, state, controller="qp", every=0.0)
    drive(law, state, recording, held - 10)
    recording.flush()
    drive(law, state, recording, held + 5)  # round the end, and five too many
    recording.flush()
    drive(law, state, recording, 3)
    recording.close()
    assert recording.dropped == 5
    ticks = column(path, "tick")
    assert ticks == [*range(2 * held - 10), *range(2 * held - 5, 2 * held - 2)]
    with pytest.raises(InvalidValueError, match="but not the one before it"):
        state_from_trace(read(path), "qp", 2 * held - 5, law)  # type: ignore[arg-type]


def test_after_a_stop_the_loop_begins_anew(scenario: Scenario, law: Law, tmp_path: Path) -> None:
    path, state = tmp_path / "live.arrows", law.start(q_measured=scenario.chain.q_start)
    with LiveRecording(path, scenario, law, state, controller="qp") as recording:
        recording.tick(state, law.tick(state), 1.0)
        state = law.start(q_measured=scenario.chain.q_start)
        recording.begin(state)
        recording.tick(state, law.tick(state), 1.0)
    assert column(path, "tick") == [0, 2]


def test_phases_go_into_one_recording(tmp_path: Path) -> None:
    """The time of the second goes on, and its first tick follows from the last one's velocity."""
    scenario = phased(tmp_path, HEAD + PHASES + TAIL)
    trace, path = coopqp.run(scenario, controller="qp"), tmp_path / "live.arrows"
    ends = (*scenario.first_ticks, scenario.ticks)
    problems = list(scenario.problems(lambda first: trace.q[first]))
    laws = [scenario.controllers["qp"].build(problem) for problem in problems]
    state = laws[0].start()
    room = max(sum(law.memory_sizes.values()) for law in laws)
    with LiveRecording(path, scenario, laws[0], state, controller="qp", memory=room) as recording:
        for law, (first, end) in zip(laws, pairwise(ends), strict=True):
            if first:
                v, state = state.v, law.start()
                state.v[:] = v
                recording.begin(state, scenario.dt * first)
            for _ in range(first, end):
                command = law.tick(state)
                recording.tick(state, command, 100.0)
                state.advance(command.v, scenario.dt)
    assert column(path, "tick") == list(range(scenario.ticks))
    np.testing.assert_allclose(column(path, "t"), trace.t[:-1], atol=1e-12)
    for tick in (10, 60, 61, 130):
        record = recorded_tick(path, scenario, "qp", tick)
        assert off_the_record(path, record) < 1e-9


def test_ticks_that_do_not_come_out_as_recorded_are_said(
    scenario: Scenario, law: Law, tmp_path: Path
) -> None:
    path, state = tmp_path / "live.arrows", law.start(q_measured=scenario.chain.q_start)
    slower = scenario.portable.replace("kappa: 100.0", "kappa: 50.0").replace("gain: 5", "gain: 1")
    assert slower != scenario.portable
    with LiveRecording(path, scenario, law, state, controller="qp", source=slower) as recording:
        drive(law, state, recording, 60)
    result = typed("explain", path, "--tick", "50")
    assert result.exit_code == 0
    assert "done again it commands another velocity than recorded" in result.stderr


LOOP = """\
    import sys, time
    from pathlib import Path
    import coopqp
    from coopqp.online.recording import LiveRecording

    scenario = coopqp.load("point_on_point")
    law = scenario.controllers["qp"].build(scenario.problem())
    state = law.start(q_measured=scenario.chain.q_start)
    with LiveRecording(Path(sys.argv[1]), scenario, law, state, controller="qp") as recording:
        for tick in range(100_000):
            command = law.tick(state)
            recording.tick(state, command, 100.0)
            state.advance(command.v, scenario.dt)
            state.q_measured = state.q.copy()
            print(tick, time.monotonic(), flush=True)
            time.sleep(0.002)
"""


def test_a_killed_process_loses_less_than_a_second(tmp_path: Path) -> None:
    path = tmp_path / "live.arrows"
    with program(LOOP, path) as process:
        ticks = [process.out.readline().split()]
        end = time.monotonic() + 1.0
        while time.monotonic() < end:
            ticks.append(process.out.readline().split())
        os.kill(process.pid, signal.SIGKILL)
        ticks += [line.split() for line in process.out.read().splitlines()]
        assert process.ended() == -signal.SIGKILL
    when = {int(line[0]): float(line[1]) for line in ticks if len(line) == 2}
    found = column(path, "tick")
    assert found == list(range(len(found)))
    assert when[max(when)] - when[found[-1]] < 1.0
    assert format_of(path).cut_short(path)
    result = typed("export", path, "--to", "rosbag2")
    assert result.exit_code == 0
    assert "was cut short" in result.stderr
    assert len(read(tmp_path / "qp.rosbag2")) == len(found)


@pytest.mark.parametrize("cut", [1, 8, 100, 3000])
def test_what_is_whole_of_a_torn_file_is_read(
    cut: int, scenario: Scenario, law: Law, tmp_path: Path
) -> None:
    path, state = tmp_path / "live.arrows", law.start()
    recording = LiveRecording(path, scenario, law, state, controller="qp", every=0.0)
    for _ in range(4):
        drive(law, law.start(), recording, 5)
        recording.flush()
    recording.close()
    whole = format_of(path).read(path).columns
    path.write_bytes(path.read_bytes()[:-cut])
    found = format_of(path).read(path)
    for name, values in found.columns.items():
        np.testing.assert_array_equal(values, whole[name][: len(found)])
    assert len(found) in ((20,) if cut <= 8 else (15, 10, 5))
    assert format_of(path).cut_short(path)


def test_a_full_disk_does_not_reach_the_loop(
    scenario: Scenario, law: Law, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, state = tmp_path / "live.arrows", law.start()
    recording = LiveRecording(path, scenario, law, state, controller="qp", every=0.0)

    def full(_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(recording, "_write", full)
    drive(law, state, recording, 3)
    recording.flush()
    assert "No space left on device" in recording.fault
    drive(law, law.start(), recording, 3)
    with pytest.raises(CoopqpError, match="No space left"):
        recording.close()


@pytest.mark.parametrize(
    ("name", "wrong", "words"),
    [
        ("live.csv", {}, "needs a name that ends with .arrows"),
        ("there.arrows", {}, "File exists"),
        ("live.arrows", {"source": ""}, "was read from no file"),
    ],
)
def test_what_could_not_be_read_is_refused(
    name: str, wrong: dict[str, Any], words: str, scenario: Scenario, law: Law, tmp_path: Path
) -> None:
    (tmp_path / "there.arrows").write_bytes(b"another's")
    given = replace(scenario, **wrong)
    with pytest.raises(CoopqpError, match=words):
        LiveRecording(tmp_path / name, given, law, law.start(), controller="qp")
    assert (tmp_path / "there.arrows").read_bytes() == b"another's"
