"""Work that is done item by item on all cores."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
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
    with multiprocessing.Pool(jobs, _leave_interrupts) as pool:
        yield from pool.imap_unordered(work, items, chunksize=8)


def _leave_interrupts() -> None:
    """Ctrl-C is the parent's to hear, who then ends the workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
