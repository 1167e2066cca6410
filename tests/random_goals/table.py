"""What ``python -m tests.random_goals`` prints; fits 80 columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich import box
from rich.table import Table

from coopqp.study.sweep.summary import Difference
from random_goals.summary import Line

#: Goals beyond the limits cannot be reached inside them, so that "all three" says nothing there.
COLUMNS = {
    "inside": {"reached": "reached", "inside": "inside", "loop": "loop", "all three": "whole"},
    "beyond": {"reached": "reached", "inside": "inside", "loop": "loop", "nearest": "nearest"},
}
CLASSES = {
    ("inside", "away"): "goals held inside the limits by some configuration, start away",
    ("inside", "near"): "goals held inside the limits by some configuration, start near",
    ("beyond", "away"): "goals for which none was found, start away",
    ("beyond", "near"): "goals for which none was found, start near",
}


def tables(lines: Sequence[Line]) -> Iterator[Table]:
    """One a class over all robots, two of what differs from the first law, and two by robot."""
    for (goal, start), title in CLASSES.items():
        chosen = [x for x in lines if (x.robot, x.goal, x.start) == ("all", goal, start)]
        columns = COLUMNS[goal]
        table = _table(f"{title}: {chosen[0].whole.of}", list(columns))
        for x in chosen:
            table.add_row(x.law, *(getattr(x, name).percent(0) for name in columns.values()))
        yield table
    yield _against(lines, "inside", "all three")
    yield _against(lines, "beyond", "nearest")
    yield _by_robot(lines, "inside", "whole", "inside goals by robot: all three")
    yield _by_robot(lines, "beyond", "nearest", "goals beyond by robot: nearest")


def _against(lines: Sequence[Line], goal: str, what: str) -> Table:
    """Each law less the first on the same goals."""
    chosen = [x for x in lines if (x.robot, x.goal) == ("all", goal) and x.start != "all"]
    reference, *others = dict.fromkeys(x.law for x in chosen)
    title = f"{goal} goals, {what}, less {reference} on the same goals: McNemar's p"
    starts = list(dict.fromkeys(x.start for x in chosen))
    table = _table(title, [f"start {start}" for start in starts])
    for law in others:
        table.add_row(law, *(_points(x.against.difference) for x in chosen if x.law == law))
    return table


def _points(found: Difference) -> str:
    """Such as "-12 -18 to -7, p 0.0003", in per cent of the goals."""
    if not found.of:
        return "-"
    value, low, high = (100.0 * x for x in (found.value, found.low, found.high))
    return f"{value:+.0f} {low:+.0f} to {high:+.0f}, {found.chance}"


def _by_robot(lines: Sequence[Line], goal: str, what: str, title: str) -> Table:
    chosen = [x for x in lines if x.goal == goal and x.start == "all" and x.robot != "all"]
    counts = {x.robot: getattr(x, what).of for x in chosen}
    table = _table(title, [f"{robot}\nof {count}" for robot, count in counts.items()])
    for law in dict.fromkeys(x.law for x in chosen):
        table.add_row(law, *(getattr(x, what).percent(0) for x in chosen if x.law == law))
    return table


def _table(title: str, headings: Sequence[str]) -> Table:
    table = Table(
        title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=0, show_edge=False
    )
    table.add_column("%, 95 % interval", no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    return table
