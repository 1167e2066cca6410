"""Joints over time between their limits, as in the paper's figures 4-8; limits; forces."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain as joined

import numpy as np

from coopqp.assessment.assessment import accelerations
from coopqp.assessment.limits import beyond
from coopqp.assessment.thresholds import OUTSIDE
from coopqp.base.spec import Array
from coopqp.closed_loop.forces import squeezes
from coopqp.metrics.limit_criterion import limit_criterion
from coopqp.model.closed_chain import ClosedChain
from coopqp.report import curves
from coopqp.report.curves import Chart, Figure, Json, Lines, Window
from coopqp.trace import Trace

FREE_REACH = 2.0 * np.pi  # shown range of a joint without limits, at most [rad or m]
NEAR = 0.02  # of the range: a joint this near to a limit is shown first
MAX_FIRST = 3  # rows of joints that are shown first
PAPER_ROBOT, PAPER_JOINTS = "nao_t14", [f"q{k} of the right arm" for k in range(1, 6)]
PAPER_FIGURES = {x: f"{x}, Fig. {k} of the paper" for k, x in enumerate(PAPER_JOINTS, start=4)}
LOG_SHARE = 3.0  # times the limit, beyond which shares need a log scale
MIN_SHARE = 1e-3  # on a log scale
MAX_CRITERION = 3.0  # times the lowest line's maximum, beyond which lines are cut off
MAX_USE = 1.5  # more friction or pad than this is cut off
#: Signals of wrenches, which part of them, and title and unit of its norm.
WRENCHES = (
    ("internal_wrench", slice(3), "Internal force, largest of the hands", "N"),
    ("internal_wrench", slice(3, 6), "Internal moment, largest of the hands", "N m"),
    ("cut_wrench", slice(3), "Constraint force at the cut", "N"),
)


Row = dict[int, str]
"""Joints side by side, one that arms share or the same one of two, each with its caption."""


def joint_figures(chart: Chart) -> tuple[list[Figure], list[Figure], list[Figure]]:
    """The joint that comes nearest to a limit, others that come near one, and the rest.

    Each with those beside it; the nearest is the first of its row. Where none comes near, the first
    list is empty and the second has the nearest.
    """
    rows = joint_rows(chart.chain)
    margins = [[_min_margin(chart, i) for i in row] for row in rows]
    nearest = np.argsort([*map(min, margins)], kind="stable")[:MAX_FIRST].tolist()
    near = [n for n in nearest if min(margins[n]) < NEAR]
    decisive, others = near[:1], near[1:] or nearest[: not near]
    rest = [n for n in range(len(rows)) if n not in (*decisive, *others)]
    parts = (decisive, sorted(others), rest)
    first, second, third = (_figures(chart, [rows[n] for n in part]) for part in parts)
    for n in decisive:
        first.insert(0, first.pop(int(np.argmin(margins[n]))))
    return first, second, third


def joint_rows(chain: ClosedChain) -> list[Row]:
    """The joints as they are shown: those that arms share first, two equal arms side by side."""
    model, arms = chain.model, []
    for frame in chain.frames[chain.standing :]:
        arms.append([j - 1 for j in model.supports[model.frames[frame].parentJoint] if j > 0])
    counts = {j: sum(j in arm for arm in arms) for j in joined(*arms)}
    own = [[j for j in arm if counts[j] == 1] for arm in arms]
    names = [arm.name for arm in chain.arms[chain.standing :]]
    captions = {
        j: f"{'passive joint' if j in chain.passive else f'q{k}'} of the {name} arm"
        for name, joints in zip(names, own, strict=True)
        for k, j in enumerate(joints, start=1)
    }
    for j, count in counts.items():
        if count > 1:
            carried = [name for name, arm in zip(names, arms, strict=True) if j in arm]
            captions[j] = f"carries {' and '.join(carried)}"
    alike = len(own) == 2 and len(own[0]) == len(own[1])
    shared = [(j,) for j, count in counts.items() if count > 1]
    rows = zip(*own, strict=True) if alike else ((j,) for j in joined(*own))
    idle = [(j,) for j in range(chain.n) if j not in counts]
    return [{j: captions.get(j, "") for j in row} for row in joined(shared, rows, idle)]


def _min_margin(chart: Chart, i: int) -> float:
    """Smallest margin of a joint under any controller, over its range; inf without limits."""
    lower, upper = chart.any.lower[i], chart.any.upper[i]
    lines = _joint_lines(chart, i).values()
    margins = [float(np.minimum(q - lower, upper - q).min()) for q in lines]
    smallest, span = min(margins, default=np.inf), upper - lower
    return smallest / span if np.isfinite(span) and span > 0.0 else smallest


def _figures(chart: Chart, rows: list[Row]) -> list[Figure]:
    known = PAPER_FIGURES if chart.comparison.scenario.robot_model.name == PAPER_ROBOT else {}
    every = [(i, about, len(row) == 1) for row in rows for i, about in row.items()]
    return [replace(_joint(chart, i), about=known.get(x, x), alone=one) for i, x, one in every]


def _joint(chart: Chart, i: int) -> Figure:
    unit = chart.any.units[i]
    lower, upper = limits = float(chart.any.lower[i]), float(chart.any.upper[i])
    lines = _joint_lines(chart, i)
    shown = joint_window(lower, upper, list(lines.values()))
    return chart.figure(
        chart.any.joints[i],
        unit if np.isfinite(limits).any() else f"{unit}, no limits",
        lines,
        shown,
        lower=(lower, f"lower limit {lower:.3g}"),
        upper=(upper, f"upper limit {upper:.3g}"),
        extra=joined(*(_marks(chart, name, y, limits, shown) for name, y in lines.items())),
        noted=unit,
    )


def _joint_lines(chart: Chart, i: int) -> Lines:
    """A joint's positions, shape (T + 1,), in every trace that has it."""
    name = chart.any.joints[i]
    return chart.lines(lambda t: t.q[:, t.joints.index(name)] if name in t.joints else None)


