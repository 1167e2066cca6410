"""One line for each kind of rollout, and all of them as a table of 80 columns."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from .contacts import OUTCOMES as CONTACT_OUTCOMES
from .contacts import ContactRollout
from .judgement import Rollout

Line = dict[str, Any]
"""Counts, sums and the worst of all rollouts of a kind."""

#: What is added up of all rollouts, and of what the worst is told.
ADDED = (
    *("frozen", "oscillating", "worse", "never_back", "saturated", "squeezed", "broken"),
    *("compared", "ticks", "relaxations", "inaccurate", "plain"),
)
WORST = ("position_excess", "velocity_excess", "loop_position", "loop_orientation", "force")
CONTACT_ADDED, CONTACT_WORST = ("broken", "ticks", "given_up"), ("cone", "torque")

#: Columns: how rollouts ended, and what must not be seen.
OUTCOMES = {
    "reached": "reached",
    "block-\ned": "blocked",
    "at\nrest": "at rest",
    "still\nmoves": "moving",
    "out": "recovering",
}
SIGNS = {
    "froze": "frozen",
    "oscil-\nlates": "oscillating",
    "worse": "worse",
    "never\nback": "never_back",
    "broken": "broken",
}
#: The same on plants with masses.
OUTCOMES_WITH_MASSES = {k: v for k, v in OUTCOMES.items() if v != "recovering"}
SIGNS_WITH_MASSES = {
    "satu-\nrated": "saturated",
    "squee-\nzed": "squeezed",
    **{k: v for k, v in SIGNS.items() if v not in ("never_back", "worse")},
}


def summarize(rollouts: Sequence[Rollout] | Sequence[ContactRollout]) -> list[Line]:
    """By robot and by what else was drawn, and all together."""
    kinds: dict[tuple[int, str], list[Any]] = {}
    for r in rollouts:
        for place, kind in enumerate(_kinds(r)):
            if kind:
                kinds.setdefault((place, kind), []).append(r)
    lines = [_line(kind, kinds[place, kind]) for place, kind in sorted(kinds)]
    return [*lines, _line("all", rollouts)]


def _kinds(r: Rollout | ContactRollout) -> tuple[str, ...]:
    """What a rollout counts as; empty where it was not drawn."""
    errors = r.errors and f"errors {r.errors}"
    if isinstance(r, ContactRollout):
        return r.robot, r.grasp, errors
    held = r.errors and ("firm" if r.grasp == "rigid" else "hinged")
    start, limits = r.start and f"start {r.start}", r.limits and f"{r.limits} limits"
    return r.robot, held, r.goal, start, limits, r.kappa and f"kappa {r.kappa}", errors


def _line(kind: str, rollouts: Sequence[Any]) -> Line:
    counts = Counter(r.outcome or "raised" for r in rollouts)
    line: Line = {"kind": kind, "count": len(rollouts), "outcomes": dict(sorted(counts.items()))}
    added, worst = ADDED, WORST
    if isinstance(rollouts[0], ContactRollout):
        added, worst = CONTACT_ADDED, CONTACT_WORST
        lost = Counter(r.cause or "no name" for r in rollouts if r.outcome == "lost")
        line["causes"] = dict(sorted(lost.items()))
    for name in added:
        values = (getattr(r, name) for r in rollouts)
        line[name] = sum(bool(x) if isinstance(x, tuple) else x for x in values)
    return {**line, **{name: max(getattr(r, name) for r in rollouts) for name in worst}}


def table(lines: Sequence[Line], plant: str = "kinematic") -> Table:
    """One row a kind of rollout."""
    masses = plant != "kinematic"
    title = f"random rollouts on {plant}" if masses else "random rollouts of the QP law"
    outcomes = OUTCOMES_WITH_MASSES if masses else OUTCOMES
    signs = SIGNS_WITH_MASSES if masses else SIGNS
    rows = (
        [*(x["outcomes"].get(name, 0) for name in outcomes.values()), *map(x.get, signs.values())]
        for x in lines
    )
    headings = ("runs", *outcomes, *signs)
    return _table(title, _worst(lines[-1], masses=masses), headings, lines, rows)


def contact_table(lines: Sequence[Line]) -> Table:
    """The same of hands that press."""
    worst = lines[-1]
    lost = ", ".join(f"{name} {count}" for name, count in worst["causes"].items()) or "nothing"
    caption = (
        f"lost by: {lost}\n"
        f"kept cones left by at most {worst['cone']:.1e} N, "
        f"motors' limits by {worst['torque']:.1e} N m\n"
        f"of {worst['ticks']} ticks {worst['given_up']} gave a cone up or had no answer"
    )
    rows = (
        [
            *(x["outcomes"].get(name, 0) for name in CONTACT_OUTCOMES),
            *(x["causes"].get(name, 0) for name in ("edge", "no name")),
            x["broken"],
        ]
        for x in lines
    )
    headings = ("number", *CONTACT_OUTCOMES, "edge", "no\nname", "broken")
    title = "random rollouts of hands that press, on rigid_body"
    return _table(title, caption, headings, lines, rows)


def fault_table(lines: Sequence[Line], plant: str) -> Table:
    """The same of rollouts with faults; they are not "held" firmly, but have kinds."""
    worst = lines[-1]
    caption = (
        f"worst violation: {worst['position_excess']:.1e} rad, "
        f"{worst['velocity_excess']:.1e} rad/s\n"
        f"of {worst['ticks']} ticks {worst['relaxations']} gave something up"
    )
    rows = ([*(x["outcomes"].get(o, 0) for o in ("silent", "spoken")), x["broken"]] for x in lines)
    headings = ("runs", "all\nOPTIMAL", "others\ntoo", "broken")
    return _table(f"random rollouts with faults on {plant}", caption, headings, lines, rows)


def _table(
    title: str,
    caption: str,
    headings: Iterable[str],
    lines: Sequence[Line],
    rows: Iterable[Iterable[Any]],
) -> Table:
    table = Table(
        title=title,
        title_justify="left",
        box=box.SIMPLE_HEAD,
        padding=0,
        show_edge=False,
        caption=Text(caption),
        caption_justify="left",
    )
    table.add_column("rollouts", no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    for line, row in zip(lines, rows, strict=True):
        table.add_row(line["kind"], str(line["count"]), *map(str, row))
    return table


def _worst(x: Line, *, masses: bool) -> str:
    """The worst of everything, a line each."""
    squeeze = f"\nlargest internal force at the end: {x['force']:.2f} N" if masses else ""
    return (
        f"worst violation: {x['position_excess']:.1e} rad, {x['velocity_excess']:.1e} rad/s\n"
        f"widest loop: {1e3 * x['loop_position']:.3f} mm, {1e3 * x['loop_orientation']:.2f} mrad\n"
        f"of {x['ticks']} ticks {x['relaxations']} gave something up, "
        f"{x['inaccurate']} were INACCURATE\n"
        f"the kernel left {x['plain']} to the plain law ({x['plain'] / max(x['ticks'], 1):.2%})\n"
        f"hard tasks that rest short, tried as soft ones: {x['compared']}{squeeze}"
    )
