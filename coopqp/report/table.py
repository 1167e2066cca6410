"""Tables for the terminal: comparisons, replayed ticks, the stress test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich import box
from rich.table import Table
from rich.text import Text

from coopqp.comparison import Comparison
from coopqp.errors import one_line
from coopqp.report.cells import Cell, cells
from coopqp.study.stress import Summary
from coopqp.study.stress.contacts import ContactSummary
from coopqp.study.tick_record import Replay, TickRecord

#: Headings of what is shown, narrow enough to leave half of 100 columns to the verdicts.
SHOWN = {
    "reached": "goal\nreached",
    "limit": "beyond\nlimit",
    "loop": "loop\nerror",
    "failed": "failed\nticks",
    "tick": "tick\n[µs]",
}
#: Columns of the stress test: how rollouts ended, and what must not be seen.
OUTCOMES = {
    "reached": "reached",
    "block-\ned": "blocked",
    "at\nrest": "at rest",
    "still\nmoves": "moving",
    "out": "recovering",
}
SIGNS = {
    "froze": "frozen",
    "swing": "swinging",
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
#: Columns of the stress test of hands that press.
CONTACT_OUTCOMES = ("held", "lost", "refused")
COLORS = {None: "", True: "red", False: "green"}


def summary(comparison: Comparison) -> Table:
    """One row a controller; fits 100 columns."""
    # A Text shows what it is given; a plain string would read [brackets] in names as markup.
    table = Table(
        title=Text(one_line(comparison.scenario.name), style="bold"),
        title_justify="left",
        box=box.HORIZONTALS,
        show_lines=True,
    )
    table.add_column("controller and verdict", ratio=1, overflow="fold")
    for heading in SHOWN.values():
        table.add_column(Text(heading), justify="right", no_wrap=True)
    for name, trace in comparison.traces.items():
        row = cells(trace, comparison.metrics[name])
        said = Text.assemble((name, "bold"), "\n", comparison.verdicts[name])
        table.add_row(said, *(_entry(row[key]) for key in SHOWN))
    return table


def _entry(cell: Cell) -> Text:
    first, *more = cell.lines
    return Text("\n".join([f"{cell.symbol} {first}".strip(), *more]), COLORS[cell.bad])


def replay(record: TickRecord, answers: Mapping[str, Replay]) -> Table:
    """One row a solver."""
    table = Table(title=f"{record.scenario}, {record.controller}, tick {record.tick}")
    for heading in ("solver", "status", "primal residual", "dual residual", "off the saved answer"):
        table.add_column(heading)
    for name, answer in answers.items():
        numbers = (answer.primal_residual, answer.dual_residual, answer.difference)
        table.add_row(name, answer.status.value, *(f"{number:.2g}" for number in numbers))
    return table


def stress(lines: Sequence[Summary], plant: str = "kinematic") -> Table:
    """One row a kind of rollout; fits 80 columns."""
    masses = plant != "kinematic"
    table = Table(
        title=f"random rollouts on {plant}" if masses else "random rollouts of the QP law",
        title_justify="left",
        box=box.SIMPLE_HEAD,
        padding=0,
        show_edge=False,
        caption=_worst(lines[-1], masses=masses),
        caption_justify="left",
    )
    outcomes = OUTCOMES_WITH_MASSES if masses else OUTCOMES
    signs = SIGNS_WITH_MASSES if masses else SIGNS
    table.add_column("rollouts", no_wrap=True)
    for heading in ("runs", *outcomes, *signs):
        table.add_column(heading, justify="right", no_wrap=True)
    for x in lines:
        counts = (x.outcomes.get(outcome, 0) for outcome in outcomes.values())
        seen = (getattr(x, sign) for sign in signs.values())
        table.add_row(x.kind, *(str(count) for count in (x.count, *counts, *seen)))
    return table


def contacts(lines: Sequence[ContactSummary]) -> Table:
    """One row a kind of rollout of hands that press; fits 80 columns."""
    worst, causes = lines[-1], lines[-1].causes
    lost = ", ".join(f"{name} {count}" for name, count in causes.items()) or "nothing"
    table = Table(
        title="random rollouts of hands that press, on rigid_body",
        title_justify="left",
        box=box.SIMPLE_HEAD,
        padding=0,
        show_edge=False,
        caption=Text(
            f"lost by: {lost}\n"
            f"kept cones left by at most {worst.cone:.1e} N, "
            f"motors' limits by {worst.torque:.1e} N m\n"
            f"of {worst.ticks} ticks {worst.given_up} gave a cone up or had no answer"
        ),
        caption_justify="left",
    )
    table.add_column("rollouts", no_wrap=True)
    for heading in ("number", *CONTACT_OUTCOMES, "edge", "no\nname", "broken"):
        table.add_column(heading, justify="right", no_wrap=True)
    for x in lines:
        ended = [x.outcomes.get(outcome, 0) for outcome in CONTACT_OUTCOMES]
        named = [x.causes.get("edge", 0), x.causes.get("no name", 0)]
        table.add_row(x.kind, *(str(count) for count in (x.count, *ended, *named, x.broken)))
    return table


def _worst(x: Summary, *, masses: bool) -> Text:
    """The worst of everything, a line each."""
    squeeze = f"\nlargest internal force at the end: {x.force:.2f} N" if masses else ""
    return Text(
        f"worst overrun: {x.position_excess:.1e} rad, {x.velocity_excess:.1e} rad/s\n"
        f"widest loop: {1e3 * x.loop_position:.3f} mm, {1e3 * x.loop_orientation:.2f} mrad\n"
        f"of {x.ticks} ticks {x.fallbacks} gave something up, {x.inaccurate} were INACCURATE\n"
        f"the kernel left {x.plain} to the plain law ({x.plain / max(x.ticks, 1):.2%})\n"
        f"hard tasks that rest short, tried as soft ones: {x.compared}{squeeze}"
    )
