"""Each joint over time between its limits, as in the paper's figures 4-8."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain as joined

import numpy as np

from coopqp.assessment.thresholds import OUTSIDE
from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain
from coopqp.report import curves
from coopqp.report.curves import Figure, Json, Window
from coopqp.report.figures.chart import Chart
from coopqp.trace import Trace

FREE_REACH = 2.0 * np.pi  # how far lines of a joint without limits may spread [rad or m]
NEAR = 0.02  # of the range: a joint this near to a limit is shown first
MOST_FIRST = 3  # rows of joints that are shown first
PAPER_ROBOT = "nao_t14"
PAPER_FIGURES = {f"q{k} of the right arm": f"Fig. {3 + k} of the paper" for k in range(1, 6)}


@dataclass(frozen=True)
class JointRow:
    """Joints side by side: one that arms share, or the same one of two; what is said of each."""

    joints: tuple[int, ...]
    about: tuple[str, ...]


def joint_figures(chart: Chart) -> tuple[list[Figure], list[Figure], list[Figure]]:
    """The joint that comes nearest to a limit, others that come near one, and the rest.

    Each with those beside it; the nearest is the first of its row. Where none comes near, the first
    list is empty and the second has the nearest.
    """
    rows = joint_rows(chart.chain)
    rooms = [[_least_room(chart, i) for i in row.joints] for row in rows]
    room = [min(own) for own in rooms]
    nearest = np.argsort(room, kind="stable")[:MOST_FIRST].tolist()
    near = [n for n in nearest if room[n] < NEAR]
    decisive, others = near[:1], near[1:] or nearest[: not near]
    rest = [n for n in range(len(rows)) if n not in (*decisive, *others)]
    parts = (decisive, sorted(others), rest)
    first, second, third = (_figures(chart, [rows[n] for n in part]) for part in parts)
    for n in decisive:
        first.insert(0, first.pop(int(np.argmin(rooms[n]))))
    return first, second, third


def joint_rows(chain: ClosedChain) -> list[JointRow]:
    """The joints as they are shown: those that arms share first, two equal arms side by side."""
    model, arms = chain.model, []
    for frame in chain.frames:
        support = model.supports[model.frames[frame].parentJoint]
        arms.append([j - 1 for j in support if j > 0])
    counts = {j: sum(j in arm for arm in arms) for j in joined(*arms)}
    own = [[j for j in arm if counts[j] == 1] for arm in arms]
    names = [arm.name for arm in chain.arms]
    said = {
        j: f"{'passive joint' if j in chain.passive else f'q{k}'} of the {name} arm"
        for name, joints in zip(names, own, strict=True)
        for k, j in enumerate(joints, start=1)
    }
    for j, count in counts.items():
        if count > 1:
            carried = [name for name, arm in zip(names, arms, strict=True) if j in arm]
            said[j] = f"carries {' and '.join(carried)}"
    if len(own) == 2 and len(own[0]) == len(own[1]):
        rows: list[tuple[int, ...]] = list(zip(*own, strict=True))
    else:
        rows = [(j,) for j in joined(*own)]
    shared = [(j,) for j, count in counts.items() if count > 1]
    idle = [(j,) for j in range(chain.n) if j not in counts]
    return [JointRow(row, tuple(said.get(j, "") for j in row)) for row in [*shared, *rows, *idle]]


def joint_order(chain: ClosedChain) -> list[int]:
    """Indices of the joints in the order in which they are shown."""
    return [j for row in joint_rows(chain) for j in row.joints]


def _least_room(chart: Chart, i: int) -> float:
    """Least distance of a joint to a limit under any controller, in its range; inf without one."""
    lower, upper = chart.any.lower[i], chart.any.upper[i]
    ways = chart.lines(lambda trace: _way(trace, chart.any.joints[i])).values()
    least = min((float(np.min(np.minimum(q - lower, upper - q))) for q in ways), default=np.inf)
    span = upper - lower
    return least / span if np.isfinite(span) and span > 0.0 else least


def _figures(chart: Chart, rows: list[JointRow]) -> list[Figure]:
    known = PAPER_FIGURES if chart.comparison.scenario.robot_model.name == PAPER_ROBOT else {}
    return [
        replace(
            _joint(chart, i, chart.any.units[i]),
            about=f"{about}, {known[about]}" if about in known else about,
            alone=len(row.joints) == 1,
        )
        for row in rows
        for i, about in zip(row.joints, row.about, strict=True)
    ]


def _joint(chart: Chart, i: int, unit: str) -> Figure:
    lower, upper = limits = float(chart.any.lower[i]), float(chart.any.upper[i])
    lines = chart.lines(lambda trace: _way(trace, chart.any.joints[i]))
    shown = joint_window(lower, upper, list(lines.values()))
    levels = []
    if np.isfinite(lower):
        levels.append(curves.level(lower, f"lower limit {lower:.3g}", above=False))
    if np.isfinite(upper):
        levels.append(curves.level(upper, f"upper limit {upper:.3g}"))
    return chart.figure(
        chart.any.joints[i],
        unit if levels else f"{unit}, no limits",
        lines,
        shown,
        *levels,
        allowed=limits,
        extra=joined(*(_marks(chart, name, y, limits, shown) for name, y in lines.items())),
        notes=curves.off_chart(shown, lines, unit),
    )


def _way(trace: Trace, joint: str) -> Array | None:
    """Of a joint, shape (T + 1,); None where the trace does not have it."""
    return trace.q[:, trace.joints.index(joint)] if joint in trace.joints else None


def _marks(
    chart: Chart, name: str, y: Array, limits: tuple[float, float], shown: Window
) -> list[Json]:
    """A cross where a joint first leaves its limits, a triangle where it leaves the chart."""
    (lower, upper), marks = limits, []
    bounds = (
        (lower - OUTSIDE, upper + OUTSIDE, limits, ("x", "x")),
        (shown.bottom, shown.top, (shown.bottom, shown.top), ("triangle-down", "triangle-up")),
    )
    for low, high, heights, symbols in bounds:
        for k in np.flatnonzero((y < low) | (y > high))[:1]:
            up = bool(y[k] > high)
            place = [(float(chart.any.t[k]), heights[up])]
            marks.append(curves.markers(name, chart.styles[name], place, symbols[up]))
    return marks


def joint_window(lower: float, upper: float, lines: list[Array]) -> Window:
    """Show the limits, and at most one more range beyond them.

    Where a limit is missing, the calmest line takes its place.
    """
    calm = min(lines, key=np.ptp)
    low = lower if np.isfinite(lower) else min(float(calm.min()), upper)
    high = upper if np.isfinite(upper) else max(float(calm.max()), low)
    limited = np.isfinite(lower) and np.isfinite(upper)
    if not limited:
        low, high = low - 0.05, high + 0.05
    return curves.window(low, high, lines, high - low if limited else FREE_REACH)
