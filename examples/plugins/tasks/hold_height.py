"""The object keeps a height: one row, e = z - height."""

from __future__ import annotations

from coopqp import ClosedChain, Evaluate, State, Task, TaskRows, spec


@spec
class HoldHeight(Task):
    """The object keeps a height (1 row)."""

    height: float
    """Of the object's origin, in the world [m]."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The way up."""
        return ("z",)

    def bind(self, start: State) -> Evaluate:
        """Nothing has to be kept from the start."""

        def evaluate(state: State, rows: TaskRows) -> None:
            rows.e[0] = state.p_WO[2] - self.height  # [m]
            rows.J[0] = state.J_task[2]  # [m/rad]

        return evaluate
