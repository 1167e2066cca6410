"""A live recording is read back, whatever came in between: stops, silence, inputs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import typed
from online_loops import FOLLOWS, go, simulated

import coopqp
from coopqp.recordings import format_of, read
from coopqp.scenario.catalog import Catalog
from coopqp.study.trace_file import off_the_record, recorded_tick

pytest.importorskip("pyarrow")

NEAR = {"target": [0.15, 0.01, 0.05]}


def recorded(tmp_path: Path, drive: Any) -> Path:
    from coopqp.online.recording import LiveRecording

    def record(loop: Any) -> Any:  # as docs/online.md has it
        about = {"controller": loop.controller, "source": loop.source}
        return LiveRecording(tmp_path / "run.arrows", loop.scenario, loop.law, loop.state, **about)

    path = tmp_path / "follows.yaml"
    path.write_text(FOLLOWS.replace("PLANT", "kinematic"), encoding="utf-8")
    loop, robot = simulated(coopqp.load(path), record=record)
    drive(loop, robot)
    loop.close()
    return tmp_path / "run.arrows"


def _speaks_on(loop: Any, robot: Any) -> None:
    go(loop, robot, 10, NEAR)


def _none(loop: Any, robot: Any) -> None:
    robot.write(loop.setpoint, loop.tick(None).v)


def _nan(loop: Any, robot: Any) -> None:
    robot.write(loop.setpoint, loop.tick(np.full(10, np.nan)).v)


def _jump(loop: Any, robot: Any) -> None:
    robot.write(loop.setpoint, loop.tick(robot.read() + 1.0).v)


def _stop(loop: Any, robot: Any) -> None:
    loop.stop()
    go(loop, robot, 30, NEAR)
    loop.resume()


@pytest.mark.few(2)
@pytest.mark.parametrize("gap", [_none, _nan, _jump, _stop])
def test_every_tick_around_a_halt_is_read(tmp_path: Path, gap: Any) -> None:
    def drive(loop: Any, robot: Any) -> None:
        go(loop, robot, 20, NEAR)
        gap(loop, robot)
        go(loop, robot, 20, NEAR)

    path = recorded(tmp_path, drive)
    scenario = format_of(path).scenario(path, Catalog())
    ticks = read(path).columns["tick"].tolist()
    asked = [k for k in (0, 10, 19, 20, 21, 22, 35, 50, 51, ticks[-1]) if k in ticks]
    said = 0
    for k in asked:
        if k and k - 1 not in ticks:
            continue
        record = recorded_tick(path, scenario, "qp", k)
        assert off_the_record(path, record) < 1e-9, k
        said += record.status != "OPTIMAL"
    assert said >= 1
    result = typed("explain", path, "--tick", "20")
    assert result.exit_code == 0
    assert "another velocity" not in result.stderr
    if gap is not _nan:
        assert "The controller was not evaluated; the loop comes to rest" in result.stdout
    assert typed("export", path, "--to", "mcap").exit_code == 0


def test_what_was_made_of_inputs_is_recorded_by_itself(tmp_path: Path) -> None:
    path = recorded(tmp_path, lambda loop, robot: go(loop, robot, 60, NEAR))
    assert read(path).columns["followed_rate[target].x"][30] != 0.0
    result = typed("explain", path, "--tick", "30")
    assert result.exit_code == 0
    assert result.stderr == ""
    scenario = format_of(path).scenario(path, Catalog())
    for k in (0, 1, 30, 59):
        assert off_the_record(path, recorded_tick(path, scenario, "qp", k)) < 1e-12
