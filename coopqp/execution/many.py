"""Many motions of one controller from many starts, on several threads, without Python between."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array, array, finite
from coopqp.controller import MAX_TICKS, Law
from coopqp.execution.controller_run import controller_of
from coopqp.scenario.scenario import Scenario, needs_scenario
from coopqp.solver import Status
from coopqp.trace import TickBatch

#: Motions that a thread takes at a time, and their ticks: so long Ctrl-C waits.
CHUNK, AT_ONCE = 16, 200_000


@dataclass(frozen=True)
class Motions:
    """M motions of T ticks each."""

    q: Array  #: Joints before each tick and at the end, shape (M, T + 1, n) [rad, m].
    v: Array  #: Commands, shape (M, T, n) [rad/s, m/s].
    said: NDArray[np.uint8]  #: What each tick said, an index of ``causes``, shape (M, T).
    causes: tuple[tuple[Status, ...], ...]  #: All that was said; the first is OPTIMAL alone.
    compiled: NDArray[np.bool_]  #: Whether the kernel decided the tick, shape (M, T).

    def share(self, status: Status) -> float:
        """Share of all ticks with a status."""
        among = [i for i, causes in enumerate(self.causes) if status in causes]
        return float(np.isin(self.said, among).mean()) if self.said.size else 0.0


def run_many(
    scenario: Scenario,
    starts: ArrayLike,
    *,
    controller: str = "qp",
    ticks: int | None = None,
    threads: int | None = None,
) -> Motions:
    """Run one controller from many starts, on ideal joints and without inputs from outside.

    Each motion is ``law.run(law.start(q), ticks)``, bit for bit, whatever the number of threads.
    Where nothing of the tasks, limits and signals is Python's, it is computed in C++ as a whole and
    without Python's lock.

    Args:
        scenario: from :func:`coopqp.load`, without phases; references set out from its own start.
        starts: joints, shape (M, n) [rad, m].
        controller: its name in the scenario, or any controller's type name.
        ticks: of each motion; the scenario's when omitted.
        threads: one a processor when omitted.

    Raises:
        InvalidValueError: an argument is none of these, or the controller commands torques.
        CoopqpError: the controller cannot be built for this scenario.
    """
    needs_scenario(scenario)
    chosen, n = controller_of(scenario, controller), scenario.chain.n
    if scenario.phases or chosen.commands_torques:
        what = "phases" if scenario.phases else "torques"
        raise InvalidValueError(f"run_many: found {what}, needs one motion in velocities")
    given = np.ascontiguousarray(finite("starts", array("starts", starts)))
    if given.ndim != 2 or given.shape[1] != n:
        raise InvalidValueError(f"starts: found shape {given.shape}, needs (M, {n})")
    count = _whole("threads", threads, os.cpu_count() or 1, 1)
    steps = _whole("ticks", ticks, scenario.ticks, 0)
    problem = scenario.held_by(controller).problem()
    most = max(1, -(-len(given) // CHUNK))
    return _run_all([chosen.unprepared(problem) for _ in range(min(count, most))], given, steps)


def _run_all(laws: Sequence[Law], starts: Array, ticks: int) -> Motions:
    """By as many threads as there are laws."""
    m, n = starts.shape
    try:
        q, v = np.empty((m, ticks + 1, n)), np.empty((m, ticks, n))
        said = np.zeros((m, ticks), np.uint8)
    except MemoryError:
        words = f"found {m} motions of {ticks} ticks, needs fewer: they do not fit into memory"
        raise InvalidValueError(f"starts: {words}") from None
    size = max(1, min(CHUNK, AT_ONCE // max(ticks, 1)))
    free, plain = deque(laws), dict[int, TickBatch]()

    def run(first: int) -> None:
        law, part = free.pop(), slice(first, first + size)
        try:
            done = law.run_starts(starts[part], q[part], v[part], said[part])
            for i in (first + np.flatnonzero(done < ticks)).tolist():  # in which Python decides
                plain[i] = law.run(law.start(starts[i]), ticks)
        finally:
            free.append(law)

    with ThreadPoolExecutor(len(laws)) as pool:
        list(pool.map(run, range(0, m, size)))
    compiled, index = np.ones((m, ticks), bool), np.zeros(256, np.uint8)
    causes: dict[tuple[Status, ...], int] = {(Status.OPTIMAL,): 0}
    by_kernel = np.isin(np.arange(m), list(plain), invert=True)
    for outcome in np.unique(said[by_kernel]).tolist():
        index[outcome] = causes.setdefault(laws[0].outcomes[outcome], len(causes))
    said[by_kernel] = index[said[by_kernel]]
    for i, made in sorted(plain.items()):
        q[i], v[i], compiled[i] = made.q, made.v, made.compiled
        said[i] = [causes.setdefault(all_of, len(causes)) for all_of in made.causes]
    return Motions(q, v, said, tuple(causes), compiled)


def _whole(name: str, value: int | None, omitted: int, least: int) -> int:
    found = omitted if value is None else value
    if type(found) is not int or not least <= found <= MAX_TICKS:
        words = f"found {value!r}, needs a whole number, {least} to {MAX_TICKS}"
        raise InvalidValueError(f"{name}: {words}")
    return found
