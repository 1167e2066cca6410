"""What a worker does, and what it sends back."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from coopqp.base.errors import CoopqpError
from coopqp.study.engine.batches import Batch

Work = Callable[[Sequence[Any]], Sequence[Any]]
"""A function of a module, so that other processes find it: the results of some items, in order."""


@dataclass(frozen=True)
class Outcome:
    """A batch that is done.

    Attributes:
        number: of the batch.
        results: of its items, in order.
        seconds: that it took.
    """

    number: int
    results: Sequence[Any]
    seconds: float


class WorkersLostError(CoopqpError):
    """A worker died, and with it all that was under way; its words say how."""


class Workers(Protocol):
    """Who does batches."""

    @property
    def count(self) -> int:
        """How many batches they do at a time."""

    def outcomes(self, work: Work, batches: Iterable[Batch[Any]]) -> Iterator[Outcome]:
        """What came of the batches, in the order in which they are done.

        Raises:
            WorkersLostError: one of the workers died; whoever asks again gets new ones.
        """


def done(work: Work, batch: Batch[Any]) -> Outcome:
    """Do a batch."""
    begun = time.perf_counter()
    results = work(batch.items)
    return Outcome(batch.number, results, time.perf_counter() - begun)


@dataclass(frozen=True)
class Here:
    """No worker but this process, as a debugger wants it."""

    count: int = 1

    def outcomes(self, work: Work, batches: Iterable[Batch[Any]]) -> Iterator[Outcome]:
        """As :class:`Workers` has it; one that dies takes this process along."""
        return (done(work, batch) for batch in batches)
