"""Processes that run cases, bounded in time and memory."""

from __future__ import annotations

import multiprocessing as mp
import resource
import tempfile
from multiprocessing.connection import Connection
from pathlib import Path

from .cases import Outcome, catalog, run_case

SECONDS = 10.0  # of a case
MEMORY = 1 << 30  # bytes of a case


def _work(pipe: Connection) -> None:
    """Run the cases whose seeds come through the pipe."""
    catalog()
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    with tempfile.TemporaryDirectory() as folder:
        pipe.send("ready")
        while (seed := pipe.recv()) is not None:
            pipe.send(run_case(seed, Path(folder)))


class Worker:
    """A process that runs cases, and is begun anew where one of them has taken it along."""

    def __init__(self) -> None:
        self._begin()

    def _begin(self) -> None:
        self.pipe, theirs = mp.Pipe()
        self.process = mp.get_context("spawn").Process(target=_work, args=(theirs,), daemon=True)
        self.process.start()
        self._ready = False

    def run(self, seed: int) -> Outcome:
        """Run the case of a seed."""
        if not self._ready:
            self.pipe.recv()
            self._ready = True
        self.pipe.send(seed)
        if not self.pipe.poll(SECONDS):
            return self._again(seed, f"takes more than {SECONDS:g} s")
        try:
            found: Outcome = self.pipe.recv()
        except (EOFError, ConnectionResetError):
            return self._again(seed, "the process died")
        return found

    def end(self) -> None:
        """Let the process go."""
        self.pipe.send(None)
        self.process.join()

    def _again(self, seed: int, words: str) -> Outcome:
        self.process.kill()
        self.process.join()
        self._begin()
        return Outcome("", seed, words)
