"""What all figures of a comparison share: who is drawn, in which order, over which time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.comparison import Comparison
from coopqp.controller import ControlProblem
from coopqp.report import curves
from coopqp.report.curves import Figure, Json, Window
from coopqp.report.style import styles
from coopqp.trace import Trace

ALWAYS = slice(None)  # rows of a trace


class Chart:
    """Lines of all controllers of a comparison over the whole run.

    Args:
        comparison: from :func:`coopqp.compare`.

    Attributes:
        comparison: the same.
        traces: by controller.
        names: of the controllers in the order in which they are drawn.
        styles: of each controller's line.
        any: the trace with most joints; grasps may differ between controllers.
        end: of the run [s].
    """

    def __init__(self, comparison: Comparison) -> None:
        self.comparison, self.traces = comparison, comparison.traces
        # Those that keep limits first, so that the thin lines lie on top of the thick ones.
        self.names = sorted(self.traces, key=lambda name: not self.traces[name].keeps_limits)
        self.styles = styles(self.traces)
        self.any = max(self.traces.values(), key=lambda trace: len(trace.joints))
        self.end = float(self.any.t[-1])
        self._problems: dict[str, list[ControlProblem]] = {}

    @property
    def chain(self) -> ClosedChain:
        """The chain of the trace with most joints."""
        return self.comparison.scenario.held_by(self.any.controller).chain

    def problems(self, name: str) -> list[ControlProblem]:
        """What a controller had to do in each phase, from where it then was."""
        if name not in self._problems:
            decided = self.traces[name].commanded
            scenario = self.comparison.scenario.held_by(name)
            self._problems[name] = list(scenario.problems(lambda first: decided[first]))
        return self._problems[name]

    def lines(self, of: Callable[[Trace], Array]) -> dict[str, Array]:
        """Something of every trace."""
        return {name: of(self.traces[name]) for name in self.names}

    def curves(
        self, lines: dict[str, Array], *, steps: bool = False, rows: slice = ALWAYS
    ) -> list[Json]:
        """The controllers' lines; ``rows`` are those of the trace that they have."""
        t = self.any.t[rows]
        return [
            curves.curve(name, self.styles[name], t[: len(y)], y, steps=steps)
            for name, y in lines.items()
        ]

    def layout(self, axis: Json, *levels: Json) -> Json:
        """Over the whole run, with a line where a phase begins."""
        phases = self.any.phases
        begins = [curves.upright(float(self.any.t[p.first]), p.name, after=True) for p in phases]
        return curves.layout(self.end, axis, *begins, *levels)

    def beyond_limits(self, shown: Window, lower: float, upper: float) -> list[Json]:
        """Hatch what is shown below one height and above another."""
        span, regions = (0.0, self.end), []
        if shown.bottom < lower:
            regions.append(curves.forbidden(span, shown.bottom, lower))
        if upper < shown.top:
            regions.append(curves.forbidden(span, upper, shown.top))
        return regions

    def plain(self, title: str, unit: str, lines: dict[str, Array], about: str = "") -> Figure:
        """Lines over time on a linear scale that has a zero."""
        low = min(0.0, *(float(y.min(initial=0.0)) for y in lines.values()))
        high = max(1e-3, *(float(y.max(initial=0.0)) for y in lines.values()))
        return Figure(
            title=title,
            unit=unit,
            about=about,
            data=self.curves(lines),
            layout=self.layout(curves.linear(Window(1.1 * low, 1.1 * high))),
        )

    def log(
        self,
        title: str,
        unit: str,
        lines: dict[str, Array],
        floor: float,
        *levels: Json,
        good: tuple[float, str],
        rows: slice = ALWAYS,
    ) -> Figure:
        """Errors over time on a log scale, with the bound below which they are good."""
        lines = {name: np.maximum(y, floor) for name, y in lines.items()}
        shown = curves.log_window(list(lines.values()), floor, good[0])
        bound = curves.level(good[0], f"{good[1]}: {good[0]:.3g}", log=True)
        return Figure(
            title=title,
            unit=f"{unit}, log scale",
            data=self.curves(lines, rows=rows),
            layout=self.layout(curves.logarithmic(shown), bound, *levels),
        )
