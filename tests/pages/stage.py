"""A folder in which pages run: what readers of a checkout have, and what pages call theirs."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from coopqp import Scenario
from coopqp.checked import Array

from .blocks import ROOT, Block, blocks

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
    """

    def __init__(self, name: str) -> None:
        self._module = types.ModuleType(f"page_{abs(hash(name))}")
        sys.modules[self._module.__name__] = self._module  # where types of fields are looked up

    def run(self, block: Block, *, shell: bool) -> None:
        """Do what a block says.

        Args:
            block: that runs.
            shell: whether commands are run, too.

        Raises:
            Exception: what its code raises.
        """
        if "file" in block.marks:
            path = Path(block.marks["file"])
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.code, encoding="utf-8")
        elif block.language == "python":
            self._exec(block.marks.get("run first", ""), f"before {block.place}")
            self._exec(block.code, block.place)
        elif block.language == "sh" and shell:
            programs = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
            given = {**os.environ, "PATH": programs, "PYTHONPATH": str(ROOT)}
            subprocess.run(["bash", "-e", "-c", block.code], env=given, check=True)

    def _exec(self, code: str, place: str) -> None:
        exec(compile(code, place, "exec", dont_inherit=True), vars(self._module))


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
