"""Code of users that exits, raises anything, writes to what is not its own, or shows no marks."""

from __future__ import annotations

import signal
from pathlib import Path

import numpy as np
import pytest
from command_line import typed
from laws import problem
from scenario_files import GOOD

from coopqp.base.spec import spec
from coopqp.base.wording import raised
from coopqp.controllers import QPController
from coopqp.limit import Limit, LimitRows, Tighten
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.solver import Status
from coopqp.task import Evaluate, Task, TaskRows

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
    result = typed("validate", path, "--plugins", own)
    assert result.exit_code == 2
    (line,) = result.stderr.strip().splitlines()
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
    result = typed("validate", path, "--plugins", tmp_path / "own")
    assert result.exit_code == 2
    assert result.stderr.strip().endswith("bad.py:8: raises SystemExit: 0")


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
    result = typed("validate", path, "--plugins", own)
    assert result.exit_code == 2
    assert f"bad.py: {said}" in result.stderr.replace("bad.py: parts(): found", "bad.py: found")


@pytest.mark.parametrize("marks", ["return 5", "return (5,)"])
def test_marks_that_are_none_are_refused(tmp_path: Path, marks: str) -> None:
    path, own = given(tmp_path, marks=marks)
    result = typed("validate", path, "--plugins", own)
    assert result.exit_code == 2
    assert "bad.py: marks() gives " in result.stderr


@pytest.mark.parametrize("marks", ["return 5", "sys.exit(1)"])
def test_a_page_goes_on_without_marks_that_fail_late(tmp_path: Path, marks: str) -> None:
    path, own = given(tmp_path, marks=f"if asked[0] > 20:\n            {marks}")
    out = tmp_path / "out"
    result = typed("compare", path, "--plugins", own, "--controllers", "qp", "--out", out)
    assert result.exit_code == 0, result.stderr
    assert "bad.marks: " in (out / "report.html").read_text(encoding="utf-8")
    assert (out / "trace.csv").exists()


@spec
class Meddling(Task):
    """Writes to the state and to the chain."""

    writes: str

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """One row."""
        return ("z",)

    def bind(self, start: State) -> Evaluate:
        """Nothing to keep."""

        def evaluate(state: State, rows: TaskRows) -> None:
            rows.e[0], rows.J[0] = state.p_WO[2] - 0.05, state.J_task[2]
            if state.t <= 0.02:
                return
            if self.writes == "another":
                state.q = np.zeros(1)
            elif self.writes == "flags":
                state.q.flags.writeable = False
            else:
                {"q": state.q, "v": state.v, "lower": state.chain.lower}[self.writes][:] = 5.0
            if self.writes == "exit":
                raise SystemExit

        return evaluate


@spec
class MeddlingLimit(Limit):
    """Writes to the state."""

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        """Nothing is tightened."""

        def tighten(state: State, rows: LimitRows) -> None:
            state.q[0] = 5.0

        return tighten


@pytest.mark.parametrize("writes", ["q", "v", "lower"])
def test_what_writes_to_the_librarys_state_is_named_and_the_arms_stand(
    chain: ClosedChain, writes: str
) -> None:
    law = QPController().build(problem(chain, Meddling(name="mine", writes=writes)))
    state = law.start()
    lower = chain.lower.copy()
    for k in range(6):
        q, v = state.q.copy(), state.v.copy()
        command = law.tick(state)
        np.testing.assert_array_equal(state.q, q)
        np.testing.assert_array_equal(state.v, v)
        if k >= 3:
            assert command.causes == (Status.RAISED,)
            assert command.note.startswith("task 'mine': ")
            assert "test_users_code.py:" in command.note
            assert not command.v.any()
        state.advance(command.v, 0.01)
    np.testing.assert_array_equal(chain.lower, lower)


def test_a_limit_that_writes_to_the_state_is_named(chain: ClosedChain) -> None:
    law = QPController().build(problem(chain, Meddling(writes="q"), limits=(MeddlingLimit(),)))
    command = law.tick(law.start())
    assert command.causes == (Status.RAISED,)
    assert command.note.startswith("limit '")
    assert "test_users_code.py:" in command.note


@pytest.mark.parametrize("writes", ["another", "flags"])
def test_a_state_that_a_task_puts_out_of_order_is_put_right(
    chain: ClosedChain, writes: str
) -> None:
    """Another array in its place, or one that nobody can write to: the state is as it was."""
    law = QPController().build(problem(chain, Meddling(name="mine", writes=writes)))
    state = law.start()
    q = state.q
    for k in range(6):
        command = law.tick(state)
        if writes == "flags" or k < 3:
            assert command.status is Status.OPTIMAL
        else:
            assert command.causes == (Status.RAISED,)
            assert command.note.startswith("task 'mine': ")
            assert "state.q cannot be replaced" in command.note
        state.advance(command.v, 0.01)
    assert state.q is q
    assert q.flags.writeable


class MuteError(Exception):
    """Cannot say what it is."""

    def __str__(self) -> str:
        raise SystemExit


def test_an_error_that_cannot_say_what_it_is_has_a_line_all_the_same() -> None:
    assert raised(MuteError(), "own.py") == "own.py: raises MuteError"
    said = raised(ValueError("a\nb\x1b[31m"), "own.py")
    assert said == "own.py: raises ValueError: a b\\x1b[31m"
    assert len(raised(ValueError("x" * 10**6))) < 1000
