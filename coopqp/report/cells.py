"""The numbers of the summary: what is shown for each controller, and which of it is bad."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from coopqp.assessment import Assessment, assess
from coopqp.assessment.limits import beyond
from coopqp.assessment.thresholds import OUTSIDE, matters
from coopqp.base.spec import Array, type_name
from coopqp.execution.comparison import Comparison
from coopqp.trace import Trace

NBSP = "\N{NO-BREAK SPACE}"
MAX_LINES = 4  # task errors in one cell
SYMBOLS = {None: "", True: "✗ ", False: "✓ "}  # say without colour whether a cell is bad
LANGUAGES = ("C++", f"C++ +{NBSP}Python rows", "Python")  # that ticks run in


@dataclass(frozen=True)
class Column:
    """A column of the summary: what stands at its top, and a sentence."""

    heading: str
    unit: str
    help: str


COLUMNS = {
    "reached": Column("Goal reached", "", "Every error ends within tolerance, forces for 0.2 s."),
    "task_error": Column("Task error", "at the end", "What is left of each task's error."),
    "limit": Column("Limit violation", "", "How far the worst joint went beyond its limit; "
                    "then other limits that were broken, each in its own unit."),
    "speed": Column("Speed violation", "", "How far the worst speed went beyond its limit."),
    "acceleration": Column("Acceleration", "at most", "Beside what the loop for robots allows: "
                           "from rest to full speed in 0.2 s, else 10 rad/s2. A joint_acceleration "
                           "in limits keeps it down."),
    "margin": Column("Least margin", "", "Least distance of a joint to its limit; < 0 beyond."),
    "loop": Column("Loop error", "mm, mrad", "How far apart two arms carry the object, at worst."),
    "motors": Column("Motors", "saturated", "Share of the ticks in which one is at its limit."),
    "failed": Column("Failed ticks", "", "Ticks without a usable answer; the joints held still."),
    "tick": Column("Median tick", "µs", "From reading the joints to the verified command, and in "
                   "which language: C++ and Python are no measure of each other. Python rows: the "
                   "kernel decides, Python fills rows of limits or tasks, in the time behind it."),
}  # fmt: skip


@dataclass(frozen=True)
class Cell:
    """One entry, or ``each`` of its lines: bad if against the controller, None if neither."""

    lines: tuple[str, ...]
    bad: bool | None = None
    each: tuple[bool, ...] = ()


def cells(trace: Trace, metrics: Mapping[str, Any], runs: Iterable[Trace] = ()) -> dict[str, Cell]:
    """The entries of one controller of several runs, by the keys of COLUMNS."""
    found, speed = assess(trace), metrics["velocity_violation_max"]
    too_fast = np.abs(trace.v) - trace.velocity
    worst = (int(by.max(axis=0, initial=-np.inf).argmax()) for by in (beyond(trace), too_fast))
    place, of_speed = (trace.units[joint] for joint in worst)
    apart = tuple(number(1e3 * size) for size in found.loop)
    is_open = None if found.held is False else not found.loop_closed
    failed, inaccurate = metrics["failed_ticks"], metrics["inaccurate_ticks"]
    more = [f"{inaccurate} inaccurate"] if inaccurate else []
    return {
        "reached": Cell(("yes" if found.reached else "no",), not found.reached),
        "task_error": _task_error(found),
        "limit": _limit(found, metrics["limit_violation_max"], place),
        "speed": Cell((_quantity(speed, f"{of_speed}/s"),), bool(found.speeds)),
        "acceleration": _acceleration(found),
        "margin": Cell((_quantity(metrics["limit_margin_min"], place),)),
        "loop": Cell((f"{apart[0]}{NBSP}mm", f"{apart[1]}{NBSP}mrad"), is_open),
        "motors": _motors(found),
        "failed": Cell((f"{failed} of {metrics['ticks']}", *more), failed > 0 or inaccurate > 0),
        "tick": _tick(trace, metrics["engine"], any(other.compiled.any() for other in runs)),
    }


def tick_times_in(trace: Trace) -> dict[str, Array]:
    """Times of the ticks [us] by the language that they ran in; empty where some were not timed."""
    us, compiled = trace.tick_us, trace.compiled
    alone, with_rows, python = LANGUAGES
    times = {with_rows if trace.rows_in_python else alone: us[compiled], python: us[~compiled]}
    return {k: of for k, of in times.items() if len(of)} if np.isfinite(us).all() else {}


def _tick(trace: Trace, engine: dict[str, Any] | None, beside_compiled: bool) -> Cell:
    """The median in the language of most ticks; none of Python beside those of compiled laws."""
    times = sorted(tick_times_in(trace).items(), key=lambda item: -len(item[1]))
    if not times:
        return Cell(("-",))
    (language, us), *others = times
    more = (f"{len(of)} in {other}" for other, of in others)
    cost = engine["rows_us"] if engine and language == LANGUAGES[1] else None
    rows = "" if cost is None else f":{NBSP}{f'{cost:.0f}' if cost >= 0.5 else '<1'}"
    shown = "-" if beside_compiled and language == LANGUAGES[2] else f"{np.median(us):.0f}"
    return Cell((shown, *f"{language}{rows}".split(" ", 1), *more))


def _solvers(comparison: Comparison) -> str:
    """What solved the QPs; by controller where that differs."""
    used = {name: solver for name, m in comparison.metrics.items() if (solver := _solver(m))}
    kinds = dict.fromkeys(used.values())
    if len(kinds) < 2:
        return next(iter(kinds), "none")
    of = {kind: ", ".join(name for name, own in used.items() if own == kind) for kind in kinds}
    return "; ".join(f"{solver} ({names})" for solver, names in of.items())


def _solver(metrics: Mapping[str, Any]) -> str:
    """The kernel, which has one of its own, or the scenario's; empty without a QP."""
    engine, solver = metrics["engine"], metrics["solver"] or ""
    left = engine["ticks_in_python"] if engine else 0
    if not engine or engine["name"] != "kernel" or left == metrics["ticks"]:
        return str(solver)
    return f"kernel, {solver} in {left} ticks" if left else "kernel"


