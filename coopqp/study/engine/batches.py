"""Items in batches that take about a second each, and what does a batch.

A batch costs the engine some milliseconds, on a cluster some more, so single items of a few
milliseconds would be mostly overhead; and much longer ones would be much to do again where a worker
is lost. How long an item takes is measured where it is done, and the next batches follow that.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
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
