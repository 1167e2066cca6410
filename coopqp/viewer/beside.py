"""A process beside the control loop: it gets the newest of what there is, and never holds it up.

The other side says when it is ready for something, and only then one thing is sent, so that what
is old by then was never sent at all. What it sends back is read without waiting.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from typing import Any

#: Time for the process to end by itself [s].
PATIENCE = 2.0


class _Ready:
    """What a process sends that would have more."""


class Line:
    """The other end, in the process beside."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def send(self, thing: Any) -> None:
        """Let the control loop have something; it takes all, in order, until it ends."""
        with suppress(OSError):
            self._connection.send(thing)

    def things(self) -> Iterator[Any]:
        """One thing after the other, each the newest by when it is asked for; until the end."""
        try:
            while True:
                self._connection.send(_Ready())
                yield self._connection.recv()
        except (EOFError, OSError):
            return


class Beside:
    """A process beside the control loop.

    Args:
        work: a function of a module, called with a :class:`Line` and the arguments.
        arguments: that can be pickled.
    """

    def __init__(self, work: Callable[..., None], *arguments: Any) -> None:
        context = multiprocessing.get_context("spawn")  # no threads are copied half alive
        resource_tracker.ensure_running()  # which would take the mask below away as it starts
        self._connection, theirs = context.Pipe()
        # Ctrl-C is for the control loop, which then ends the others.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self._process = context.Process(
                target=_run, args=(work, theirs, *arguments), daemon=True
            )
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        self.ready = False

    def send(self, thing: Any) -> bool:
        """Send something if it is waited for; whether it was."""
        if not self.ready:
            return False
        try:
            self._connection.send(thing)
        except OSError:
            return False
        self.ready = False
        return True

    def received(self, timeout: float = 0.0) -> Iterator[Any]:
        """What has come from it; waits for the first as long as told [s].

        Raises:
            EOFError: it has ended.
        """
        try:
            while self._connection.poll(timeout):
                thing = self._connection.recv()
                timeout = 0.0
                if isinstance(thing, _Ready):
                    self.ready = True
                else:
                    yield thing
        except OSError as error:
            raise EOFError from error

    @property
    def killed_by(self) -> str:
        """The signal that has ended it from outside, such as SIGKILL; empty where none has."""
        self._process.join(PATIENCE)
        code = self._process.exitcode or 0
        return signal.Signals(-code).name if code < 0 else ""

    def end(self) -> None:
        """End it."""
        self._connection.close()
        self._process.join(PATIENCE)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _run(work: Callable[..., None], connection: Connection, *arguments: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # some libraries take the mask away
    sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - servers print; the terminal is the loop's
    work(Line(connection), *arguments)
    sys.stderr.flush()
    os._exit(0)  # threads of a server may linger
