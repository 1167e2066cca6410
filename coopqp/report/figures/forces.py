"""Forces of a run: how hard hands press, internal wrenches, shares of the load, motors' torques."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from coopqp.base.spec import Array
from coopqp.closed_loop.forces import squeezes
from coopqp.report import curves
from coopqp.report.curves import Figure, Window
from coopqp.report.figures.chart import Chart
from coopqp.report.figures.joints import joint_order
from coopqp.trace import Trace

#: Use beyond this is not worth a scale.
MOST_USE = 1.5
#: Signals of wrenches, which part of them, and what their norm is called.
WRENCHES = (
    ("internal_wrench", slice(3), "Internal force, largest of the hands", "N"),
    ("internal_wrench", slice(3, 6), "Internal moment, largest of the hands", "N m"),
    ("cut_wrench", slice(3), "Constraint force at the cut", "N"),
)


def hands(chart: Chart) -> list[Figure]:
    """Normal force, use of friction and of pads by hand, slip; none where no hand presses."""
    if not any("normal_force" in trace.signals for trace in chart.traces.values()):
        return []
    figures = []
    for i, arm in enumerate(_arms(chart)):
        normal, use, edge = (
            _told(chart, "normal_force", partial(_column, name=name, i=i))
            for name in ("normal_force", "friction_use", "edge_use")
        )
        title = f"Friction that {arm} needs over what there is"
        figures.append(chart.plain(f"Normal force of {arm}", "N", normal))
        figures.append(_up_to_one(chart, title, "slips", use))
        if not all(np.isnan(line).all() for line in edge.values()):
            title = f"Pressure of {arm} from the middle of its pad to the edge"
            figures.append(_up_to_one(chart, title, "tips", edge))
    slip = _told(chart, "normal_force", lambda t: 1e3 * t.signals["slip"].max(axis=1))
    return [*figures, chart.plain("Slip along the hands, largest", "mm", slip)]


def squeeze_of_fastened(chart: Chart) -> list[Figure]:
    """Between two hands that are fastened; none elsewhere. Of those that press: their normals."""
    lines = _told(chart, "hand_wrench", lambda trace: _squeeze(trace, len(_arms(chart))))
    return [chart.plain("Squeeze between the hands", "N", lines)] if lines else []


def load_shares(chart: Chart) -> list[Figure]:
    """Which part of the lift each arm brings; none where no plant tells forces."""
    shares = _told(chart, "hand_wrench", lambda trace: _shares(trace) if trace.ticks else None)
    return [
        chart.plain(f"Share of the load on {arm}", "1", {n: y[:, i] for n, y in shares.items()})
        for i, arm in enumerate(_arms(chart))
        if shares
    ]


def forces(chart: Chart) -> list[Figure]:
    """At the cut of the loop and between the hands, as far as told."""
    figures = []
    for signal, part, title, unit in WRENCHES:
        lines = _told(chart, "tau", partial(_largest, signal=signal, part=part))
        if lines:
            figures.append(chart.plain(title, unit, lines))
    return figures


def torques(chart: Chart) -> list[Figure]:
    """One a motor, those of two equal arms side by side."""
    if not any("tau" in trace.signals for trace in chart.traces.values()):
        return []
    return [_torque(chart, i) for i in joint_order(chart.chain) if chart.any.effort[i] > 0.0]


def _torque(chart: Chart, i: int) -> Figure:
    joint, limit = chart.any.joints[i], float(chart.any.effort[i])
    what, unit = ("Force", "N") if chart.any.units[i] == "m" else ("Torque", "N m")
    title = f"{what} of {joint}"

    def torque(trace: Trace) -> Array | None:
        there = joint in trace.joints
        return trace.signals["tau"][:, trace.joints.index(joint)] if there else None

    lines = _told(chart, "tau", torque)
    if not np.isfinite(limit):
        return chart.plain(title, f"{unit}, no limit", lines)
    lower, upper = (
        curves.level(-limit, f"-{limit:.3g}", above=False),
        curves.level(limit, f"{limit:.3g}"),
    )
    shown = Window(-1.15 * limit, 1.15 * limit)
    return chart.figure(title, unit, lines, shown, lower, upper, allowed=(-limit, limit))


def _told(chart: Chart, signal: str, of: Callable[[Trace], Array | None]) -> dict[str, Array]:
    """Something of every trace that has a signal."""
    return chart.lines(lambda trace: of(trace) if signal in trace.signals else None)


def _arms(chart: Chart) -> list[str]:
    return [arm.name for arm in chart.chain.robot.arms]


def _column(trace: Trace, name: str, i: int) -> Array:
    return trace.signals[name][:, i]


def _largest(trace: Trace, signal: str, part: slice) -> Array | None:
    """The largest norm of a part of the wrenches in a signal, shape (T,)."""
    if signal not in trace.signals:
        return None
    wrenches = trace.signals[signal].reshape(trace.ticks, -1, 6)[:, :, part]
    norms: Array = np.linalg.norm(wrenches, axis=2).max(axis=1)
    return norms


def _squeeze(trace: Trace, arms: int) -> Array | None:
    """Of two hands that are fastened, shape (T,) [N]."""
    if "normal_force" in trace.signals:
        return None
    told = (
        trace.signals[name].reshape(trace.ticks, arms, -1) for name in ("hand_point", "hand_wrench")
    )
    found = [squeezes(p, h) for p, h in zip(*told, strict=True)]
    return np.array(found)[:, 0] if found and all(len(pairs) == 1 for pairs in found) else None


def _shares(trace: Trace) -> Array:
    """Of the lift that each hand brings, NaN where there is none, shape (T, arms)."""
    lift = trace.signals["hand_wrench"].reshape(trace.ticks, -1, 6)[:, :, 2]
    total = lift.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(np.abs(total) > 1e-3, lift / total, np.nan), float)


def _up_to_one(chart: Chart, title: str, beyond: str, lines: dict[str, Array]) -> Figure:
    """What is used up at 1, and what comes beyond."""
    clipped = {name: np.minimum(line, MOST_USE) for name, line in lines.items()}
    level = curves.level(1.0, beyond)
    return chart.figure(title, "1", clipped, Window(0.0, MOST_USE), level, allowed=(-1.0, 1.0))
