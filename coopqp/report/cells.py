"""The numbers of the summary: what is shown for each controller, and which of it is bad."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from coopqp.checked import Array
from coopqp.comparison import Comparison
from coopqp.hold import CLOSED_ORIENTATION, CLOSED_POSITION
from coopqp.limit import ROUNDING
from coopqp.overrun import broken, matters, outside
from coopqp.scenario.scenario import Scenario
from coopqp.trace import Trace

MOST_LINES = 4  # task errors in one cell


@dataclass(frozen=True)
class Column:
    """A column of the summary.

    Attributes:
        heading, unit: at its top.
        help: one sentence.
    """

    heading: str
    unit: str
    help: str


COLUMNS = {
    "reached": Column("Goal reached", "", "Every error ends within tolerance, forces for 0.2 s."),
    "task_error": Column("Task error", "at the end", "What is left of each task's error."),
    "limit": Column("Limit overrun", "", "How far the worst joint went beyond its limit."),
    "speed": Column("Speed overrun", "", "How far the worst speed went beyond its limit."),
    "margin": Column("Least margin", "", "Least distance of a joint to its limit; < 0 beyond."),
    "loop": Column("Loop error", "mm, mrad", "How far apart two arms carry the object, at worst."),
    "failed": Column("Failed ticks", "", "Ticks without a usable answer; the joints held still."),
    "tick": Column("Median tick", "µs", "Time from reading the joints to the verified command."),
    "solver": Column("Solver", "", "What solved the QPs, and ticks that the kernel left."),
}  # fmt: skip


@dataclass(frozen=True)
class Cell:
    """One entry.

    Attributes:
        lines: of text.
        bad: whether it speaks against the controller; None where neither good nor bad is meant.
    """

    lines: tuple[str, ...]
    bad: bool | None = None

    @property
    def symbol(self) -> str:
        """Says bad or good without colour."""
        return "" if self.bad is None else ("✗" if self.bad else "✓")


def cells(trace: Trace, metrics: Mapping[str, Any]) -> dict[str, Cell]:
    """The entries of one controller, by the keys of COLUMNS."""
    reached, loop = bool(metrics["reached"]), metrics["loop_error_max"]
    speed = metrics["velocity_violation_max"]
    opened = loop["position"] > CLOSED_POSITION or loop["orientation"] > CLOSED_ORIENTATION
    place = trace.units[_worst(outside(trace))]
    fastest = _worst(np.abs(trace.v) - trace.velocity)
    of_speed = f"{trace.units[fastest]}/s"
    gap = (f"{number(1e3 * loop['position'])} mm", f"{number(1e3 * loop['orientation'])} mrad")
    return {
        "reached": Cell(("yes" if reached else "no",), not reached),
        "task_error": _task_error(trace),
        "limit": _limit(trace, metrics["limit_violation_max"], place),
        "speed": Cell((_quantity(speed, of_speed),), matters(speed, of_speed)),
        "margin": Cell((_quantity(metrics["limit_margin_min"], place),)),
        "loop": Cell(gap, opened),
        "failed": _failed(metrics),
        "tick": Cell((f"{metrics['tick_us']['median']:.0f}" if metrics["tick_us"] else "-",)),
        "solver": Cell(_solver(metrics)),
    }


def _solver(metrics: Mapping[str, Any]) -> tuple[str, ...]:
    """What solved the QPs, and how many the kernel left."""
    engine, solver = metrics["engine"], metrics["solver"] or "none"
    if not engine or engine["name"] != "kernel":
        return (solver,)
    left = engine["ticks_in_python"]
    return ("kernel", f"{solver} in {left}") if left else ("kernel",)


def _limit(trace: Trace, overrun: float, unit: str) -> Cell:
    """Joints first, then all other limits of place; what a start is beyond is nobody's fault."""
    others = [found for found in broken(trace) if found.row.unit in ("m", "rad")]
    lines = [_quantity(overrun, unit)] if matters(overrun, unit) or not others else []
    for found in others:
        value, of = length(found.by, found.row.unit)
        lines.append(f"{found.row.owner}: {number(value)}\N{NO-BREAK SPACE}{of}")
    at_start = max(0.0, float(outside(trace)[0].max()))
    bad = any(found.farther for found in others) or matters(overrun - at_start, unit)
    some = at_start > ROUNDING or bool(others)
    return Cell(tuple(lines), None if some and not bad else bad)


