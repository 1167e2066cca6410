"""What ``coopqp statistics`` prints; fits 80 columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich import box
from rich.table import Table

from coopqp.study.statistics.summary import Line, Share

COLUMNS = {
    "reached": "reached",
    "inside": "inside",
    "loop": "loop",
    "whole": "all\nthree",
    "nearest": "nearest",
}
CLASSES = {
    ("inside", "away"): "goals that can be held inside the limits, start away from them",
    ("inside", "near"): "goals that can be held inside the limits, start near one",
    ("beyond", "away"): "goals that were not found inside the limits, start away from them",
    ("beyond", "near"): "goals that were not found inside the limits, start near one",
}


def tables(lines: Sequence[Line]) -> Iterator[Table]:
    """One a class over all robots, then two by robot."""
    for (goal, start), title in CLASSES.items():
        of_class = [x for x in lines if (x.robot, x.goal, x.start) == ("all", goal, start)]
        table = _table(f"{title} ({of_class[0].whole.of})", list(COLUMNS.values()))
        for x in of_class:
            table.add_row(x.law, *(percent(getattr(x, name)) for name in COLUMNS))
        yield table
    yield _by_robot(lines, "inside", "whole", "inside goals: all three, by robot")
    yield _by_robot(lines, "beyond", "nearest", "goals beyond: nearest, by robot")


def _by_robot(lines: Sequence[Line], goal: str, what: str, title: str) -> Table:
    chosen = [x for x in lines if x.goal == goal and x.start == "all" and x.robot != "all"]
    counts = {x.robot: getattr(x, what).of for x in chosen}
    table = _table(title, [f"{robot}\n({count})" for robot, count in counts.items()])
    for law in dict.fromkeys(x.law for x in chosen):
        table.add_row(law, *(percent(getattr(x, what)) for x in chosen if x.law == law))
    return table


def _table(title: str, headings: Sequence[str]) -> Table:
    table = Table(
        title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=0, show_edge=False
    )
    table.add_column("law, % (95 %)", no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def percent(share: Share) -> str:
    """Such as "93 (89-96)"; a dash where there was none."""
    if not share.of:
        return "-"
    part = 100.0 * share.count / share.of
    return f"{part:.0f} ({100 * share.low:.0f}-{100 * share.high:.0f})"
