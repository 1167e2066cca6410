"""Processes of this machine: loky's, which joblib starts, keeps and starts again.

They leave Ctrl-C and SIGTERM to the process that started them, and end when that is gone.
"""

from __future__ import annotations

import gc
import os
import re
import signal
import threading
import time
import warnings
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker

from coopqp.study.engine.batches import Batch, Outcome, Work, WorkersLostError, by_joblib, done

LOOKS = 1.0  # s between two looks whether the parent still lives
SIGNALS = (signal.SIGINT, signal.SIGTERM)


@dataclass(frozen=True)
class Processes:
    """So many, at least 2, because joblib does the work of one in this process."""

    count: int

    def outcomes(self, work: Work, batches: Iterable[Batch]) -> Iterator[Outcome]:
        """Those of processes that are started, or go on from the last call."""
        from joblib import parallel_config
        from joblib.externals.loky.process_executor import BrokenProcessPool

        settings = {"initializer": _leave_with, "initargs": (os.getpid(),)}
        try:
            with _quiet(), ExitStack() as opened:
                with _unsignalled(), parallel_config("loky", inner_max_num_threads=1, **settings):
                    started = by_joblib(_done, work, batches, self.count, n_jobs=self.count)
                    outcomes = opened.enter_context(closing(started))
                yield from outcomes
        except BrokenProcessPool as error:
            raise WorkersLostError(_said(error)) from None


def cores() -> int:
    """How many processes this machine, or what a cluster gives of it, has cores for."""
    from joblib import cpu_count

    return int(cpu_count())


@contextmanager
def _unsignalled() -> Iterator[None]:
    """What is started here inherits that Ctrl-C and SIGTERM do not reach it.

    Neither do they come here while something is half started, but right after.
    """
    resource_tracker.ensure_running()  # which would let both through again when it starts
    came: list[int] = []
    ours = threading.current_thread() is threading.main_thread()
    # Not enough for this process is the mask: threads of libraries take signals for it.
    known = {s: signal.signal(s, lambda s, _: came.append(s)) for s in SIGNALS} if ours else {}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        for kind, handler in known.items():
            signal.signal(kind, handler)
        for number in came[:1]:
            signal.raise_signal(number)


@contextmanager
def _quiet() -> Iterator[None]:
    """Without joblib's warnings about work that is given up, or done by a process anew.

    Nor with what a thread of loky says that hands out work while it is being given up.
    """
    told = threading.excepthook

    def tell(args: threading.ExceptHookArgs) -> None:
        if not (args.exc_type is KeyError and "ExecutorManagerThread" in str(args.thread)):
            told(args)

    threading.excepthook = tell
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module=r"joblib\.")
            yield
    finally:
        threading.excepthook = told


def _leave_with(parent: int) -> None:
    """End this process soon after its parent, which may be killed without a word."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(LOOKS)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _done(work: Work, batch: Batch) -> Outcome:
    """Do a batch. What there is after a worker's first, most of it imported, is there for good.

    No more cycles are looked for in it, which would take some 60 ms each time: where psutil is not
    installed loky has them looked for every second, and Python does when the worker ends.
    """
    outcome = done(work, batch)
    if not gc.get_freeze_count():
        gc.freeze()
    return outcome


def _said(error: BaseException) -> str:
    """How a process ended, such as SIGKILL(-9)."""
    codes = re.search(r"exit codes? of the workers? (?:are|is) \{(.*)\}", str(error))
    return f"its process ended: {codes.group(1)}" if codes else "its process ended"