def _limit(assessed: Assessment, violation: float, unit: str) -> Cell:
    """Joints first, then all other limits; what a start is beyond is nobody's fault."""
    others = assessed.limits
    lines = [_quantity(violation, unit)] if matters(violation, unit) or not others else []
    for found in others:
        value, of = length(found.by, found.row.unit)
        lines.append(f"{found.row.owner}: {number(value)}{NBSP}{of}")
    bad = any(found.farther for found in (*assessed.joints, *others))
    outside = bool((beyond(assessed.trace)[0] > OUTSIDE).any())
    return Cell(tuple(lines), None if (outside or others) and not bad else bad)


def _acceleration(found: Assessment) -> Cell:
    """The worst joint's, and how many times what the loop for robots allows."""
    if (worst := found.acceleration) is None:
        return Cell(("-",))
    times = f"{number(worst.value / worst.allowed)} x allowed"
    return Cell((f"{number(worst.value)}{NBSP}{worst.unit}", times), worst.exceeds)


def _motors(found: Assessment) -> Cell:
    if "tau" not in found.trace.signals:
        return Cell(("-",))
    shares = list(found.saturated.items())
    lines = [f"{joint}: {100.0 * share:.0f} %" for joint, share in shares[:MAX_LINES]]
    lines += [f"{len(shares) - MAX_LINES} more"] if len(shares) > MAX_LINES else []
    return Cell((*lines,) or ("0 %",), bool(shares))


def facts(comparison: Comparison) -> list[tuple[str, str]]:
    """What the runs have in common, as name and value."""
    scenario = comparison.scenario
    limits = ", ".join(type_name(type(limit)) for limit in scenario.limits) or "none"
    released = {phase.name: " and ".join(phase.released) for phase in scenario.phases}
    phases = (name + (f" ({arms} released)" if arms else "") for name, arms in released.items())
    listed = [
        ("robot", scenario.robot_model.name),
        ("control period", f"{1e3 * scenario.dt:g} ms"),
        ("duration", f"{scenario.ticks * scenario.dt:g} s"),
        ("phases", ", ".join(phases)),
        ("Baumgarte gain κ", f"{scenario.drift_gain:g} 1/s ({_worst_loop_error(comparison)})"),
        ("QP solver", _solvers(comparison)),
        ("limits of the QP", limits),
        ("plant", type_name(type(scenario.plant))),
        ("redundant loop rows left out", ", ".join(scenario.chain.loops.dropped)),
    ]
    return [(name, value) for name, value in listed if value]


def length(value: float, unit: str) -> tuple[float, str]:
    """A value and its unit for people: metres become millimetres."""
    return (1e3 * value, "mm") if unit == "m" else (value, unit)


def number(value: float) -> str:
    """Three digits; rounding errors are shown as what they are."""
    if 0.0 < abs(value) <= OUTSIDE:
        return "< 1e-9"
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"


def _quantity(value: float, unit: str) -> str:
    """With its unit; nothing and infinity need none."""
    bare = value == 0.0 or math.isinf(value)
    return number(value) if bare else f"{number(value)} {unit}"


def _task_error(found: Assessment) -> Cell:
    ends, lines = found.tasks, []
    if not ends:
        return Cell(("no task",), None)
    if len(ends) > MAX_LINES:
        lines.append(f"worst of {len(ends)}:")
        ends = (max(ends, key=lambda task: task.share),)
    for task in ends:
        value, unit = length(task.error, task.unit)
        name = f"{task.name}: " if len(found.tasks) > 1 else ""
        lines.append(f"{name}{number(value)}{NBSP}{unit}")
    each = tuple(not task.arrives for task in ends) if len(lines) == len(ends) > 1 else ()
    return Cell(tuple(lines), bool(found.missed), each)


def _worst_loop_error(comparison: Comparison) -> str:
    errors = {name: metrics["loop_error_max"] for name, metrics in comparison.metrics.items()}
    worst = max(errors, key=lambda name: float(errors[name]["position"]))
    position, orientation = (1e3 * errors[worst][key] for key in ("position", "orientation"))
    return f"worst loop error {number(position)} mm, {number(orientation)} mrad with {worst}"
