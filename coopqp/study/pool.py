"""Work that is done item by item on all cores."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.pool import Pool
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_parallel(
    work: Callable[[Item], Result], items: Sequence[Item], jobs: int = 0
) -> Iterator[Result]:
    """The results in the order in which they are done.

    Args:
        work: a function of a module, so that other processes find it.
        items: what it gets, one by one.
        jobs: processes; all cores when 0.
    """
    jobs = min(jobs or multiprocessing.cpu_count(), len(items))
    if jobs <= 1:
        yield from map(work, items)
        return
    with _pool(jobs) as pool:
        yield from pool.imap_unordered(work, items, chunksize=8)


def _pool(jobs: int) -> Pool:
    """Workers that leave Ctrl-C and SIGTERM to their parent, who then ends them.

    They inherit that both are blocked; and neither can come while they are only half made.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        return multiprocessing.Pool(jobs, initializer=_endable)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _endable() -> None:
    """Let the parent end this worker without a word."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
