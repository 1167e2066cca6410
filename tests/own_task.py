"""A task of one row that a test writes."""

from __future__ import annotations

from collections.abc import Callable

from coopqp.base.spec import spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.task import Evaluate, Task, TaskRows

Write = Callable[[State, TaskRows], None]


@spec
class Own(Task):
    """One row, as a function writes it."""

    write: Write

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return ("row",)

    def bind(self, start: State) -> Evaluate:
        return self.write
