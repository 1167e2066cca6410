"""The check before the grasp on simulated Feetech buses: each fault is named, sound arms pass."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from scenario_files import LOADABLE

from adapters.bus_robots import BusRobot, checked, faults, names
from coopqp.cli import main

pytestmark = pytest.mark.skipif("two_so101" not in LOADABLE, reason="needs example-robot-data")
OF_EACH = {fault: joint for fault, joint in faults() if joint in (0, 3)}

DRIVER = """
from adapters.bus_robots import BusRobot


def robot(scenario):
    return BusRobot({seed}, {fault!r}, 1)
"""


@pytest.mark.parametrize("seed", range(3))
def test_sound_arms_with_backlash_pass(seed: int) -> None:
    assert checked(BusRobot(seed)) == ""


@pytest.mark.parametrize(("fault", "joint"), OF_EACH.items())
def test_each_fault_is_named(fault: str, joint: int) -> None:
    robot = BusRobot(7, fault, joint)
    assert names(robot, checked(robot))


def test_command_names_what_a_driver_has_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "driver.py"
    file.write_text(DRIVER.format(seed=1, fault="sign both"))
    said = _said(capsys, "two_so101", "--posed", "--driver", str(file))
    assert "left/shoulder_lift reads 0.911 rad where it is put to -0.9 rad: its sign?" in said


def test_command_refuses_a_file_without_a_driver(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "driver.py"
    file.write_text("x = 1")
    assert "has no function robot(scenario)" in _said(capsys, "two_so101", "--driver", str(file))


def test_command_tries_itself_without_a_driver(capsys: pytest.CaptureFixture[str]) -> None:
    assert "joints follow" in _said(capsys, "planar_pair")


def _said(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with contextlib.suppress(SystemExit):
        main(["check-robot", *arguments])
    found = capsys.readouterr()
    return found.out + found.err
