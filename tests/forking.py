"""Processes that have all that this one has imported, which takes a fresh one seconds."""

from __future__ import annotations

import os
import signal
import sys
import textwrap
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, TextIO

PATIENCE = 60.0
"""After which a program is killed [s]."""


def forked(work: Callable[[], object]) -> int:
    """The number of a process that does some work."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forks beside threads
        child = os.fork()
    if child == 0:
        try:
            work()
        finally:
            os._exit(0)
    return child


@dataclass(frozen=True)
class Program:
    """A program that runs.

    Attributes:
        pid: its number.
        out: what it prints; what it does not catch too.
    """

    pid: int
    out: TextIO

    def ended(self) -> int:
        """Its exit code, or the number of the signal that killed it with a minus, once it ends."""
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])


@contextmanager
def program(code: str, *arguments: object) -> Iterator[Program]:
    """Run a program in a process of its own, for as long as the block lasts at most.

    Args:
        code: of the program, indented or not.
        arguments: what it finds in ``sys.argv`` from place 1.
    """
    read, write = os.pipe()

    def work() -> None:
        os.close(read)
        sys.argv = ["program", *map(str, arguments)]
        code_of_exit: Any = 0
        with os.fdopen(write, "w", encoding="utf-8") as stream:
            sys.stdout = sys.stderr = stream
            try:
                exec(compile(textwrap.dedent(code), "program", "exec"), {"__name__": "__main__"})
            except SystemExit as end:
                code_of_exit = end.code or 0
            except BaseException:  # noqa: BLE001 - as Python tells of it
                code_of_exit = 1
                traceback.print_exc()
        os._exit(code_of_exit)

    pid = forked(work)
    os.close(write)
    late = threading.Timer(PATIENCE, _kill, (pid,))
    late.start()
    try:
        with os.fdopen(read, encoding="utf-8") as out:
            yield Program(pid, out)
    finally:
        late.cancel()
        with suppress(ChildProcessError):
            if os.waitpid(pid, os.WNOHANG) == (0, 0):
                _kill(pid)
                os.waitpid(pid, 0)


def _kill(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
