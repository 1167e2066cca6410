"""Who gives NaN or infinite values, for ticks that have failed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from coopqp.checked import type_name
from coopqp.closed_chain import ClosedChain
from coopqp.limit import Limit, LimitRows
from coopqp.state import State
from coopqp.task import Task, TaskRows, evaluate_all


def not_finite(
    tasks: Sequence[Task],
    limits: Sequence[Limit],
    chain: ClosedChain,
    state: State,
    dt: float,
) -> str:
    """Which tasks and limits give NaN or infinite values at a state; empty if none does.

    Each is bound once more; one that raises is not told of.

    Args:
        tasks: any, also those that ask for forces.
        limits: any.
        chain: theirs.
        state: up to date.
        dt: control period [s].
    """
    return "; ".join((*_tasks(tasks, chain, state), *_limits(limits, chain, state, dt)))


def _tasks(tasks: Sequence[Task], chain: ClosedChain, state: State) -> Iterator[str]:
    for task in tasks:
        start = State(chain)
        start.inputs = state.inputs.now()
        try:
            k = len(task.rows(chain))
            columns = 6 * chain.holding if task.of_forces else chain.n
            J = np.eye(columns) if task.joint_space else np.zeros((k, columns))
            rows = TaskRows(np.zeros(k), J, np.zeros(k))
            evaluate_all([(task.bind(start), rows)], state)
        except Exception:  # noqa: BLE001 - code of plug-ins may raise anything; not asked here
            continue
        numbers = {"e": rows.e, "J": rows.J, "rate": rows.rate}
        bad = [name for name, values in numbers.items() if not np.isfinite(values).all()]
        if bad:
            yield f"task '{task.name}' gives NaN or infinite values in {', '.join(bad)}"


def _limits(limits: Sequence[Limit], chain: ClosedChain, state: State, dt: float) -> Iterator[str]:
    """Bounds and h may be infinite on the side that is free."""
    for limit in limits:
        try:
            p, n = len(limit.rows(chain)), chain.n
            free = np.full(n, -np.inf), np.full(n, np.inf)
            rows = LimitRows(*free, np.zeros((p, n)), np.full(p, np.inf))
            evaluate_all([(limit.bind(chain, dt), rows)], state)
        except Exception:  # noqa: BLE001 - as above
            continue
        good = {
            "lb": rows.lb < np.inf,
            "ub": rows.ub > -np.inf,
            "G": np.isfinite(rows.G),
            "h": rows.h > -np.inf,
        }
        bad = [name for name, fine in good.items() if not fine.all()]
        if bad:
            name = type_name(type(limit))
            yield f"limit '{name}' gives NaN or infinite values in {', '.join(bad)}"
