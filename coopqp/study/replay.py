"""A saved tick solved again, with any solver."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from coopqp.checked import Array
from coopqp.solver import Solution, Solver, Status, Verifier
from coopqp.study.tick_record import TickRecord


@dataclass(frozen=True)
class Replay:
    """A saved tick solved again.

    Attributes:
        status: as verified.
        v: the answer.
        primal_residual, dual_residual: of the answer.
        difference: largest distance to the answer that was saved [rad/s].
    """

    status: Status
    v: Array
    primal_residual: float
    dual_residual: float
    difference: float

    def as_json(self) -> dict[str, Any]:
        """For machines."""
        return {**asdict(self), "status": self.status.value, "v": self.v.tolist()}


def replay(record: TickRecord, solver: Solver) -> Replay:
    """Solve a saved tick with any solver."""
    qp = record.qp()
    solution = Solution(qp)
    solver.open(qp, solution)()
    status = Verifier(qp, solution, record.budget, record.damping).check()
    return Replay(
        status,
        solution.v.copy(),
        float(solution.primal_residual),
        float(solution.dual_residual),
        float(np.abs(solution.v - np.array(record.first_answer)).max()),
    )
