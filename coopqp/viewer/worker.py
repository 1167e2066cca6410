"""A process beside the control loop: it gets the newest message and never delays the loop.

The worker says by None when it is ready, and only then one message is sent, so that outdated ones
are never sent at all. What it sends back is read without waiting.
"""

import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from typing import Any

PATIENCE = 2.0  # for the process to end by itself [s]


class Peer:
    """The connection to the control loop, in the worker."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def send(self, message: Any) -> None:
        """Send to the control loop, which takes all messages in order until it ends."""
        with suppress(OSError):
            self._connection.send(message)

    def messages(self) -> Iterator[Any]:
        """Messages until the loop ends, each the newest at the time it is asked for."""
        with suppress(EOFError, OSError):
            while True:
                self._connection.send(None)
                yield self._connection.recv()


class Worker:
    """A process that calls a module's function with a :class:`Peer` and picklable arguments."""

    def __init__(self, work: Callable[..., None], *arguments: Any) -> None:
        context = multiprocessing.get_context("spawn")  # no threads are copied half alive
        resource_tracker.ensure_running()  # which would take the mask below away as it starts
        self._connection, theirs = context.Pipe()
        # Ctrl-C is for the control loop, which then ends the others.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            start: Any = {"target": _run, "args": (work, theirs, *arguments), "daemon": True}
            self._process = context.Process(**start)
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        self.ready = False

    def send(self, message: Any) -> bool:
        """Send a message if the worker is ready; whether it was."""
        if not self.ready:
            return False
        try:
            self._connection.send(message)
        except OSError:
            return False
        self.ready = False
        return True

    def received(self, timeout: float = 0.0) -> Iterator[Any]:
        """Messages; waits for the first so long [s]. EOFError: the worker has ended."""
        try:
            while self._connection.poll(timeout):
                message = self._connection.recv()
                timeout = 0.0
                if message is None:
                    self.ready = True
                else:
                    yield message
        except OSError as error:
            raise EOFError from error

    @property
    def killed_by(self) -> str:
        """The signal that has ended it from outside, such as SIGKILL; empty where none has."""
        self._process.join(PATIENCE)
        code = self._process.exitcode or 0
        return signal.Signals(-code).name if code < 0 else ""

    def end(self) -> None:
        self._connection.close()
        self._process.join(PATIENCE)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _run(work: Callable[..., None], connection: Connection, *arguments: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # some libraries take the mask away
    sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - servers print; the terminal is the loop's
    work(Peer(connection), *arguments)
    sys.stderr.flush()
    os._exit(0)  # threads of a server may linger