def _marks(chart: Chart, name: str, y: Array, limits: Sequence[float], shown: Window) -> list[Json]:
    """A cross where a joint first leaves its limits, a triangle where it leaves the chart."""
    (lower, upper), marks = limits, []
    bounds = (
        (lower - OUTSIDE, upper + OUTSIDE, limits, ("x", "x")),
        (shown.bottom, shown.top, (shown.bottom, shown.top), ("triangle-down", "triangle-up")),
    )
    for low, high, heights, symbols in bounds:
        for k in np.flatnonzero((y < low) | (y > high))[:1]:
            up = bool(y[k] > high)
            t, style = float(chart.any.t[k]), chart.styles[name]
            marks.append(curves.mark(name, style, t, heights[up], symbols[up]))
    return marks


def joint_window(lower: float, upper: float, lines: list[Array]) -> Window:
    """Show the limits, or the calmest line where one is missing, and one more range at most."""
    calm = min(lines, key=np.ptp)
    low = lower if np.isfinite(lower) else min(float(calm.min()), upper)
    high = upper if np.isfinite(upper) else max(float(calm.max()), low)
    limited = np.isfinite(lower) and np.isfinite(upper)
    if not limited:
        low, high = low - 0.05, high + 0.05
    return curves.window(low, high, lines, high - low if limited else FREE_REACH)


def limit_figures(chart: Chart) -> list[Figure]:
    """Margin by unit, criterion, speed and acceleration."""
    speed = chart.lines(lambda t: (np.abs(t.v) / t.velocity).max(axis=1))
    acceleration = chart.lines(lambda t: accelerations(t).share.max(axis=1, initial=0.0))
    what = "what the loop for robots allows"
    return [
        *(_margin(chart, unit) for unit in joint_units(chart.traces.values())),
        *_criterion(chart),
        _shares(chart, "Speed of the fastest joint", "its limit", speed, "speed limit"),
        _shares(chart, "Largest acceleration of a joint", what, acceleration, "allowed"),
    ]


def joint_units(traces: Iterable[Trace]) -> tuple[str, ...]:
    """The units of the joints, "rad" before "m"."""
    return tuple(sorted({unit for trace in traces for unit in trace.units}, reverse=True))


def margin(trace: Trace, unit: str) -> Array:
    """Smallest margin of the joints with a unit, shape (T + 1,) [unit]."""
    counts = np.array(trace.units) == unit
    return np.asarray(0.0 - beyond(trace)[:, counts].max(axis=1))


