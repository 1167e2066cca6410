"""Items in batches that take about a second each, and the processes of this machine that do them.

A batch costs the engine some milliseconds, on a cluster some more, so single items of a few
milliseconds would be mostly overhead; and much longer ones would be much to do again where a worker
is lost. How long an item takes is measured where it is done, and the next batches follow that.

Processes are loky's, which joblib starts, keeps and starts again. They leave Ctrl-C and SIGTERM to
the process that started them, and end when that is gone.
"""

from __future__ import annotations

import gc
import os
import re
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from typing import Any, NamedTuple, Protocol

from coopqp.base.errors import CoopqpError

SECONDS = 1.0  # that a batch shall take
MOST = 500  # items in a batch
GROWTH = 4.0  # a batch has at most so many times as many items as the largest that came back
LAST = 2  # what is left is dealt out so that each worker gets so many batches of it
FOLLOWED = 0.5  # share of the newest batch in the time an item takes
AHEAD = 2  # batches that are handed out before they are asked for, a worker

Work = Callable[[Sequence[Any]], Sequence[Any]]
"""A function of a module, so that other processes find it: the results of some items, in order."""


class Items(Protocol):
    """What batches are made of; may make each when it is asked for."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> Any: ...


class Batch(NamedTuple):
    """Items that are done one after the other by one worker; its number is that of the first."""

    number: int
    items: tuple[Any, ...]


class Outcome(NamedTuple):
    """A batch that is done: the results of its items, in order, and the time that they took."""

    number: int
    results: Sequence[Any]
    seconds: float


class WorkersLostError(CoopqpError):
    """A worker died, and with it all that was under way; its words say how."""


class Workers(Protocol):
    """Who does batches, ``count`` at a time."""

    @property
    def count(self) -> int: ...

    def outcomes(self, work: Work, batches: Iterable[Batch]) -> Iterator[Outcome]:
        """What came of the batches, in the order in which they are done.

        Raises:
            WorkersLostError: one of the workers died; whoever asks again gets new ones.
        """


def done(work: Work, batch: Batch) -> Outcome:
    """Do a batch."""
    begun = time.perf_counter()
    results = work(batch.items)
    return Outcome(batch.number, results, time.perf_counter() - begun)


def by_joblib(
    do: Callable[[Work, Batch], Outcome],
    work: Work,
    batches: Iterable[Batch],
    count: int,
    **settings: Any,
) -> Any:
    """Have joblib's workers do batches: a generator of outcomes, which can be closed."""
    from joblib import Parallel, delayed

    settings |= {"return_as": "generator_unordered", "batch_size": 1, "pre_dispatch": AHEAD * count}
    return Parallel(**settings)(delayed(do)(work, batch) for batch in batches)


class Batches:
    """An iterator of batches, which several threads may ask, and what became of them."""

    def __init__(self, items: Items, workers: int) -> None:
        self._items, self._workers = items, workers
        self._next, self._largest, self._time = 0, 0, 0.0
        self._under_way: dict[int, Batch] = {}
        self._lock = threading.Lock()

    def __iter__(self) -> Iterator[Batch]:
        return self

    def __next__(self) -> Batch:
        with self._lock:
            first = self._next
            self._next = min(first + self._size(), len(self._items))
            if first == self._next:
                raise StopIteration
            items = tuple(self._items[k] for k in range(first, self._next))
            batch = self._under_way[first] = Batch(first, items)
            return batch

    def _size(self) -> int:
        if not self._largest:
            return 1
        left = len(self._items) - self._next
        dealt = -(-left // (LAST * self._workers))
        wanted = SECONDS / max(self._time, SECONDS / MOST)
        return max(1, min(int(wanted), int(GROWTH * self._largest), dealt, MOST))

    def back(self, number: int, seconds: float) -> Batch:
        """A batch that is done, in so much time."""
        with self._lock:
            batch = self._under_way.pop(number)
            each = seconds / len(batch.items)
            self._time += (FOLLOWED if self._largest else 1.0) * (each - self._time)
            self._largest = max(self._largest, len(batch.items))
            return batch

    def lost(self) -> list[Batch]:
        """Those that were under way when the workers were lost; nobody waits for them any more."""
        with self._lock:
            lost = list(self._under_way.values())
            self._under_way.clear()
            return lost


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
