"""A folder in which pages run: what readers of a checkout have, and what pages call theirs."""

from __future__ import annotations

import contextlib
import io
import os
import shlex
import signal
import subprocess
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from command_line import typed
from numpy.typing import ArrayLike

from coopqp import Scenario
from coopqp.base.spec import Array

from .blocks import ROOT, Block, blocks
from .outputs import check_output

#: Entries of a checkout that are not the reader's.
HIDDEN = {"out", ".git", ".venv"}


@contextlib.contextmanager
def stage(folder: Path) -> Iterator[Path]:
    """Work in an empty folder: a checkout, and a scenario and plug-ins that pages call mine."""
    for path in ROOT.iterdir():
        if path.name not in HIDDEN:
            (folder / path.name).symlink_to(path)
    (folder / "my_plugins").symlink_to(ROOT / "examples" / "plugins")
    readme = blocks("README.md", (ROOT / "README.md").read_text(encoding="utf-8"))
    scenario = next(block.code for block in readme if block.language == "yaml")
    (folder / "my.yaml").write_text(scenario, encoding="utf-8")
    (folder / ".venv").mkdir()
    (folder / ".venv" / "bin").symlink_to(Path(sys.executable).parent)
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield folder
    finally:
        os.chdir(before)


class Page:
    """The blocks of a page, run one after the other in one namespace.

    Args:
        name: of the page.
        whole: whether everything that runs at all is run, and commands in a shell, as people type
            them. Else what is not in the suite is passed over, and commands are run only if the
            page shows what they print; those of coopqp in this process, which takes less time.
    """

    def __init__(self, name: str, *, whole: bool) -> None:
        self._module = types.ModuleType(f"page_{abs(hash(name))}")
        sys.modules[self._module.__name__] = self._module  # where types of fields are looked up
        self._whole = whole

    def run(self, block: Block, shown: Block | None) -> None:
        """Do what a block says, and see whether it prints what the page shows.

        Args:
            block: the next one.
            shown: its output on the page, if that has it.

        Raises:
            AssertionError: it prints something else.
            Exception: what its code raises.
        """
        if block.lacks or not (block.runs if self._whole else block.at_once):
            return
        if block.language == "text":
            check_output(block, self._commands(block.marks["printed by"]))
            return
        printed = self._printed(block, is_shown=shown is not None)
        if shown and (self._whole or shown.at_once):
            check_output(shown, printed)

    def _printed(self, block: Block, *, is_shown: bool) -> str:
        """What a block prints; nothing if it is not run."""
        if "file" in block.marks:
            path = Path(block.marks["file"])
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.code, encoding="utf-8")
        elif block.language == "python":
            self._exec(block.marks.get("run first", ""), f"before {block.place}")
            with contextlib.redirect_stdout(io.StringIO()) as told:
                self._exec(block.code, block.place)
            return told.getvalue()
        elif block.language == "sh" and (self._whole or is_shown):
            return self._commands(block.code)
        return ""

    def _commands(self, code: str) -> str:
        if self._whole:
            return _shell(code)
        return "".join(map(_typed, code.replace("\\\n", " ").splitlines()))

    def _exec(self, code: str, place: str) -> None:
        exec(compile(code, place, "exec", dont_inherit=True), vars(self._module))


def _typed(line: str) -> str:
    """What a line of a shell prints, without a process if it is a command of coopqp alone."""
    words = shlex.split(line, comments=True)
    if words[:1] != ["coopqp"] or set(line) & set("|&;<>$"):
        return _shell(line)
    result = typed(*words[1:])
    assert result.exit_code == 0, f"{line}: {result.output}"
    return result.output


def _shell(code: str) -> str:
    """What commands print, in bash."""
    programs = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    given = {**os.environ, "PATH": programs, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        ["bash", "-e", "-c", code], env=given, check=True, text=True, errors="replace",
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    ).stdout  # fmt: skip


class Robot:
    """A robot that does as told, until somebody presses Ctrl-C.

    Args:
        scenario: in whose start it stands.
        ticks: after how many that is.
    """

    def __init__(self, scenario: Scenario, ticks: int = 5) -> None:
        self._q: Array = scenario.chain.q_start.copy()
        self._left = ticks

    def read(self) -> ArrayLike:
        """Where the joints are."""
        self._left -= 1
        if self._left == 0:
            signal.raise_signal(signal.SIGINT)
        return self._q.copy()

    def write(self, q: Array, v: Any) -> None:
        """Be there."""
        self._q[:] = q
