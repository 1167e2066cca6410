"""Code of users that exits, raises anything, or shows no marks."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest
from command_line import refused, refused_in_one_line, typed
from scenario_files import GOOD

from coopqp.base.wording import raised
from coopqp.scenario.catalog import Catalog

TASK = '''
import os, signal, sys
from coopqp import Task, spec
from coopqp.task import Part

asked = [0]

class Mute(Exception):
    """Cannot say what it is."""
    def __str__(self):
        return 1 / 0

@spec
class Bad(Task):
    """Does what it must not."""
    def rows(self, chain):
        {rows}
        return ("z",)
    def parts(self, chain):
        {parts}
        return super().parts(chain)
    def bind(self, start):
        {bind}
        def evaluate(state, rows):
            rows.e[0], rows.J[0] = 0.0 * state.t, 0.0
            {evaluate}
        return evaluate
    def marks(self, t):
        asked[0] += 1
        {marks}
        return ()
'''
SHORT = GOOD.replace("duration: 3.0", "duration: 0.1").replace("duration: 2.0", "duration: 0.1")


def given(folder: Path, **code: str) -> tuple[Path, Path]:
    """A scenario with a task that does something somewhere, and its folder of plug-ins."""
    parts = {"rows": "pass", "bind": "pass", "evaluate": "pass", "marks": "pass", "parts": "pass"}
    (folder / "own" / "tasks").mkdir(parents=True)
    (folder / "own" / "tasks" / "bad.py").write_text(TASK.format(**parts | code), encoding="utf-8")
    path = folder / "s.yaml"
    path.write_text(SHORT.replace("secondary:", "  - bad: {}\nsecondary:"), encoding="utf-8")
    return path, folder / "own"


@pytest.mark.parametrize(
    ("where", "raises", "said"),
    [
        ("rows", "sys.exit(0)", "raises SystemExit: 0"),
        ("bind", "raise GeneratorExit", "raises GeneratorExit"),
        ("evaluate", "raise BaseException('b')", "raises BaseException: b"),
        ("marks", "raise Mute", "raises Mute"),
    ],
)
def test_whatever_a_task_raises_at_the_border_is_its_one_line(
    tmp_path: Path, where: str, raises: str, said: str
) -> None:
    path, own = given(tmp_path, **{where: raises})
    line = refused_in_one_line("validate", path, "--plugins", own)
    assert line.startswith(f"error: {path}:")
    assert f"{own.resolve()}/tasks/bad.py:" in line
    assert line.endswith(said)


@pytest.mark.parametrize(
    ("where", "code", "ending"),
    [
        ("bind", "raise KeyboardInterrupt", 130),
        ("evaluate", "os.kill(os.getpid(), signal.SIGINT)", 130),
        ("evaluate", "os.kill(os.getpid(), signal.SIGTERM)", 143),
    ],
)
def test_ctrl_c_and_sigterm_end_in_one_line(
    tmp_path: Path, where: str, code: str, ending: int
) -> None:
    path, own = given(tmp_path, **{where: code})
    before = signal.getsignal(signal.SIGTERM)
    result = typed("compare", path, "--plugins", own, "--out", tmp_path / "out")
    assert result.exit_code == ending
    assert result.stderr.splitlines() == [{130: "interrupted", 143: "terminated"}[ending]]
    assert not (tmp_path / "out").exists()
    assert signal.getsignal(signal.SIGTERM) is before


def test_what_ctrl_c_makes_of_an_import_is_an_interruption(monkeypatch: pytest.MonkeyPatch) -> None:
    def cut_short(*_: Any) -> Any:
        raise ImportError("cannot load module more than once") from KeyboardInterrupt()

    monkeypatch.setattr(Catalog, "__init__", cut_short)
    result = typed("list")
    assert result.exit_code == 130
    assert result.stderr.splitlines() == ["interrupted"]


def test_a_user_who_ends_python_where_nobody_looks_is_told_of(tmp_path: Path) -> None:
    """A grasp, which no trial goes before; the command ended with 0 and without a word."""
    (tmp_path / "own" / "grasps").mkdir(parents=True)
    (tmp_path / "own" / "grasps" / "bad.py").write_text(
        'import sys\nfrom coopqp import Grasp, spec\n\n@spec\nclass Bad(Grasp):\n    """Exits."""\n'
        "    def passive_joints(self, R):\n        sys.exit(0)\n",
        encoding="utf-8",
    )
    path = tmp_path / "s.yaml"
    path.write_text(SHORT.replace("grasp: rigid", "grasp: bad"), encoding="utf-8")
    assert "grasp: bad" in path.read_text(encoding="utf-8")
    said = refused("validate", path, "--plugins", tmp_path / "own")
    assert said.strip().endswith("bad.py:8: raises SystemExit: 0")


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ({"rows": "return ('z', 'z')"}, "rows(): the name 'z' is taken"),
        ({"parts": "return [Part('', 1, 'm', 0.0)]"}, "found a tolerance of 0.0, needs more"),
        ({"parts": "return [Part('', 1, 'm', float('nan'))]"}, "found a tolerance of nan, needs"),
        (
            {"rows": "return ('y', 'z')", "parts": "return 2 * [Part('a', 1, 'm', 0.1)]"},
            "parts(): the name 'a' is taken",
        ),
    ],
)
def test_rows_and_parts_that_cannot_be_told_apart_or_met_are_refused(
    tmp_path: Path, code: dict[str, str], said: str
) -> None:
    path, own = given(tmp_path, **code)
    told = refused("validate", path, "--plugins", own)
    assert f"bad.py: {said}" in told.replace("bad.py: parts(): found", "bad.py: found")


@pytest.mark.parametrize("marks", ["return 5", "return (5,)"])
def test_marks_that_are_none_are_refused(tmp_path: Path, marks: str) -> None:
    path, own = given(tmp_path, marks=marks)
    assert "bad.py: marks() gives " in refused("validate", path, "--plugins", own)


@pytest.mark.parametrize("marks", ["return 5", "sys.exit(1)"])
def test_a_page_goes_on_without_marks_that_fail_late(tmp_path: Path, marks: str) -> None:
    path, own = given(tmp_path, marks=f"if asked[0] > 20:\n            {marks}")
    out = tmp_path / "out"
    result = typed("compare", path, "--plugins", own, "--controllers", "qp", "--out", out)
    assert result.exit_code == 0, result.stderr
    assert "bad.marks: " in (out / "report.html").read_text(encoding="utf-8")
    assert (out / "trace.csv").exists()


class MuteError(Exception):
    """Cannot say what it is."""

    def __str__(self) -> str:
        raise SystemExit


def test_an_error_that_cannot_say_what_it_is_has_a_line_all_the_same() -> None:
    assert raised(MuteError(), "own.py") == "own.py: raises MuteError"
    said = raised(ValueError("a\nb\x1b[31m"), "own.py")
    assert said == "own.py: raises ValueError: a b\\x1b[31m"
    assert len(raised(ValueError("x" * 10**6))) < 1000
