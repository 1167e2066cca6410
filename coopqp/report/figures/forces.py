"""Forces of a run: normal and internal forces, shares of the load, motor torques."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from coopqp.base.spec import Array
from coopqp.closed_loop.forces import squeezes
from coopqp.report import curves
from coopqp.report.curves import Figure, Window
from coopqp.report.figures.chart import Chart, Lines
from coopqp.report.figures.joints import joint_order
from coopqp.trace import Trace

MAX_USE = 1.5  # more friction or pad than this is cut off
#: Signals of wrenches, which part of them, and title and unit of its norm.
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
            _of_hand(chart, name, i) for name in ("normal_force", "friction_use", "edge_use")
        )
        title = f"Friction that {arm} needs over what there is"
        figures.append(chart.plain(f"Normal force of {arm}", "N", normal))
        figures.append(_up_to_one(chart, title, "slips", use))
        if not all(np.isnan(line).all() for line in edge.values()):
            title = f"Pressure of {arm} from the middle of its pad to the edge"
            figures.append(_up_to_one(chart, title, "tips", edge))
    slip = _with_signal(chart, "normal_force", lambda t: 1e3 * t.signals["slip"].max(axis=1))
    return [*figures, chart.plain("Slip along the hands, largest", "mm", slip)]


def load_shares(chart: Chart) -> list[Figure]:
    """Each arm's share of the vertical force; none where the plant gives no forces."""
    shares = _with_signal(chart, "hand_wrench", lambda t: _shares(t) if t.ticks else None)
    return [
        chart.plain(f"Share of the load on {arm}", "1", {n: y[:, i] for n, y in shares.items()})
        for i, arm in enumerate(_arms(chart))
        if shares
    ]


def internal_forces(chart: Chart) -> list[Figure]:
    """At the cut of the loop and between the hands, as far as the plant gives them."""
    figures = []
    for signal, part, title, unit in WRENCHES:
        lines = _with_signal(chart, "tau", partial(_largest, signal=signal, part=part))
        if lines:
            figures.append(chart.plain(title, unit, lines))
    return figures


def squeeze_of_fastened(chart: Chart) -> list[Figure]:
    """Between two hands that are fastened; none elsewhere. Of those that press: their normals."""
    lines = _with_signal(chart, "hand_wrench", lambda t: _squeeze(t, len(_arms(chart))))
    return [chart.plain("Squeeze between the hands", "N", lines)] if lines else []


def torques(chart: Chart) -> list[Figure]:
    """One a motor, those of two equal arms side by side."""
    if not any("tau" in trace.signals for trace in chart.traces.values()):
        return []
    return [_torque(chart, i) for i in joint_order(chart.chain) if chart.any.effort[i] > 0.0]


def _torque(chart: Chart, i: int) -> Figure:
    joint, limit = chart.any.joints[i], float(chart.any.effort[i])
    what, unit = ("Force", "N") if chart.any.units[i] == "m" else ("Torque", "N m")
    lines = _with_signal(
        chart,
        "tau",
        lambda t: t.signals["tau"][:, t.joints.index(joint)] if joint in t.joints else None,
    )
    if not np.isfinite(limit):
        return chart.plain(f"{what} of {joint}", f"{unit}, no limit", lines)
    lower = curves.level(-limit, f"-{limit:.3g}", above=False)
    upper, allowed = curves.level(limit, f"{limit:.3g}"), (-limit, limit)
    shown = Window(-1.15 * limit, 1.15 * limit)
    return chart.figure(f"{what} of {joint}", unit, lines, shown, lower, upper, allowed=allowed)


def _with_signal(chart: Chart, signal: str, of: Callable[[Trace], Array | None]) -> Lines:
    return chart.lines(lambda trace: of(trace) if signal in trace.signals else None)


def _of_hand(chart: Chart, signal: str, i: int) -> Lines:
    return _with_signal(chart, "normal_force", lambda t: t.signals[signal][:, i])


def _arms(chart: Chart) -> list[str]:
    return [arm.name for arm in chart.chain.robot.arms]


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
    names = ("hand_point", "hand_wrench")
    points, wrenches = (trace.signals[name].reshape(trace.ticks, arms, -1) for name in names)
    forces = [squeezes(p, h) for p, h in zip(points, wrenches, strict=True)]
    return np.array(forces)[:, 0] if forces and all(len(pairs) == 1 for pairs in forces) else None


def _shares(trace: Trace) -> Array:
    """Each hand's share of the vertical force, NaN where there is none, shape (T, arms)."""
    lift = trace.signals["hand_wrench"].reshape(trace.ticks, -1, 6)[:, :, 2]
    total = lift.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(np.abs(total) > 1e-3, lift / total, np.nan), float)


def _up_to_one(chart: Chart, title: str, beyond: str, lines: Lines) -> Figure:
    """A share that must stay below 1, and what happens beyond."""
    lines = {name: np.minimum(line, MAX_USE) for name, line in lines.items()}
    level = curves.level(1.0, beyond)
    return chart.figure(title, "1", lines, Window(0.0, MAX_USE), level, allowed=(-1.0, 1.0))
