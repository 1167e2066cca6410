"""The check before the grasp on simulated Feetech buses: each fault is named, sound arms pass."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from scenario_files import LOADABLE

from adapters.bus_robots import BusRobot, checked, faults, names
from coopqp.cli import main
from coopqp.online.joint_check import first_reading
from coopqp.online.loop import OnlineLoop
from coopqp.online.simulated import SimulatedRobot
from coopqp.scenario.loader import load

pytestmark = pytest.mark.skipif("two_so101" not in LOADABLE, reason="needs example-robot-data")
OF_EACH = {fault: joint for fault, joint in faults() if joint in (0, 3)}

DRIVER = """
from adapters.bus_robots import BusRobot


def robot(scenario):
    return BusRobot({seed}, {fault!r}, 1)
"""


@pytest.mark.few(1)
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


CLASS = """
class Robot:
    k = 0
    def __init__(self, scenario): self.q = scenario.chain.q_start.copy()
    def read(self): self.k += 1; return {read}
    def write(self, q, v): self.q = q; {write}
robot = Robot
"""
RAISES = "driver.py:{line}: your driver raises {error}"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("import nosuch", RAISES.format(line=1, error="ModuleNotFoundError: No module named 'no")),
        ("def robot(:", RAISES.format(line=1, error="SyntaxError: ")),
        ("def robot(s):\n  1 / 0", RAISES.format(line=2, error="ZeroDivisionError: division")),
        ("robot = lambda: 1", "driver.py: your driver raises TypeError: "),
        ("robot = lambda s: exit(3)", RAISES.format(line=1, error="SystemExit: 3")),
        ("robot = lambda s: None", "robot: a NoneType has no method read"),
        (
            CLASS.format(read="self.q", write="") + "robot = lambda s: Robot",
            "robot: read(): missing a required argument: 'self'",
        ),
        (
            CLASS.format(read="self.q", write="").replace("q, v)", "q)"),
            "robot: write(q, v): too many positional arguments",
        ),
        (CLASS.format(read="1 / 0", write=""), RAISES.format(line=5, error="ZeroDivisionError")),
        (CLASS.format(read="self.q", write="1 / 0"), RAISES.format(line=6, error="ZeroDiv")),
        (CLASS.format(read="None", write=""), "no usable measurement for 0.25 s: read() gave None"),
        (CLASS.format(read="{}", write=""), "0.25 s: found dict, needs numbers"),
        (CLASS.format(read="'abc'", write=""), "0.25 s: found a text, needs numbers"),
        (CLASS.format(read="self.q[:3]", write=""), "0.25 s: found shape (3,), needs (10,)"),
    ],
)
def test_command_says_what_a_driver_does_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, words: str
) -> None:
    file = tmp_path / "driver.py"
    file.write_text(text)
    with pytest.raises(SystemExit) as ended:
        main(["check-robot", "two_so101", "--posed", "--driver", str(file)])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


def test_a_first_reading_is_waited_for() -> None:
    loop = OnlineLoop(load("two_so101"), clock=None)
    says = iter([None, None, loop.problem.chain.q_start])
    robot = SimulatedRobot(loop)
    robot.read = lambda: next(says)  # type: ignore[method-assign]
    assert (first_reading(loop, robot) == loop.problem.chain.q_start).all()


def test_command_tries_itself_without_a_driver(capsys: pytest.CaptureFixture[str]) -> None:
    assert "joints follow" in _said(capsys, "planar_pair")


def _said(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with contextlib.suppress(SystemExit):
        main(["check-robot", *arguments])
    found = capsys.readouterr()
    return found.out + found.err
