"""Workers of a Dask scheduler, through joblib's back-end for it."""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
import warnings
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import Any

from coopqp.base.errors import CoopqpError, MissingDependencyError
from coopqp.study.engine.batches import Batch
from coopqp.study.engine.work import Outcome, Work, WorkersLostError, done

PATIENCE = 15.0  # s within which a scheduler must answer, and have a worker
AHEAD = 2  # batches that are handed out before they are asked for, a worker


@dataclass(frozen=True)
class Cluster:
    """The workers of a scheduler.

    Attributes:
        address: of the scheduler.
        client: connected to it.
    """

    address: str
    client: Any

    @classmethod
    @contextmanager
    def at(cls, address: str) -> Iterator[Cluster]:
        """Those of a scheduler that answers and has workers.

        Raises:
            CoopqpError: it does not, within some seconds.
            MissingDependencyError: Dask is not installed.
        """
        try:
            from distributed import Client
        except ImportError:
            raise MissingDependencyError("--scheduler", "dask") from None
        _hush()
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
            yield cls(address, client)
        finally:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                client.close(timeout=PATIENCE)

    @property
    def count(self) -> int:
        """Threads of all workers."""
        return max(1, int(sum(self.client.ncores().values())))

    def outcomes(self, work: Work, batches: Iterable[Batch[Any]]) -> Iterator[Outcome]:
        """As :class:`coopqp.study.engine.work.Workers` has it.

        Dask itself does again what a worker had under way that went, up to three times.
        """
        from distributed import KilledWorker
        from joblib import Parallel, delayed

        from coopqp.study.engine.dask_backend import backend

        asked = (delayed(done)(work, batch) for batch in batches)
        try:
            parallel = Parallel(
                n_jobs=-1,
                backend=backend(self.client, PATIENCE),
                return_as="generator_unordered",
                batch_size=1,
                pre_dispatch=AHEAD * self.count,
            )
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", module=r"(joblib|distributed)\.")
                with closing(parallel(asked)) as outcomes:
                    yield from outcomes
        except KilledWorker as error:
            raise WorkersLostError(f"ended {error.allowed_failures + 1} Dask workers") from None
        except TimeoutError:
            raise self._gone("has had no worker") from None
        except (OSError, asyncio.CancelledError, concurrent.futures.CancelledError):
            raise self._gone("is gone") from None

    def _gone(self, what: str) -> CoopqpError:
        words = "what was done is kept, and the same command goes on from there"
        return CoopqpError(f"the Dask scheduler at '{self.address}' {what}; {words}")


def _hush() -> None:
    """Keep Dask's own lines about what comes and goes from standing between ours."""
    for name in list(logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
