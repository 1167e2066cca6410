"""An object that nothing holds, so that a task has all six motions."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.task import Task, TaskRows


class FreeState(State):
    """Where the object is, and how it moves with the six numbers v."""

    J_task: Array = np.eye(6)

    def __init__(self, p: Array, R: Array) -> None:
        self.chain = cast(ClosedChain, SimpleNamespace(n=6))
        self.t, self.p_WO, self.R_WO = 0.0, p, R


class FreeBody:
    """An object that nothing holds, so that a task has all six motions."""

    def __init__(self, rng: np.random.Generator | None = None) -> None:
        p, phi = (np.zeros(3), np.zeros(3)) if rng is None else rng.normal(size=(2, 3))
        self.state = FreeState(p.copy(), np.array(pin.exp3(phi)))

    def step(self, v: Array, dt: float) -> None:
        self.state.p_WO += dt * v[:3]
        self.state.R_WO[:] = pin.exp3(dt * v[3:]) @ self.state.R_WO
        self.state.t += dt

    def follow(self, task: Task, duration: float, dt: float = 0.01) -> tuple[TaskRows, list[float]]:
        """Move as the task wishes and no more; the rows at the end and the errors on the way."""
        k = len(task.rows(self.state.chain))
        block = TaskRows(np.zeros(k), np.zeros((k, 6)), np.zeros(k))
        evaluate, errors = task.bind(self.state), []
        for _ in range(round(duration / dt)):
            evaluate(self.state, block)
            assert all(np.isfinite(a).all() for a in (block.e, block.J, block.rate))
            errors.append(float(np.linalg.norm(block.e)))
            v = np.linalg.pinv(block.J, rcond=1e-6) @ (block.rate - task.gain * block.e)
            self.step(v, dt)
        evaluate(self.state, block)
        return block, errors

    def turn_to(self, R: Array) -> None:
        self.state.R_WO[:] = R


def block_of(task: Task, state: State, chain: ClosedChain) -> TaskRows:
    k, n = len(task.rows(chain)), state.chain.n
    block = TaskRows(np.zeros(k), np.zeros((k, n)), np.zeros(k))
    task.bind(state)(state, block)
    return block
