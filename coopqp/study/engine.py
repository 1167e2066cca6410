"""What runs many rollouts: the results of all items, whatever becomes of the workers.

Items go to workers, processes of this machine or of a Dask cluster, in joblib's batches.

A worker that dies takes down what all of them have under way. New ones then do those items in
halves, so that the one that ends its worker is known; what ends its worker although it is alone is
tried once more, and is then lost.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import gc
import logging
import os
import re
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from functools import cache, partial
from multiprocessing import resource_tracker
from operator import length_hint
from typing import Any, TypeVar

from coopqp.base.errors import CoopqpError, InvalidValueError, needs

Item = TypeVar("Item")

TRIES = 2  # of an item that is done alone
MOST_SHARES = 100_000  # commands that may share a job; job arrays of clusters have fewer
LOOKS = 1.0  # s between two looks of a process whether its parent still lives
SIGNALS = (signal.SIGINT, signal.SIGTERM)
PATIENCE = 15.0  # s within which a scheduler must answer, and have a worker

Work = Callable[[Any], Any]
"""What comes of an item: a function of a module, so that other processes find it."""

Numbered = Iterator[tuple[int, Any]]
"""Items by number, or what came of them."""

Workers = Callable[[Work, Numbered], Numbered]
"""Who does items: gives what came of them, in the order in which they are done.

Where a worker dies, WorkersLostError; whoever asks again gets new ones.
"""


class WorkersLostError(CoopqpError):
    """A worker died, and with it all that was under way; its words say how."""


@dataclass(frozen=True)
class Share:
    """Every so manyeth item, from the first, second ... on, where several commands share them."""

    number: int = 1
    of: int = 1

    @classmethod
    def read(cls, text: str) -> Share:
        """From what is written, such as "2/8"."""
        found = re.fullmatch(r"\s*(\d{1,6})\s*/\s*(\d{1,6})\s*", text)
        number, of = (int(part) for part in found.groups()) if found else (0, 0)
        if not 1 <= number <= of <= MOST_SHARES:
            raise InvalidValueError(f"--shard: found '{text}', needs I/N such as 2/8, I of 1 to N")
        return cls(number, of)

    @property
    def whole(self) -> bool:
        """Whether it is all there is."""
        return self.of == 1

    def taken(self, items: Sequence[Item]) -> Sequence[Item]:
        """The items of this share."""
        return items[self.number - 1 :: self.of]


@dataclass(frozen=True)
class Lost:
    """What there is instead of a result: how the worker ended, whenever it did this item."""

    reason: str


@dataclass(frozen=True)
class Engine:
    """Where work is done."""

    # processes on this machine, all cores when 0; with 1 the work is done in this process, which
    # then ends where an item ends its process
    jobs: int = 0
    scheduler: str = ""  # address of a Dask scheduler, whose workers then do the work
    share: Share = field(default_factory=Share)  # what of a job its owner is to ask for here

    def results(
        self, work: Work, items: Iterable[Item], count: int | None = None
    ) -> Iterator[tuple[Item, Any]]:
        """Items with their results, or Lost, as they are done; so many, where they have no length.

        What the work raises comes out here, and ends all; so does that no scheduler answers.
        """
        if self.scheduler:
            with _connected(self.scheduler) as client:
                cluster = partial(_by_cluster, self.scheduler, client)
                yield from _results(cluster, work, items)
            return
        jobs = min(self.jobs or cores(), length_hint(items) if count is None else count)
        yield from _results(partial(_by_processes, jobs) if jobs > 1 else _here, work, items)


def _results(workers: Workers, work: Work, items: Iterable[Item]) -> Iterator[tuple[Item, Any]]:
    left, under_way = enumerate(items), dict[int, Item]()

    def handed_out() -> Numbered:
        for number, item in left:
            under_way[number] = item
            yield number, item

    while True:
        try:
            for number, result in workers(work, handed_out()):
                yield under_way.pop(number), result
            if not under_way:
                return
        except WorkersLostError:
            pass
        lost = [under_way.pop(number) for number in list(under_way)]
        half = (len(lost) + 1) // 2
        for part in filter(None, (lost[:half], lost[half:])):
            if len(part) > 1:
                yield from _results(workers, work, part)
            else:
                yield part[0], _alone(workers, work, part[0])


def _alone(workers: Workers, work: Work, item: Any) -> Any:
    """The result of an item that was lost, with nothing beside it."""
    why = ""
    for _ in range(TRIES):
        try:
            ((_, result),) = workers(work, iter([(0, item)]))
        except WorkersLostError as error:
            why = str(error)
        else:
            return result
    return Lost(why)


def _here(work: Work, items: Numbered) -> Numbered:
    """No worker but this process, as a debugger wants it; an item that ends it ends all."""
    return ((number, work(item)) for number, item in items)


def _by_joblib(work: Work, items: Numbered, **settings: Any) -> Any:
    """Have joblib's workers do items: a generator of outcomes, which can be closed."""
    from joblib import Parallel, delayed

    parallel = Parallel(return_as="generator_unordered", **settings)
    return parallel(delayed(_numbered)(work, *item) for item in items)


