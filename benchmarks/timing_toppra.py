"""The duration that toppra finds for rows from a file: run by benchmarks/timing.py --toppra."""

from __future__ import annotations

import logging
import sys

import numpy as np
import toppra
from toppra import algorithm, constraint
from toppra.constraint import linear_constraint

logging.disable(logging.WARNING)


class Given(constraint.LinearConstraint):
    """Rows lo <= a u + b x <= up, and x <= x_max, at the grid's places."""

    def __init__(self, rows: dict[str, np.ndarray]) -> None:
        super().__init__()
        self._rows = rows
        self.set_discretization_type(constraint.DiscretizationType.Interpolation)

    def compute_constraint_params(self, path: object, places: np.ndarray) -> tuple:
        """A, b, c, F, g, bounds of u and of x, at both ends of each interval."""
        r = self._rows
        N, k = r["a"].shape
        signs = np.vstack([np.eye(k), -np.eye(k)])
        F = np.repeat(signs[None], N, axis=0)
        g = np.hstack([r["up"], -r["lo"]])
        x = np.column_stack([np.zeros(N), r["x_max"]])
        u = np.tile([-1e6, 1e6], (N, 1))
        # It returns the two bounds in the order in which it takes them, whatever it calls them.
        parts = r["a"], r["b"], np.zeros((N, k)), F, g, u, x
        return linear_constraint.canlinear_colloc_to_interpolate(*parts, r["s"])


def main() -> None:
    rows = dict(np.load(sys.argv[1]))
    s = rows["s"]
    path = toppra.SplineInterpolator(s[[0, -1]], np.array([[0.0], [1.0]]))
    given = Given(rows)
    solved = algorithm.TOPPRA([given], path, gridpoints=s, solver_wrapper="seidel")
    _, rate, _ = solved.compute_parameterization(0.0, 0.0)
    print(np.nan if rate is None else float((2.0 * np.diff(s) / (rate[1:] + rate[:-1])).sum()))


if __name__ == "__main__":
    main()
