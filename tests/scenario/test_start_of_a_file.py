"""A scenario file that leaves its start to be solved, and the command for it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import refused, typed
from scenario_files import write

from coopqp.base.errors import ScenarioError
from coopqp.model.state import State
from coopqp.scenario.loader import load, load_and_solve, shipped
from coopqp.scenario.start_solver import StartSolution, yaml_text
from coopqp.scenario.yaml import read_yaml

CLOSED = 1e-9  # loop error of a start [m, rad]
YEO = shipped()["yeo_4_5"].read_text(encoding="utf-8")


@pytest.fixture
def to_solve(tmp_path: Path) -> Path:
    """yeo_4_5 without its start."""
    return yeo_with(tmp_path, "start: solve\n")


def yeo_with(folder: Path, start: str, old: str = "", new: str = "") -> Path:
    before, rest = YEO.split("start:", 1)
    text = f"{before}{start}tasks:{rest.split('tasks:', 1)[1]}"
    assert old in text
    return write(folder, text.replace(old, new, 1) if old else text)


def test_a_file_may_leave_the_start_to_be_solved(to_solve: Path) -> None:
    scenario = load(to_solve)
    assert isinstance(scenario.start, dict)
    assert set(scenario.start) == {"right", "left", "left.hinge"}
    assert np.abs(State(scenario.chain).loop_error).max() < CLOSED
    assert scenario.start == load_and_solve(to_solve).start


@pytest.mark.parametrize("start", ["", "start: solve\n", "start: {right: [9, 9]}\n"])
def test_what_is_printed_can_be_pasted(tmp_path: Path, start: str) -> None:
    """Whatever start the file has, or has not."""
    path = yeo_with(tmp_path, start)
    result = typed("solve-start", path)
    assert result.exit_code == 0
    assert result.stdout.startswith("start:   # rad, m; ")
    pasted = load(yeo_with(tmp_path, result.stdout))
    assert np.abs(State(pasted.chain).loop_error).max() < 1e-7
    assert pasted.chain.starts_inside


def test_the_printed_start_has_no_minus_zero_and_stays_inside() -> None:
    found = StartSolution(
        q=np.zeros(2), passive={}, start={"arm": [-1e-12, 1.0], "x": -0.5}, margin=np.inf,
        tries=1, candidates=1,
    )  # fmt: skip
    assert yaml_text(found).splitlines()[1:] == [
        "  arm: [0.00000000, 1.00000000]",
        "  x: -0.50000000",
    ]


def test_a_finger_that_is_nearest_to_its_limit_is_to_be_locked() -> None:
    found = StartSolution(
        q=np.zeros(1), passive={}, start={"arm": [0.0]}, margin=0.02, tries=1, candidates=1,
        tightest="panda_finger_joint1",
    )  # fmt: skip
    assert "limits (at panda_finger_joint1, which seems to be a gripper's: lock it)" in yaml_text(
        found
    )


def test_it_prints_json(to_solve: Path) -> None:
    data = json.loads(typed("solve-start", to_solve, "--json", "--seed", 5).stdout)
    assert set(data["start"]) == {"right", "left", "left.hinge"}
    assert data["margin"] > 0.1
    assert data["found"] > 1
    assert data["start"] == load_and_solve(to_solve, seed=5).start


FAULTS = [
    ("start: slove\n", "", "", 'start: found "slove"; needs joint values by arm or joint, or'),
    ("start: [1]\n", "", "", "start: found [1]; needs joint values by arm or joint, or the word"),
    ("start: solve\nstart_deg: {right: [0]}\n", "", "", "start_deg: give one of start (radians)"),
    ("start_deg: solve\n", "", "", "start_deg: found \"solve\"; needs a mapping"),
    (
        "start: solve\n",
        "  pose: {position: [0.45, 0.0, 0.25]}", "",
        "start: to solve for a start, give object.pose",
    ),
    (
        "start: solve\n",
        "rigid: {object_in_hand: {position: [0.04, 0.15, 0.0]}}", "rigid",
        "start: to solve for a start, give object_in_hand in the grasp of right",
    ),
    (
        "start: solve\n",
        "position: [0.45, 0.0, 0.25]", "position: [0.95, 0.0, 0.25]",
        "start: arm right cannot reach its grasp: the nearest of 120 tries is off by ",
    ),
    ("start: {right: [0, 0]}\n", "", "", "start: right: found 2 numbers, needs 4: r1, r2, r3, r4"),
    ("start: {left.hing: 0.1}\n", "", "", "start.left.hing: unknown passive joint 'left.hing'"),
    ("start: {left.hinge: [0, 1]}\n", "", "", "start: left.hinge: found [0.0, 1.0], needs one"),
]  # fmt: skip


@pytest.mark.parametrize(("start", "old", "new", "message"), FAULTS)
def test_a_start_that_cannot_be_is_refused_with_its_place(
    tmp_path: Path, start: str, old: str, new: str, message: str
) -> None:
    path = yeo_with(tmp_path, start, old, new)
    with pytest.raises(ScenarioError) as caught:
        load(path)
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"{path}:")
    assert len(caught.value.faults) == 1


def test_the_command_says_what_cannot_be_without_a_traceback(tmp_path: Path) -> None:
    far = yeo_with(tmp_path, "", "position: [0.45, 0.0, 0.25]", "position: [0.95, 0.0, 0.25]")
    assert "arm right cannot reach its grasp" in refused("solve-start", far)


def test_a_passive_joint_starts_where_it_is_put(tmp_path: Path) -> None:
    found = read_yaml(shipped()["yeo_4_5"]).data["start"]
    start = "start: " + json.dumps({**found, "left.hinge": 0.3}) + "\n"
    free = yeo_with(tmp_path, start, "object_in_hand: {position: [0.04, -0.15, 0.0]}", "")
    chain = load(free).chain
    assert chain.q_start[chain.joint_names.index("left.hinge")] == 0.3
    assert np.abs(State(chain).loop_error).max() < CLOSED
    with pytest.raises(ScenarioError, match="the grasp does not close at the start"):
        load(yeo_with(tmp_path, start))
    beyond = "start: " + json.dumps({**found, "left.hinge": 1.3}) + "\n"
    old = "object_in_hand: {position: [0.04, -0.15, 0.0]}"
    with pytest.raises(ScenarioError, match=r"start.left.hinge: left.hinge starts at 1.3 rad, out"):
        load(yeo_with(tmp_path, beyond, old, ""))


def test_a_controller_with_another_grasp_starts_with_the_same_joints(tmp_path: Path) -> None:
    old, new = "position: [0.04, -0.15, 0.0]", "position: [0.04, -0.15, 0.0], rpy: [0, 0, -0.3]"
    path = yeo_with(tmp_path, "start: solve\ngrasp_of: {qp: rigid}\n", old, new)
    scenario = load(path)
    assert isinstance(scenario.start, dict)
    assert abs(scenario.start["left.hinge"]) > 0.1
    firm = scenario.held_by("qp").chain
    assert not firm.passive.size
    for joint, value in zip(firm.joint_names, firm.q_start, strict=True):
        assert value == scenario.chain.q_start[scenario.chain.joint_names.index(joint)]
