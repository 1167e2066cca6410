"""What all figures of a comparison share: which controllers, in which order, over which time."""

from collections.abc import Callable, Iterable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.execution.comparison import Comparison
from coopqp.model.closed_chain import ClosedChain
from coopqp.report import curves
from coopqp.report.curves import Figure, Json, Window, styles
from coopqp.trace import Trace

ALWAYS = slice(None)  # rows of a trace
Lines = dict[str, Array]  # values over time by controller


class Chart:
    """Lines of all controllers of a comparison over the whole run."""

    def __init__(self, comparison: Comparison) -> None:
        self.comparison, self.traces = comparison, comparison.traces
        # In drawing order: who keeps limits first, so that thin lines lie on top of thick ones.
        self.names = sorted(self.traces, key=lambda name: not self.traces[name].keeps_limits)
        self.styles = styles(self.traces)
        # The trace with most joints; grasps may differ between controllers.
        self.any = max(self.traces.values(), key=lambda trace: len(trace.joints))
        self.end = float(self.any.t[-1])

    @property
    def chain(self) -> ClosedChain:
        return self.comparison.scenario.held_by(self.any.controller).chain

    @cached_property
    def problems(self) -> dict[str, list[ControlProblem]]:
        """Each controller's problem in each phase, from where it then was."""
        scenario = self.comparison.scenario
        return {
            name: list(scenario.held_by(name).problems(trace.commanded.__getitem__))
            for name, trace in self.traces.items()
        }

    def instants(self, trace: Trace, count: int) -> list[NDArray[np.int64]]:
        """At most ``count`` rows of each phase, evenly spread, first and last among them."""
        firsts = self.comparison.scenario.first_ticks
        return [
            np.unique(np.linspace(a, b, min(b - a + 1, count)).round().astype(np.int64))
            for a, b in zip(firsts, [*firsts[1:], trace.ticks], strict=True)
        ]

    def lines(self, of: Callable[[Trace], Array | None]) -> Lines:
        """A quantity of every trace that has it."""
        return {k: y for k in self.names if (y := of(self.traces[k])) is not None}

    def layout(self, axis: Json, *levels: Json) -> Json:
        """Over the whole run, with a line where a phase begins."""
        phases = self.any.phases
        begins = [curves.upright(float(self.any.t[p.first]), p.name, after=True) for p in phases]
        return curves.layout(self.end, axis, *begins, *levels)

    def figure(
        self,
        title: str,
        unit: str,
        lines: Lines,
        shown: Window,
        *levels: Json,
        allowed: tuple[float, float] = (-np.inf, np.inf),
        log: bool = False,
        steps: bool = False,
        rows: slice = ALWAYS,
        extra: Iterable[Json] = (),
        notes: tuple[str, ...] = (),
    ) -> Figure:
        """Lines at some rows of the trace; hatched beyond the two heights that are allowed."""
        t = self.any.t[rows]
        hatched = [(shown.bottom, allowed[0]), (allowed[1], shown.top)]
        data = [curves.forbidden((0.0, self.end), a, b) for a, b in hatched if a < b]
        for name, y in lines.items():
            data.append(curves.curve(name, self.styles[name], t[: len(y)], y, steps=steps))
        axis = curves.logarithmic(shown) if log else curves.linear(shown)
        return Figure(
            title=title,
            unit=f"{unit}, log scale" if log else unit,
            data=[*data, *extra],
            layout=self.layout(axis, *levels),
            notes=notes,
        )

    def plain(self, title: str, unit: str, lines: Lines) -> Figure:
        """Lines over time on a linear scale that has a zero."""
        low = min(0.0, *(float(y.min(initial=0.0)) for y in lines.values()))
        high = max(1e-3, *(float(y.max(initial=0.0)) for y in lines.values()))
        return self.figure(title, unit, lines, Window(1.1 * low, 1.1 * high))
