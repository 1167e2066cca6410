"""The results of all items, whatever becomes of the workers.

A worker that dies takes down what all of them have under way. New ones then do those batches one
at a time, so that the one that ends its worker is known; of that one the items are done one at a
time. An item that ends its worker although it is alone is tried once more, and is then lost.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from coopqp.base.errors import InvalidValueError
from coopqp.study.engine.workers import (
    Batch,
    Batches,
    Items,
    Outcome,
    Processes,
    Work,
    Workers,
    WorkersLostError,
    cores,
    done,
)

Item = TypeVar("Item")

TRIES = 2  # of an item that is done alone
MOST = 100_000  # commands that may share a job; job arrays of clusters have fewer

Done = list[tuple[Any, Any]]
"""Items with what came of each."""


@dataclass(frozen=True)
class Share:
    """Every so manyeth item, from the first, second ... on, where several commands share them."""

    number: int = 1
    of: int = 1

    @classmethod
    def read(cls, text: str) -> Share:
        """From what is written, such as "2/8".

        Raises:
            InvalidValueError: that is none.
        """
        found = re.fullmatch(r"\s*(\d{1,6})\s*/\s*(\d{1,6})\s*", text)
        number, of = (int(part) for part in found.groups()) if found else (0, 0)
        if not 1 <= number <= of <= MOST:
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
class Here:
    """No worker but this process, as a debugger wants it; an item that ends it ends all."""

    count: int = 1

    def outcomes(self, work: Work, batches: Iterable[Batch]) -> Iterator[Outcome]:
        """One after the other."""
        return (done(work, batch) for batch in batches)


@dataclass(frozen=True)
class Engine:
    """Where work is done.

    Attributes:
        jobs: processes on this machine, all cores when 0; with 1 the work is done in this process,
            which then ends where an item ends its process.
        scheduler: address of a Dask scheduler, whose workers then do the work.
        share: what of a job its owner is to ask for here.
    """

    jobs: int = 0
    scheduler: str = ""
    share: Share = field(default_factory=Share)

    def batches(self, work: Work, items: Items) -> Iterator[Done]:
        """Items with their results, or Lost, in batches as they are done.

        What the work raises comes out here, and ends all.

        Raises:
            CoopqpError: the scheduler does not answer.
        """
        if self.scheduler:
            from coopqp.study.engine.cluster import Cluster

            with Cluster.at(self.scheduler) as cluster:
                yield from _results(cluster, work, items)
            return
        jobs = min(self.jobs or cores(), len(items))
        yield from _results(Processes(jobs) if jobs > 1 else Here(), work, items)

    def results(self, work: Work, items: Items) -> Iterator[tuple[Any, Any]]:
        """The same one by one."""
        for batch in self.batches(work, items):
            yield from batch


def _results(workers: Workers, work: Work, items: Items) -> Iterator[Done]:
    batches = Batches(items, workers.count)
    while True:
        try:
            for outcome in workers.outcomes(work, batches):
                batch = batches.back(outcome.number, outcome.seconds)
                yield list(zip(batch.items, outcome.results, strict=True))
            return
        except WorkersLostError:
            for batch in batches.lost():
                yield from _alone(workers, work, batch)


def _alone(workers: Workers, work: Work, batch: Batch) -> Iterator[Done]:
    """A batch with nothing beside it."""
    reason, single = "", len(batch.items) == 1
    for _ in range(TRIES if single else 1):
        try:
            (outcome,) = workers.outcomes(work, [batch])
        except WorkersLostError as error:
            reason = str(error)
        else:
            yield list(zip(batch.items, outcome.results, strict=True))
            return
    if single:
        yield [(batch.items[0], Lost(reason))]
        return
    for item in batch.items:
        yield from _alone(workers, work, Batch(batch.number, (item,)))