def facts(comparison: Comparison) -> list[tuple[str, str]]:
    """What the runs have in common, as name and value."""
    scenario = comparison.scenario
    dropped = scenario.chain.loops.dropped
    limits = ", ".join(plugin_name(limit) for limit in scenario.limits) or "none"
    listed = [
        ("robot", scenario.robot_model.name),
        ("control period", f"{1e3 * scenario.dt:g} ms"),
        ("duration", f"{scenario.ticks * scenario.dt:g} s"),
        *([("phases", _phases(scenario))] if scenario.phases else []),
        ("drift correction κ", f"{scenario.drift_gain:g} 1/s ({_worst_gap(comparison)})"),
        ("QP solver", scenario.solver_name),
        ("limits of the QP", limits),
        ("plant", plugin_name(scenario.plant)),
    ]
    if dropped:
        listed.append(("redundant loop rows left out", ", ".join(dropped)))
    return listed


def _phases(scenario: Scenario) -> str:
    return ", ".join(
        f"{phase.name} ({' and '.join(phase.released)} released)" if phase.released else phase.name
        for phase in scenario.phases
    )


def plugin_name(plugin: object) -> str:
    """The name in YAML, which is the name of the file."""
    return type(plugin).__module__.rpartition(".")[2]


def length(value: float, unit: str) -> tuple[float, str]:
    """A value and its unit for people: metres become millimetres."""
    return (1e3 * value, "mm") if unit == "m" else (value, unit)


def number(value: float) -> str:
    """Three digits; rounding errors are shown as what they are."""
    if 0.0 < abs(value) <= ROUNDING:
        return "< 1e-9"
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"


def _worst(excess: Array) -> int:
    """The joint with the largest of the values, shape (T, n)."""
    return int(excess.max(axis=0, initial=-np.inf).argmax())


def _quantity(value: float, unit: str) -> str:
    """With its unit; nothing and infinity need none."""
    bare = value == 0.0 or math.isinf(value)
    return number(value) if bare else f"{number(value)} {unit}"


def _task_error(trace: Trace) -> Cell:
    ends = list(zip(trace.tasks, trace.final_error.tolist(), strict=True))
    if not ends:
        return Cell(("no task",), None)
    missed = any(not error <= task.tolerance for task, error in ends)
    lines = []
    if len(ends) > MOST_LINES:
        lines.append(f"worst of {len(ends)}:")
        # A NaN is worse than any number.
        ends = [max(ends, key=lambda e: math.inf if math.isnan(e[1]) else e[1] / e[0].tolerance)]
    for task, error in ends:
        value, unit = length(error, task.unit)
        name = f"{task.name}: " if len(trace.tasks) > 1 else ""
        lines.append(f"{name}{number(value)}\N{NO-BREAK SPACE}{unit}")
    return Cell(tuple(lines), missed)


def _failed(metrics: Mapping[str, Any]) -> Cell:
    failed, ticks, inaccurate = (
        metrics["failed_ticks"],
        metrics["ticks"],
        metrics["inaccurate_ticks"],
    )
    lines = [f"{failed} of {ticks}"]
    if inaccurate:
        lines.append(f"{inaccurate} inaccurate")
    return Cell(tuple(lines), failed > 0 or inaccurate > 0)


def _worst_gap(comparison: Comparison) -> str:
    errors = {name: metrics["loop_error_max"] for name, metrics in comparison.metrics.items()}
    worst = max(errors, key=lambda name: float(errors[name]["position"]))
    position, orientation = (1e3 * errors[worst][key] for key in ("position", "orientation"))
    return f"worst loop error {number(position)} mm, {number(orientation)} mrad with {worst}"
