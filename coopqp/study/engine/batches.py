"""Items in batches that take about a second each.

A batch costs the engine some milliseconds, on a cluster some more, so single items of a few
milliseconds would be mostly overhead; and much longer ones would be much to do again where a worker
is lost. How long an item takes is measured where it is done, and the next batches follow that.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

Item = TypeVar("Item")

SECONDS = 1.0  # that a batch shall take
MOST = 500  # items in a batch
GROWTH = 4.0  # a batch has at most so many times as many items as the largest that came back
LAST = 2  # what is left is dealt out so that each worker gets so many batches of it
FOLLOWED = 0.5  # share of the newest batch in the time an item takes


@dataclass(frozen=True)
class Batch(Generic[Item]):
    """Items that are done one after the other by one worker.

    Attributes:
        number: of the batch.
        items: in it.
    """

    number: int
    items: tuple[Item, ...]


class Batches(Generic[Item]):
    """An iterator of batches, which several threads may ask, and what became of them.

    Args:
        items: all of them.
        workers: that they are dealt out to.
    """

    def __init__(self, items: Sequence[Item], workers: int) -> None:
        self._items, self._workers = items, workers
        self._next, self._number, self._largest, self._time = 0, 0, 0, 0.0
        self._under_way: dict[int, Batch[Item]] = {}
        self._lock = threading.Lock()

    def __iter__(self) -> Iterator[Batch[Item]]:
        return self

    def __next__(self) -> Batch[Item]:
        with self._lock:
            size = min(self._size(), len(self._items) - self._next)
            if size <= 0:
                raise StopIteration
            items = tuple(self._items[k] for k in range(self._next, self._next + size))
            self._next += size
            self._number += 1
            batch = Batch(self._number, items)
            self._under_way[batch.number] = batch
            return batch

    def _size(self) -> int:
        if not self._largest:
            return 1
        left = len(self._items) - self._next
        dealt = -(-left // (LAST * self._workers))
        wanted = SECONDS / max(self._time, SECONDS / MOST)
        return max(1, min(int(wanted), int(GROWTH * self._largest), dealt, MOST))

    def back(self, number: int, seconds: float) -> Batch[Item]:
        """A batch that is done.

        Args:
            number: of the batch.
            seconds: that it took.
        """
        with self._lock:
            batch = self._under_way.pop(number)
            each = seconds / len(batch.items)
            share = FOLLOWED if self._largest else 1.0
            self._time += share * (each - self._time)
            self._largest = max(self._largest, len(batch.items))
            return batch

    def lost(self) -> list[Batch[Item]]:
        """Those that were under way when the workers were lost; nobody waits for them any more."""
        with self._lock:
            lost = list(self._under_way.values())
            self._under_way.clear()
            return lost