def _margin(chart: Chart, unit: str) -> Figure:
    lines = chart.lines(lambda trace: margin(trace, unit) if unit in trace.units else None)
    best = max(0.1, *(float(y[np.isfinite(y)].max(initial=0.0)) for y in lines.values()))
    shown = curves.window(0.0, best, list(lines.values()), best)
    shown = Window(min(shown.bottom, -0.15 * best), shown.top)
    title = f"Margin of the {'sliding joint' if unit == 'm' else 'joint'} nearest to its limit"
    about = f"{unit}, negative beyond the limit"
    return chart.figure(title, about, lines, shown, lower=(0.0, "limit"), noted=unit)


def _criterion(chart: Chart) -> list[Figure]:
    """The criterion of the paper's null-space term; none where no joint has a range."""
    lines = chart.lines(lambda trace: limit_criterion(trace)["quadratic"])
    if not any(y.any() for y in lines.values()):
        return []
    top = MAX_CRITERION * min(float(y.max()) for y in lines.values())
    shown = Window(0.0, curves.window(0.0, top / MAX_CRITERION, list(lines.values()), top).top)
    unit = "1, smaller is farther from limits on the whole"
    return [chart.figure("Joint-limit criterion φ", unit, lines, shown, noted="")]


def _shares(chart: Chart, title: str, what: str, lines: Lines, bound: str) -> Figure:
    """Shares of a bound at each tick; on a log scale where some are far beyond it."""
    high = max(float(y.max(initial=0.0)) for y in lines.values())
    log = high > LOG_SHARE
    shown = Window(MIN_SHARE, 3.0 * high) if log else Window(0.0, max(1.25, 1.1 * high))
    lines = {name: np.maximum(y, MIN_SHARE) for name, y in lines.items()} if log else lines
    unit = f"share of {what}"
    return chart.figure(title, unit, lines, shown, upper=(1.0, bound), log=log, steps=True)


def hands(chart: Chart) -> list[Figure]:
    """Normal force, use of friction and of pads by hand, slip; none where no hand presses."""
    if not any("normal_force" in trace.signals for trace in chart.traces.values()):
        return []
    figures, signals = [], ("normal_force", "friction_use", "edge_use")
    for i, arm in enumerate(_arms(chart)):
        normal, use, edge = (_of_hand(chart, signal, i) for signal in signals)
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
    shares = _with_signal(chart, "hand_wrench", lambda t: _load(t) if t.ticks else None)
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
    order = joined(*joint_rows(chart.chain))
    return [_torque(chart, i) for i in order if chart.any.effort[i] > 0.0]


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
    lower, upper = (-limit, f"-{limit:.3g}"), (limit, f"{limit:.3g}")
    shown = Window(-1.15 * limit, 1.15 * limit)
    return chart.figure(f"{what} of {joint}", unit, lines, shown, lower=lower, upper=upper)


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
    return np.asarray(np.linalg.norm(wrenches, axis=2).max(axis=1))


def _squeeze(trace: Trace, arms: int) -> Array | None:
    """Of two hands that are fastened, shape (T,) [N]."""
    if "normal_force" in trace.signals:
        return None
    names = ("hand_point", "hand_wrench")
    points, wrenches = (trace.signals[name].reshape(trace.ticks, arms, -1) for name in names)
    forces = [squeezes(p, h) for p, h in zip(points, wrenches, strict=True)]
    return np.array(forces)[:, 0] if forces and all(len(pairs) == 1 for pairs in forces) else None


def _load(trace: Trace) -> Array:
    """Each hand's share of the vertical force, NaN where there is none, shape (T, arms)."""
    lift = trace.signals["hand_wrench"].reshape(trace.ticks, -1, 6)[:, :, 2]
    total = lift.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(np.abs(total) > 1e-3, lift / total, np.nan), float)


def _up_to_one(chart: Chart, title: str, beyond: str, lines: Lines) -> Figure:
    """A share that must stay below 1, and what happens beyond."""
    lines = {name: np.minimum(line, MAX_USE) for name, line in lines.items()}
    return chart.figure(title, "1", lines, Window(0.0, MAX_USE), upper=(1.0, beyond))