def _numbered(work: Work, number: int, item: Any) -> tuple[int, Any]:
    return number, work(item)


def _for_good(item: Any, *, work: Work) -> Any:
    """Do an item. What there is after a process's first, most of it imported, is there for good.

    No more cycles are looked for in it, which would take some 60 ms each time: where psutil is not
    installed loky has them looked for every second, and Python does when the worker ends.
    """
    result = work(item)
    _freeze()
    return result


_freeze = cache(gc.freeze)  # once


def _by_processes(count: int, work: Work, items: Numbered) -> Numbered:
    """Processes that are started, or go on from the last call.

    There are at least 2, because joblib does the work of one in this process.
    """
    from joblib import parallel_config
    from joblib.externals.loky.process_executor import BrokenProcessPool

    settings = {"initializer": _leave_with, "initargs": (os.getpid(),)}
    try:
        with _quiet(), ExitStack() as opened:
            with _unsignalled(), parallel_config("loky", inner_max_num_threads=1, **settings):
                started = _by_joblib(partial(_for_good, work=work), items, n_jobs=count)
                outcomes = opened.enter_context(closing(started))
            yield from outcomes
    except BrokenProcessPool as error:
        codes = re.search(r"exit codes? of the workers? (?:are|is) \{(.*)\}", str(error))
        how = f": {codes.group(1)}" if codes else ""  # such as SIGKILL(-9)
        raise WorkersLostError(f"its process ended{how}") from None


def cores() -> int:
    """How many processes this machine, or what a cluster gives of it, has cores for."""
    from joblib import cpu_count

    return int(cpu_count())


@contextmanager
def _unsignalled() -> Iterator[None]:
    """What is started here never gets Ctrl-C and SIGTERM; here they come right after."""
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
    """Without what joblib and loky say about work that is given up, or done by a process anew."""
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


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    """A client of a scheduler that has to answer, and to have workers, within some seconds."""
    with needs("--scheduler", "dask"):
        from distributed import Client
    # Dask's own lines about what comes and goes are not to stand between ours.
    for name in list(logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    client = Client.__new__(Client)
    try:
        client.__init__(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        client.status = "closed"  # else its __del__ waits for the scheduler to take its leave
        words = f"no Dask scheduler answers at '{address}' within {PATIENCE:g} s"
        raise CoopqpError(f"{words}; start one: dask scheduler") from error
    try:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            words = f"the Dask scheduler at '{address}' has no workers"
            raise CoopqpError(f"{words}; start some: dask worker {address}") from None
        yield client
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            client.close(timeout=PATIENCE)


def _by_cluster(address: str, client: Any, work: Work, items: Numbered) -> Numbered:
    """Dask itself does again what a worker had under way that went, up to three times."""
    from distributed import KilledWorker

    try:
        backend = _answering()(client=client, wait_for_workers_timeout=PATIENCE)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module=r"(joblib|distributed)\.")
            with closing(_by_joblib(work, items, n_jobs=-1, backend=backend)) as outcomes:
                yield from outcomes
    except KilledWorker as error:
        raise WorkersLostError(f"ended {error.allowed_failures + 1} Dask workers") from None
    except (OSError, asyncio.CancelledError, concurrent.futures.CancelledError) as error:
        what = "has had no worker" if isinstance(error, TimeoutError) else "is gone"
        words = "what was done is kept, and the same command goes on from there"
        raise CoopqpError(f"the Dask scheduler at '{address}' {what}; {words}") from None


def _answering() -> Any:
    """Joblib's back-end, with an answer where Dask gives a task up: joblib 1.6 waits for ever."""
    from joblib._dask import DaskDistributedBackend

    class Answering(DaskDistributedBackend):  # type: ignore[misc]
        def effective_n_jobs(self, n_jobs: int) -> int:
            # With one, joblib would do the work in this process, whatever it is.
            return max(2, int(super().effective_n_jobs(n_jobs)))

        async def _collect(self) -> None:
            while self._continue:
                async for future, result in self.waiting_futures:
                    asked, answer = self._results.pop(future), self._callbacks.pop(future)
                    if future.status == "error":
                        result = result[1]  # of type, error and traceback
                        asked.set_exception(result)
                    else:
                        asked.set_result(result)
                    answer(result)
                await asyncio.sleep(0.01)

        def retrieve_result_callback(self, out: Any) -> Any:
            if isinstance(out, BaseException):
                raise out
            return super().retrieve_result_callback(out)

    return Answering
