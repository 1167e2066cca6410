"""joblib's back-end for Dask, with an answer also where Dask gives a task up.

A task whose workers died too often ends in an error without a result. joblib 1.6 calls nobody back
then, so that who waits for results as they come would wait for ever.
"""

from __future__ import annotations

import asyncio
from typing import Any

from joblib._dask import DaskDistributedBackend  # registers itself for the name "dask" as well


class _Answering(DaskDistributedBackend):  # type: ignore[misc]
    def effective_n_jobs(self, n_jobs: int) -> int:
        # With one, joblib would do the work in this process, whatever it is.
        return max(2, int(super().effective_n_jobs(n_jobs)))

    async def _collect(self) -> None:
        while self._continue:
            async for future, result in self.waiting_futures:
                asked, answer = self._results.pop(future), self._callbacks.pop(future)
                given_up = future.status == "error"
                if given_up:
                    result = result[1]  # of type, error and traceback
                    asked.set_exception(result)
                else:
                    asked.set_result(result)
                answer(_GivenUp(result) if given_up else result)
            await asyncio.sleep(0.01)

    def retrieve_result_callback(self, out: Any) -> Any:
        if isinstance(out, _GivenUp):
            raise out.error
        return super().retrieve_result_callback(out)


class _GivenUp:
    """Instead of a result."""

    def __init__(self, error: BaseException) -> None:
        self.error = error


def backend(client: Any, patience: float) -> Any:
    """The back-end that submits to a client's scheduler.

    Args:
        client: connected.
        patience: how long it waits where all workers are gone [s].
    """
    return _Answering(client=client, wait_for_workers_timeout=patience)
