"""How freely the object can be moved for the tasks: condition and manipulability of M = J N.

J are the rows of all tasks of the phase that steer the object, N an orthonormal basis of the joint
motions that keep the loops closed (the null space of J_c, eq. (14)), so that M is what the joints
can still do to the tasks. Its smallest singular value is zero where they cannot move the object in
some direction that a task asks for. Angles count as lengths, ``LENGTH`` to the radian, so that one
number compares all rows. Manipulability after Yoshikawa 1985, of closed chains after Bicchi and
Prattichizzo 2000; passive joints move like any other.

Letters: i instants, k rows of the tasks.
"""

from collections.abc import Callable

import numpy as np

from coopqp.base.rank import RANK_TOLERANCE, null_space
from coopqp.base.spec import Array
from coopqp.base.wording import suppressed
from coopqp.closed_loop.screw import LENGTH
from coopqp.controller import ControlProblem
from coopqp.model.state import State
from coopqp.report import curves
from coopqp.report.curves import Figure, Window
from coopqp.report.figures.chart import Chart
from coopqp.task import LENGTHS, TaskStack

MAX_INSTANTS = 300  # of each controller and phase
WORST = 1e6  # larger conditions are drawn here
LESS = "The tasks ask for more than the loops leave free; what they leave is drawn."

Phases = list[tuple[Array, Array]]  # instants and singular values of each phase


def freedom_figures(chart: Chart) -> list[Figure]:
    """Condition and manipulability; none where no joints can move the object for a task."""
    runs = {name: _phases(chart, name) for name in chart.names}
    ratio, product = (_lines(runs, of) for of in (condition, manipulability))
    if not ratio:
        return []
    every = [sigma for phases in runs.values() for _, sigma in phases]
    notes = (LESS,) if any(left(s).shape[1] < s.shape[1] for s in every) else ()
    worst, best = (max(float(np.nanmax(y)) for _, y in of.values()) for of in (ratio, product))
    lowest = min(float(np.nanmin(y)) for _, y in ratio.values())
    log = curves.logarithmic(Window(min(1.0, lowest), max(10.0, 2.0 * worst)))
    powers = {"exponentformat": "power", "automargin": True, "nticks": 4}
    linear = curves.linear(Window(0.0, 1.1 * best or 1.0)) | powers
    return [
        Figure(
            title=title,
            unit=unit,
            data=[curves.curve(name, chart.styles[name], t, y) for name, (t, y) in of.items()],
            layout=chart.layout(axis),
            notes=notes,
        )
        for title, unit, of, axis in (
            ("Condition", "1, log scale", ratio, log),
            ("Manipulability", "product of the singular values", product, linear),
        )
    ]


def singular_values(problem: ControlProblem, t: Array, q: Array) -> Array:
    """Of M at each instant, largest first, shape (i, k); NaN where a task raises an error.

    At times since the phase began, shape (i,) [s], and configurations, shape (i, n).
    """
    chain = problem.chain
    steering = [task for task in problem.tasks if not task.joint_space]
    state, tasks = State(chain), TaskStack(steering, State(chain))
    parts = [part for task in steering for part in task.parts(chain)]
    lengths = np.array([1.0 if p.unit in LENGTHS else LENGTH for p in parts for _ in range(p.rows)])
    sigma = np.full((len(t), len(lengths)), np.nan)
    for k in np.flatnonzero(np.isfinite(q).all(axis=1)).tolist() if len(lengths) else ():
        state.t, state.q[:] = float(t[k]), q[k]
        state.update()
        updated = False
        with suppressed():  # the tick, which met the same error, names it
            tasks.update(state)
            updated = True
        if updated:
            M = lengths[:, None] * tasks.J @ null_space(chain.loop_jacobian(q[k]))
            values = np.linalg.svd(M, compute_uv=False)
            sigma[k] = np.pad(values, (0, len(lengths) - len(values)))
    return sigma


def left(sigma: Array) -> Array:
    """The singular values but those that are zero all along, shape (i, .)."""
    largest = np.nanmax(sigma, axis=0, initial=0.0)
    kept: Array = sigma[:, largest > RANK_TOLERANCE * max(float(largest.max(initial=0.0)), 1e-300)]
    return kept


def condition(sigma: Array) -> Array:
    """Largest over smallest singular value, at most ``WORST``, shape (i,)."""
    kept = left(sigma)
    ratio: Array = kept[:, 0] / np.maximum(kept[:, -1], kept[:, 0] / WORST)
    return ratio


def manipulability(sigma: Array) -> Array:
    """Product of the singular values, sqrt(det(M M')), shape (i,)."""
    product: Array = left(sigma).prod(axis=1)
    return product


def _phases(chart: Chart, name: str) -> Phases:
    trace = chart.traces[name]
    instants = chart.instants(trace, MAX_INSTANTS)
    return [
        (t := trace.t[rows], singular_values(problem, t - t[0], trace.q[rows]))
        for problem, rows in zip(chart.problems[name], instants, strict=True)
    ]


def _lines(runs: dict[str, Phases], of: Callable[[Array], Array]) -> dict[str, tuple[Array, Array]]:
    """Time and value of each controller whose joints can move the object for some task."""
    lines = {}
    for name, phases in runs.items():
        if known := [(t, of(sigma)) for t, sigma in phases if left(sigma).size]:
            t, y = (np.concatenate(part) for part in zip(*known, strict=True))
            lines[name] = t, y
    return lines
