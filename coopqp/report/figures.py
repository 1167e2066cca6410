"""The figures: each joint as in the paper's figures 4-8, then errors, margins, speeds and times."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterable, Mapping
from itertools import chain as joined

import numpy as np

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.comparison import Comparison
from coopqp.hold import CLOSED_ORIENTATION, CLOSED_POSITION
from coopqp.overrun import ROUNDING
from coopqp.report import curves
from coopqp.report.cells import length
from coopqp.report.curves import Figure, Json, Window
from coopqp.report.style import Style, styles
from coopqp.trace import Trace

FLOOR = 1e-12  # smallest value on log scales [m, rad]; less is drawn here
FREE_REACH = 2.0 * np.pi  # how far lines of a joint without limits may spread [rad or m]
MOST_SPEED = 3.0  # times the limit, beyond which speeds need a log scale
ONE_TWO_FIVE = [m * 10.0**e for e in range(-1, 7) for m in (1, 2, 5)]  # ticks of log scales
ALWAYS = slice(None)  # rows of a trace
SMALL = 1e-3  # smallest share of the speed limit on a log scale


class Figures:
    """All figures of a comparison.

    Args:
        comparison: from :func:`coopqp.compare`.
    """

    def __init__(self, comparison: Comparison) -> None:
        self._comparison = comparison
        self._traces = comparison.traces
        # Those that keep limits first, so that the thin lines lie on top of the thick ones.
        self._names = sorted(self._traces, key=lambda name: not self._traces[name].keeps_limits)
        self._styles = styles(self._traces)
        # Grasps may differ between controllers; the one with most joints shows them all.
        self._any = max(self._traces.values(), key=lambda trace: len(trace.joints))
        self._end = float(self._any.t[-1])

    def joints(self) -> list[Figure]:
        """One a joint; two arms of equal build side by side."""
        chain = self._chain
        return [self._joint(i, self._any.units[i]) for i in joint_order(chain)]

    @property
    def _chain(self) -> ClosedChain:
        """The chain of the trace with most joints."""
        scenario, name = self._comparison.scenario, self._any.controller
        return scenario.held_by(name).chain

    def torques(self) -> list[Figure]:
        """Torque of each motor and the wrenches on the object, where the plant tells them."""
        told = {name: t for name, t in self._traces.items() if "tau" in t.signals}
        if not told:
            return []
        motors = [i for i in joint_order(self._chain) if self._any.effort[i] > 0.0]
        figures = [self._torque(i, told) for i in motors]
        for signal, title in (
            ("cut_wrench", "Constraint force at the cut"),
            ("internal_wrench", "Internal force, largest of the hands"),
        ):
            lines = {
                name: np.linalg.norm(
                    told[name].signals[signal].reshape(told[name].ticks, -1, 6)[:, :, :3], axis=2
                ).max(axis=1)
                for name in self._names
                if name in told and signal in told[name].signals
            }
            if lines:
                figures.append(self._plain(title, "N", lines))
        return figures

    def _torque(self, i: int, told: Mapping[str, Trace]) -> Figure:
        joint, limit = self._any.joints[i], float(self._any.effort[i])
        what, unit = ("Force", "N") if self._any.units[i] == "m" else ("Torque", "N m")
        title = f"{what} of {joint}"
        lines = {
            name: told[name].signals["tau"][:, told[name].joints.index(joint)]
            for name in self._names
            if name in told and joint in told[name].joints
        }
        if not np.isfinite(limit):
            return self._plain(title, f"{unit}, no limit", lines)
        shown = Window(-1.15 * limit, 1.15 * limit)
        levels = [
            curves.level(-limit, f"-{limit:.3g}", above=False),
            curves.level(limit, f"{limit:.3g}"),
        ]
        return Figure(
            title=title,
            unit=unit,
            data=self._beyond_limits(shown, -limit, limit) + self._curves(lines),
            layout=self._layout(curves.linear(shown), *levels),
        )

    def _plain(self, title: str, unit: str, lines: dict[str, Array]) -> Figure:
        """Lines over time on a linear scale."""
        low = min(0.0, *(float(y.min(initial=0.0)) for y in lines.values()))
        high = max(1e-3, *(float(y.max(initial=0.0)) for y in lines.values()))
        return Figure(
            title=title,
            unit=unit,
            data=self._curves(lines),
            layout=self._layout(curves.linear(Window(1.1 * low, 1.1 * high))),
        )

    def others(self) -> list[Figure]:
        """Errors, margin, speed and time."""
        figures = [self._task_error(i) for i in range(len(self._any.tasks))]
        figures += [self._loop_position(), self._loop_orientation()]
        figures += [self._margin(unit) for unit in joint_units(self._traces.values())]
        return [*figures, self._speed(), self._ticks()]

    def _lines(self, of: Callable[[Trace], Array]) -> dict[str, Array]:
        return {name: of(self._traces[name]) for name in self._names}

    def _curves(
        self, lines: dict[str, Array], *, steps: bool = False, rows: slice = ALWAYS
    ) -> list[Json]:
        t = self._any.t[rows]
        return [
            curves.curve(name, self._styles[name], t[: len(y)], y, steps=steps)
            for name, y in lines.items()
        ]

    def _layout(self, axis: Json, *levels: Json) -> Json:
        """Over the whole run, with a line where a phase begins."""
        phases = self._any.phases
        begins = [curves.upright(float(self._any.t[p.first]), p.name, after=True) for p in phases]
        return curves.layout(self._end, axis, *begins, *levels)

    def _joint(self, i: int, unit: str) -> Figure:
        lower, upper = float(self._any.lower[i]), float(self._any.upper[i])
        joint = self._any.joints[i]
        lines = {
            name: self._traces[name].q[:, self._traces[name].joints.index(joint)]
            for name in self._names
            if joint in self._traces[name].joints
        }
        shown = joint_window(lower, upper, list(lines.values()))
        data = self._beyond_limits(shown, lower, upper) + self._curves(lines)
        for name, y in lines.items():
            data += self._marks(name, y, lower, upper, shown)
        levels = []
        if np.isfinite(lower):
            levels.append(curves.level(lower, f"lower limit {lower:.3g}", above=False))
        if np.isfinite(upper):
            levels.append(curves.level(upper, f"upper limit {upper:.3g}"))
        return Figure(
            title=self._any.joints[i],
            unit=unit if levels else f"{unit}, no limits",
            data=data,
            layout=self._layout(curves.linear(shown), *levels),
            notes=curves.off_chart(shown, lines, unit),
        )

    def _beyond_limits(self, shown: Window, lower: float, upper: float) -> list[Json]:
        span = (0.0, self._end)
        regions = []
        if shown.bottom < lower:
            regions.append(curves.forbidden(span, shown.bottom, lower))
        if upper < shown.top:
            regions.append(curves.forbidden(span, upper, shown.top))
        return regions

    def _marks(self, name: str, y: Array, lower: float, upper: float, shown: Window) -> list[Json]:
        """A cross where a joint first leaves its limits, a triangle where it leaves the chart."""
        t, style, marks = self._any.t, self._styles[name], []
        beyond = np.flatnonzero((y < lower - ROUNDING) | (y > upper + ROUNDING))
        if len(beyond):
            k = beyond[0]
            crossed = lower if y[k] < lower else upper
            marks.append(curves.markers(name, style, [(float(t[k]), crossed)], "x"))
        gone = np.flatnonzero((y < shown.bottom) | (y > shown.top))
        if len(gone):
            k = gone[0]
            up = y[k] > shown.top
            edge = (float(t[k]), shown.top if up else shown.bottom)
            marks.append(
                curves.markers(name, style, [edge], "triangle-up" if up else "triangle-down")
            )
        return marks

    def _task_error(self, i: int) -> Figure:
        task = self._any.tasks[i]
        scale, unit = length(1.0, task.unit)
        end = curves.upright(task.end, "reference arrives") if 0 < task.end < self._end else None
        return self._log(
            f"Error of task '{task.name}'",
            unit,
            self._lines(lambda trace: scale * trace.task_error[task.rows, i]),
            (scale * task.tolerance, "counts as reached"),
            scale * FLOOR,
            end,
            task.rows,
        )

    def _loop_position(self) -> Figure:
        return self._log(
            f"Loop error, position, κ = {self._any.kappa:g} 1/s",
            "mm",
            self._lines(lambda trace: 1e3 * trace.loop_position),
            (1e3 * CLOSED_POSITION, "counts as closed"),
            1e3 * FLOOR,
        )

    def _loop_orientation(self) -> Figure:
        return self._log(
            f"Loop error, orientation, κ = {self._any.kappa:g} 1/s",
            "mrad",
            self._lines(lambda trace: 1e3 * trace.loop_orientation),
            (1e3 * CLOSED_ORIENTATION, "counts as closed"),
            1e3 * FLOOR,
        )

    def _log(
        self,
        title: str,
        unit: str,
        lines: dict[str, Array],
        bound: tuple[float, str],
        floor: float,
        extra: Json | None = None,
        rows: slice = ALWAYS,
    ) -> Figure:
        """Errors over time on a log scale, with the bound below which they are good."""
        lines = {name: np.maximum(y, floor) for name, y in lines.items()}
        shown = curves.log_window(list(lines.values()), floor, bound[0])
        levels = [curves.level(bound[0], f"{bound[1]}: {bound[0]:.3g}", log=True)]
        levels += [extra] if extra else []
        return Figure(
            title=title,
            unit=f"{unit}, log scale",
            data=self._curves(lines, rows=rows),
            layout=self._layout(curves.logarithmic(shown), *levels),
        )

    def _margin(self, unit: str) -> Figure:
        lines = {
            name: margin(self._traces[name], unit)
            for name in self._names
            if unit in self._traces[name].units
        }
        nearest = "sliding joint" if unit == "m" else "joint"
        best = max(0.1, *(float(y[np.isfinite(y)].max(initial=0.0)) for y in lines.values()))
        shown = curves.window(0.0, best, list(lines.values()), best)
        shown = Window(min(shown.bottom, -0.15 * best), shown.top)
        return Figure(
            title=f"Margin of the {nearest} nearest to its limit",
            unit=f"{unit}, negative beyond the limit",
            data=self._beyond_limits(shown, 0.0, np.inf) + self._curves(lines),
            layout=self._layout(curves.linear(shown), curves.level(0.0, "limit", above=False)),
            notes=curves.off_chart(shown, lines, unit),
        )

    def _speed(self) -> Figure:
        lines = self._lines(speed_share)
        fastest = max(float(y.max(initial=0.0)) for y in lines.values())
        log = fastest > MOST_SPEED
        shown = Window(0.0, max(1.25, 1.1 * fastest))
        if log:
            shown = Window(SMALL, 3.0 * fastest)
            lines = {name: np.maximum(y, SMALL) for name, y in lines.items()}
        axis = curves.logarithmic(shown) if log else curves.linear(shown)
        return Figure(
            title="Speed of the fastest joint",
            unit=f"share of its limit{', log scale' if log else ''}",
            data=self._beyond_limits(shown, -np.inf, 1.0) + self._curves(lines, steps=True),
            layout=self._layout(axis, curves.level(1.0, "speed limit", log=log)),
        )

    def _ticks(self) -> Figure:
        """Quartiles as a box, 1 and 99 percent as whiskers, the slowest tick as a cross."""
        boxes = [self._box(name, self._styles[name]) for name in reversed(self._names)]
        layout = curves.layout(self._end, {"type": "category", "automargin": True})
        times = np.concatenate([self._traces[name].tick_us for name in self._names])
        low, high = np.log10(times.min() / 1.3), np.log10(times.max() * 1.3)
        layout["xaxis"] |= {"type": "log", "range": [float(low), float(high)]}
        layout["xaxis"] |= {"tickvals": ONE_TWO_FIVE, "ticktext": [f"{v:g}" for v in ONE_TWO_FIVE]}
        layout["xaxis"] |= {"title": {"text": "time [µs]", "standoff": 4}}
        layout["height"] = max(curves.HEIGHT, 70 + 36 * len(boxes))
        return Figure(
            title="Time of a tick",
            unit="µs, log scale; box: half of all ticks, whiskers: 98 percent, cross: the slowest",
            data=list(joined(*boxes)),
            layout=layout,
        )

    def _box(self, name: str, style: Style) -> list[Json]:
        us = self._traces[name].tick_us
        p1, q1, median, q3, p99 = np.percentile(us, [1, 25, 50, 75, 99]).tolist()
        label = html.escape(name)
        box = {
            "type": "box",
            "orientation": "h",
            "legendgroup": name,
            "y": [label],
            "lowerfence": [p1],
            "q1": [q1],
            "median": [median],
            "q3": [q3],
            "upperfence": [p99],
            "line": {"color": style.color, "width": 1.6},
            "hoverinfo": "x",
        }
        slowest = curves.markers(name, style, [(float(us.max()), 0.0)], "x")
        return [box, slowest | {"y": [label]}]


def joint_units(traces: Iterable[Trace]) -> tuple[str, ...]:
    """The units that the joints of some trace have, "rad" before "m"."""
    return tuple(sorted({unit for trace in traces for unit in trace.units}, reverse=True))


def margin(trace: Trace, unit: str) -> Array:
    """Distance of the joint nearest to its limit, at each instant, shape (T + 1,) [unit].

    Args:
        trace: with one joint at least that has this unit.
        unit: "rad" or "m"; joints with another one do not count.
    """
    counts = np.array(trace.units) == unit
    room = np.minimum(trace.q - trace.lower, trace.upper - trace.q)
    least: Array = room[:, counts].min(axis=1)
    return least


def speed_share(trace: Trace) -> Array:
    """Speed of the fastest joint over its limit, at each tick, shape (T,)."""
    share: Array = (np.abs(trace.v) / trace.velocity).max(axis=1)
    return share


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


def joint_order(chain: ClosedChain) -> list[int]:
    """Indices of the joints as they are shown: two arms of equal length alternate."""
    model, arms = chain.model, []
    for frame in chain.frames:
        support = model.supports[model.frames[frame].parentJoint]
        arms.append([j - 1 for j in support if j > 0])
    if len(arms) == 2 and len(arms[0]) == len(arms[1]):
        found = list(joined(*zip(*arms, strict=True)))
    else:
        found = list(joined(*arms))
    # A joint that carries both arms is on both lists; one that carries none is on no list.
    return list(dict.fromkeys([*found, *range(chain.n)]))
