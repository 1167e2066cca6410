"""A session on disk plays again, to the last bit."""

from __future__ import annotations

import csv
import resource
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from online_loops import follows, go, simulated

import coopqp
from coopqp.base.errors import CoopqpError
from coopqp.execution.comparison import compare
from coopqp.execution.controller_run import run
from coopqp.online.loop import OnlineLoop
from coopqp.scenario.scenario import Scenario


def teleoperated(scenario: Scenario, out: Path, ticks: int, **settings: Any) -> tuple[Any, Any]:
    """A hand that wanders, sends at odd times, stutters and falls silent."""
    loop, robot = simulated(scenario, out=out, **settings)
    rng, place, q, v = np.random.default_rng(3), np.array([0.17, 0.01, 0.05]), [], []
    for k in range(ticks):
        inputs = {}
        if rng.random() < 0.3 and not 110 <= k < 150:
            place = place + rng.normal(0.0, 0.004, 3)
            age = float(rng.uniform(0.0, 0.03))
            inputs = (
                {"target": (place, loop.now - age)} if rng.random() < 0.5 else {"target": place}
            )
        one = go(loop, robot, 1, inputs)
        q.append(one[0][0])
        v.append(one[1][0])
    loop.close()
    return np.array(q), np.array(v)


@pytest.mark.parametrize(
    ("plant", "settings"),
    [("kinematic", {"reference": "measured"}), ("rigid_body", {"reference": "commanded"})],
)
def test_it_plays_again_to_the_last_bit(tmp_path: Path, plant: str, settings: Any) -> None:
    ticks = 160 if plant == "kinematic" else 50
    scenario = follows(plant)
    q, v = teleoperated(scenario, tmp_path / "out", ticks, **settings)
    again = coopqp.load(tmp_path / "out" / "scenario.yaml")
    assert again.ticks == ticks
    trace = run(again, controller="qp")
    np.testing.assert_array_equal(trace.commanded, q)
    np.testing.assert_array_equal(trace.v, v)
    assert {"INPUT_STALE"} < set(trace.status) or plant != "kinematic"


def test_other_laws_can_be_compared_on_it(tmp_path: Path) -> None:
    teleoperated(follows(), tmp_path / "out", 40, reference="measured")
    found = compare(coopqp.load(tmp_path / "out" / "scenario.yaml"))
    assert {"qp", "pseudoinverse"} <= set(found.verdicts)


def test_the_files_say_what_arrived(tmp_path: Path) -> None:
    loop, robot = simulated(follows(), out=tmp_path / "out")
    go(loop, robot, 10)
    go(loop, robot, 1, {"target": ([0.17, 0.0, 0.05], 0.08)})
    go(loop, robot, 1, {"target": [np.nan] * 3})
    loop.close()
    with (tmp_path / "out" / "inputs" / "target.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["t", "sent", "x", "y", "z"]
    assert len(rows) == 2
    np.testing.assert_allclose([float(x) for x in rows[1]], [0.1, 0.08, 0.17, 0.0, 0.05], 1e-12)


def test_what_is_older_than_a_second_is_on_disk_without_an_end(tmp_path: Path) -> None:
    loop, robot = simulated(follows(), out=tmp_path / "out")
    go(loop, robot, 150, {"target": [0.17, 0.0, 0.05]})
    again = coopqp.load(tmp_path / "out" / "scenario.yaml")
    feed = again.inputs["target"].feed_file
    assert feed is not None
    assert len(Path(feed).read_text().splitlines()) > 90


def _placed() -> str:
    return "object: {pose: {position: [0.19, 0.0, 0.05], rpy: [0.0, 0.1, 0.0]}}\n"


def _in_hand() -> str:
    chain, rows = follows().chain, ["grasps:"]
    for arm, X in chain.hold.X_EO.items():
        place, angles = X.translation.tolist(), pin.rpy.matrixToRpy(X.rotation).tolist()
        rows.append(f"  {arm}: {{rigid: {{object_in_hand: {{position: {place}, rpy: {angles}}}}}}}")
    return "\n".join(rows) + "\n"


@pytest.mark.parametrize("said", [_placed, _in_hand])
def test_a_session_begun_elsewhere_with_a_written_grasp_plays_again(
    tmp_path: Path, said: Callable[[], str]
) -> None:
    scenario = follows(more=said())
    loop = OnlineLoop(scenario, clock=None, reference="measured", out=tmp_path / "out")
    q, found = scenario.chain.q_start + 0.01, []
    for _ in range(20):
        loop.tick(q, {"target": [0.18, 0.0, 0.05]})
        found.append(q.copy())
        q = loop.setpoint.copy()
    loop.close()
    trace = run(coopqp.load(tmp_path / "out" / "scenario.yaml"), controller="qp")
    np.testing.assert_array_equal(trace.commanded, found)


def test_a_folder_is_not_written_to_twice(tmp_path: Path) -> None:
    scenario = follows()
    teleoperated(scenario, tmp_path / "out", 5)
    loop = OnlineLoop(scenario, clock=None, out=tmp_path / "out")
    with pytest.raises(CoopqpError, match="holds a session already"):
        loop.begin(scenario.chain.q_start)


def test_a_disk_that_fails_does_not_stop_the_robot(tmp_path: Path) -> None:
    loop, robot = simulated(follows(), out=tmp_path / "out")
    go(loop, robot, 5, {"target": [0.17, 0.0, 0.05]})
    (tmp_path / "out" / "inputs").rmdir()
    _, v = go(loop, robot, 120, {"target": [0.17, 0.0, 0.05]})
    assert v.any()
    with pytest.raises(CoopqpError, match="the record is not whole"):
        loop.close()


def test_a_full_disk_leaves_whole_rows(tmp_path: Path) -> None:
    loop, robot = simulated(follows(), out=tmp_path / "out")
    go(loop, robot, 20, {"target": [0.17, 0.0, 0.05]})
    loop.flush()
    file = tmp_path / "out" / "inputs" / "target.csv"
    whole = file.read_text()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    go(loop, robot, 60, {"target": [0.17, 0.0, 0.05]})
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(whole) + 100, limits[1]))
    try:
        loop.flush()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    with pytest.raises(CoopqpError, match="the record is not whole"):
        loop.close()
    assert file.read_text() == whole
    compare(coopqp.load(tmp_path / "out" / "scenario.yaml"), controllers=["qp"])


def test_without_a_source_there_is_the_replay_in_python(tmp_path: Path) -> None:
    scenario = replace(follows(), source="")
    q, _ = teleoperated(scenario, tmp_path / "out", 30, reference="measured")
    assert not (tmp_path / "out" / "scenario.yaml").exists()
    loop, robot = simulated(scenario, out=tmp_path / "two")
    go(loop, robot, 20, {"target": [0.17, 0.0, 0.05]})
    again = loop.replay()
    np.testing.assert_array_equal(run(again, controller="qp").commanded, loop.history.last().q)
    assert len(q) == 30
