"""How hard the hands press, and how much of the friction they use."""

from __future__ import annotations

import numpy as np

from coopqp.checked import Array
from coopqp.closed_loop.forces import squeezes
from coopqp.report import curves
from coopqp.report.curves import Figure, Window
from coopqp.report.figures.chart import Chart
from coopqp.trace import Trace

#: Use beyond this is not worth a scale.
MOST_USE = 1.5


def hands(chart: Chart) -> list[Figure]:
    """Normal force, use of friction and of pads by hand, slip; none where no hand presses."""
    pressing = {n: t for n, t in chart.traces.items() if "normal_force" in t.signals}
    figures = []
    arms = [arm.name for arm in chart.chain.robot.arms]
    for i, arm in enumerate(arms) if pressing else ():
        normal, use, edge = (
            _of(pressing, name, i) for name in ("normal_force", "friction_use", "edge_use")
        )
        figures.append(chart.plain(f"Normal force of {arm}", "N", normal))
        title = f"Friction that {arm} needs over what there is"
        figures.append(_up_to_one(chart, title, "slips", use))
        if not all(np.isnan(line).all() for line in edge.values()):
            title = f"Pressure of {arm} from the middle of its pad to the edge"
            figures.append(_up_to_one(chart, title, "tips", edge))
    if pressing:
        slip = {n: 1e3 * t.signals["slip"].max(axis=1) for n, t in pressing.items()}
        figures.append(chart.plain("Slip along the hands, largest", "mm", slip))
    return figures


def squeeze_of_fastened(chart: Chart) -> list[Figure]:
    """Between two hands that are fastened; none elsewhere. Of those that press: their normals."""
    lines = {}
    for name, trace in chart.traces.items():
        if "normal_force" in trace.signals or "hand_wrench" not in trace.signals:
            continue
        told = (
            trace.signals[signal].reshape(trace.ticks, len(chart.chain.robot.arms), -1)
            for signal in ("hand_point", "hand_wrench")
        )
        found = [squeezes(p, h) for p, h in zip(*told, strict=True)]
        if found and all(len(pairs) == 1 for pairs in found):
            lines[name] = np.array(found)[:, 0]
    return [chart.plain("Squeeze between the hands", "N", lines)] if lines else []


def load_shares(chart: Chart) -> list[Figure]:
    """Which part of the lift each arm brings; none where no plant tells forces."""
    telling = {n: t for n, t in chart.traces.items() if "hand_wrench" in t.signals and t.ticks}
    arms = [arm.name for arm in chart.chain.robot.arms]
    return [
        chart.plain(
            f"Share of the load on {arm}", "1", {n: _share(t, i) for n, t in telling.items()}
        )
        for i, arm in enumerate(arms)
        if telling
    ]


def _share(trace: Trace, i: int) -> Array:
    lift = trace.signals["hand_wrench"].reshape(trace.ticks, -1, 6)[:, :, 2]
    total = lift.sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(np.abs(total) > 1e-3, lift[:, i] / total, np.nan)
    return np.asarray(share, float)


def _of(traces: dict[str, Trace], signal: str, i: int) -> dict[str, Array]:
    return {name: trace.signals[signal][:, i] for name, trace in traces.items()}


def _up_to_one(chart: Chart, title: str, beyond: str, lines: dict[str, Array]) -> Figure:
    """What is used up at 1, and what comes beyond."""
    shown = Window(0.0, MOST_USE)
    clipped = {name: np.minimum(line, MOST_USE) for name, line in lines.items()}
    return Figure(
        title=title,
        unit="1",
        data=chart.beyond_limits(shown, -1.0, 1.0) + chart.curves(clipped),
        layout=chart.layout(curves.linear(shown), curves.level(1.0, beyond)),
    )
