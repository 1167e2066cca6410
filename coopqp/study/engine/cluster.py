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

from joblib._dask import DaskDistributedBackend  # there without Dask as well

from coopqp.base.errors import CoopqpError, MissingDependencyError
from coopqp.study.engine.workers import Batch, Outcome, Work, WorkersLostError, by_joblib, done

PATIENCE = 15.0  # s within which a scheduler must answer, and have a worker


@dataclass(frozen=True)
class Cluster:
    """The workers of the scheduler at an address, to which the client is connected."""

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

    def outcomes(self, work: Work, batches: Iterable[Batch]) -> Iterator[Outcome]:
        """Dask itself does again what a worker had under way that went, up to three times."""
        from distributed import KilledWorker

        try:
            backend = _Answering(client=self.client, wait_for_workers_timeout=PATIENCE)
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", module=r"(joblib|distributed)\.")
                started = by_joblib(done, work, batches, self.count, n_jobs=-1, backend=backend)
                with closing(started) as outcomes:
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


class _Answering(DaskDistributedBackend):  # type: ignore[misc]
    """joblib's back-end, with an answer also where Dask gives a task up.

    A task whose workers died too often ends in an error without a result. joblib 1.6 calls nobody
    back then, so that who waits for results as they come would wait for ever.
    """

    def effective_n_jobs(self, n_jobs: int) -> int:
        # With one, joblib would do the work in this process, whatever it is.
        return max(2, int(super().effective_n_jobs(n_jobs)))

    async def _collect(self) -> None:
        while self._continue:
            async for future, result in self.waiting_futures:
                asked, answer = self._results.pop(future), self._callbacks.pop(future)
                if future.status == "error":
                    error = result[1]  # of type, error and traceback
                    asked.set_exception(error)
                    answer(_GivenUp(error))
                else:
                    asked.set_result(result)
                    answer(result)
            await asyncio.sleep(0.01)

    def retrieve_result_callback(self, out: Any) -> Any:
        if isinstance(out, _GivenUp):
            raise out.error
        return super().retrieve_result_callback(out)


@dataclass
class _GivenUp:
    error: BaseException
