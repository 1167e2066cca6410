"""The results of all items, whatever becomes of the workers.

A worker that dies takes down what all of them have under way. New ones then do those batches one
at a time, so that the one that ends its worker is known; of that one the items are done one at a
time. An item that ends its worker although it is alone is tried once more, and is then lost.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from coopqp.study.engine.batches import Batch, Batches
from coopqp.study.engine.cluster import Cluster
from coopqp.study.engine.processes import Processes, cores
from coopqp.study.engine.share import Share
from coopqp.study.engine.work import Work, Workers, WorkersLostError

TRIES = 2  # of an item that is done alone


@dataclass(frozen=True)
class Lost:
    """What there is instead of a result.

    Attributes:
        reason: how the worker ended, whenever it did this item.
    """

    reason: str


@dataclass(frozen=True)
class Engine:
    """Where work is done.

    Attributes:
        jobs: processes on this machine, all cores when 0; with 1 the work is done in this process,
            which then ends where an item ends its process.
        scheduler: address of a Dask scheduler, whose workers then do the work.
        share: of the items, where several commands share them.
    """

    jobs: int = 0
    scheduler: str = ""
    share: Share = field(default_factory=Share)

    def results(self, work: Work, items: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        """The share's items with their results, or Lost, in the order in which they are done.

        Args:
            work: a function of a module that takes some items and gives as many results. What it
                raises comes out here, and ends all.
            items: of all shares.

        Raises:
            CoopqpError: the scheduler does not answer.
        """
        mine = self.share.taken(items)
        jobs = self.jobs or cores()
        if not self.scheduler and (jobs == 1 or len(mine) == 1):
            for item in mine:
                (result,) = work([item])
                yield item, result
        elif self.scheduler:
            with Cluster.at(self.scheduler) as cluster:
                yield from _results(cluster, work, mine)
        else:
            yield from _results(Processes(min(jobs, max(2, len(mine)))), work, mine)


def _results(workers: Workers, work: Work, items: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
    batches: Batches[Any] = Batches(items, workers.count)
    while True:
        try:
            for outcome in workers.outcomes(work, batches):
                batch = batches.back(outcome.number, outcome.seconds)
                yield from zip(batch.items, outcome.results, strict=True)
            return
        except WorkersLostError:
            for batch in batches.lost():
                yield from _alone(workers, work, batch)


def _alone(workers: Workers, work: Work, batch: Batch[Any]) -> Iterator[tuple[Any, Any]]:
    """A batch with nothing beside it."""
    reason = ""
    for _ in range(TRIES if len(batch.items) == 1 else 1):
        try:
            (outcome,) = workers.outcomes(work, [batch])
        except WorkersLostError as error:
            reason = str(error)
        else:
            yield from zip(batch.items, outcome.results, strict=True)
            return
    if len(batch.items) == 1:
        yield batch.items[0], Lost(reason)
        return
    for item in batch.items:
        yield from _alone(workers, work, Batch(batch.number, (item,)))
