"""``coopqp time``: from a recorded run to a reference, and bad input in one line each."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from command_line import typed

from coopqp.base.table import read_table


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("slow")
    assert typed("compare", "point_on_point", "--controllers", "qp", "--out", folder).exit_code == 0
    return folder


@pytest.mark.full
def test_a_run_becomes_a_reference(slow: Path, tmp_path: Path) -> None:
    result = typed("time", slow, "--out", tmp_path / "fast")
    assert result.exit_code == 0
    assert "The fastest motion along the path takes 0.1" in result.output
    assert re.search(r"speed of LElbowRoll +0\.07\d +45\.\d% +0\.150\d", result.output)
    assert re.search(r"load 20 % lighter +0\.159\d", result.output)
    page = (tmp_path / "fast" / "timed.html").read_text(encoding="utf-8")
    (svg,) = re.findall("<svg.*</svg>", page)
    cells = r"</span></th><td[^>]*>0\.07\d</td><td[^>]*>45\.\d%</td><td[^>]*>0\.150"
    (color,) = re.findall(r"color: (#\w+)\">speed of LElbowRoll" + cells, page)
    lines = [line.get("stroke") for line in ElementTree.fromstring(svg)]
    assert 50 < lines.count(color) < 150  # of 200 intervals
    file = tmp_path / "fast" / "timed.csv"
    assert file.read_text(encoding="utf-8").startswith("t,RShoulderPitch,")
    again = typed("time", file, "--scenario", "point_on_point", "--json")
    data = json.loads(again.output)
    assert 0.1 < data["duration"] < 0.2
    assert sum(data["shares"].values()) == pytest.approx(1.0)
    assert 0.1 < min(data["would_do"].values()) < data["duration"]


def test_a_scenario_of_ones_own_is_not_written_over(slow: Path, tmp_path: Path) -> None:
    own = tmp_path / "scenario.yaml"
    own.write_bytes((slow / "scenario.yaml").read_bytes() + b"# mine\n")
    for command in (("time", slow), ("plan", own)):
        result = typed(*command, "--out", tmp_path)
        assert result.exit_code == 2
        assert "scenario.yaml' is there and does not follow" in result.output
        assert own.read_bytes().endswith(b"# mine\n")
        assert [*tmp_path.iterdir()] == [own]
    assert typed("time", slow, "--out", tmp_path / "fast").exit_code == 0
    assert typed("time", slow, "--out", tmp_path / "fast").exit_code == 0  # its own it may replace


def test_what_is_written_is_followed(slow: Path, tmp_path: Path) -> None:
    assert typed("time", slow, "--out", tmp_path).exit_code == 0
    result = typed("compare", tmp_path / "scenario.yaml", "--controllers", "qp")
    assert result.exit_code == 0
    assert "Reaches the goal" in " ".join(result.output.split())
    table = read_table(tmp_path / "timed.csv")
    np.testing.assert_allclose(np.diff(table.times()), 0.01)  # to the end, where it rests
    assert not table.take(["v[LElbowRoll]"])[-1].any()


@pytest.mark.full
def test_a_table_of_joints_is_whose_scenario_stands_beside_it(slow: Path, tmp_path: Path) -> None:
    assert typed("time", slow, "--out", tmp_path).exit_code == 0
    for scenario in ((), ("--scenario", "point_on_point")):
        named = typed("time", tmp_path, *scenario)
        assert "The fastest motion along the path takes 0.1" in named.output
    (tmp_path / "plan.csv").write_text((tmp_path / "timed.csv").read_text())
    two = typed("time", tmp_path)
    assert "has plan.csv and timed.csv; give one of them, not the folder" in two.output
    (tmp_path / "plan.csv").unlink()
    (tmp_path / "scenario.yaml").unlink()
    for path in (tmp_path, tmp_path / "timed.csv"):
        result = typed("time", path)
        assert result.exit_code == 2
        assert "timed.csv' says where joints are, not whose; add --scenario" in result.output


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--torque", "0.05"], "of the path, between points 0 and 1: the object cannot be held"),
        (["--torque", "nan"], "torque: found nan, needs a share in (0, 1]"),
        (["--controller", "nobody"], "unknown controller 'nobody'"),
        (["--scenario", "two_so101"], "has no column 'q[left/shoulder_pan]'"),
        (["--speed", "0", "90"], "speed: found 90 rad/s at the end, needs 0 to"),
    ],
)
def test_bad_input_ends_in_one_line(
    slow: Path, tmp_path: Path, options: list[str], words: str
) -> None:
    result = typed("time", slow, "--out", tmp_path / "fast", *options)
    assert result.exit_code == 2
    errors = [line for line in result.output.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert words in errors[0]
    assert not (tmp_path / "fast").exists()


def test_a_table_of_joints_has_no_controller_and_no_other_robots_joints(
    slow: Path, tmp_path: Path
) -> None:
    assert typed("time", slow, "--out", tmp_path).exit_code == 0
    table = tmp_path / "timed.csv"
    result = typed("time", table, "--scenario", "point_on_point", "--controller", "qp")
    assert result.exit_code == 2
    assert "is a table of joints, which no controller ran" in result.output
    result = typed("time", table, "--scenario", "two_pandas")
    assert result.exit_code == 2
    assert "timed.csv: has columns that are no joints of panda + panda: LElbowRoll" in result.output
