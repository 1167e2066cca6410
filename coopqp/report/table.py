"""What commands print: comparisons, replayed ticks, explanations, the stress test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

from rich import box
from rich.table import Table
from rich.text import Text

from coopqp.comparison import Comparison
from coopqp.errors import one_line
from coopqp.report import strict_json
from coopqp.report.cells import Cell, cells
from coopqp.study.explanation import RunExplanation, explain
from coopqp.study.replay import Replay
from coopqp.study.stress import Summary
from coopqp.study.stress.contacts import ContactSummary
from coopqp.study.tick_record import TickRecord

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
    outcomes = OUTCOMES_WITH_MASSES if masses else OUTCOMES
    signs = SIGNS_WITH_MASSES if masses else SIGNS
    return _rollouts(
        f"random rollouts on {plant}" if masses else "random rollouts of the QP law",
        _worst(lines[-1], masses=masses),
        ("runs", *outcomes, *signs),
        {
            x.kind: (
                x.count,
                *(x.outcomes.get(outcome, 0) for outcome in outcomes.values()),
                *(getattr(x, sign) for sign in signs.values()),
            )
            for x in lines
        },
    )


def contacts(lines: Sequence[ContactSummary]) -> Table:
    """One row a kind of rollout of hands that press; fits 80 columns."""
    worst, causes = lines[-1], lines[-1].causes
    lost = ", ".join(f"{name} {count}" for name, count in causes.items()) or "nothing"
    return _rollouts(
        "random rollouts of hands that press, on rigid_body",
        Text(
            f"lost by: {lost}\n"
            f"kept cones left by at most {worst.cone:.1e} N, "
            f"motors' limits by {worst.torque:.1e} N m\n"
            f"of {worst.ticks} ticks {worst.given_up} gave a cone up or had no answer"
        ),
        ("number", *CONTACT_OUTCOMES, "edge", "no\nname", "broken"),
        {
            x.kind: (
                x.count,
                *(x.outcomes.get(outcome, 0) for outcome in CONTACT_OUTCOMES),
                *(x.causes.get(cause, 0) for cause in ("edge", "no name")),
                x.broken,
            )
            for x in lines
        },
    )


def _rollouts(
    title: str, caption: Text, headings: Sequence[str], counts: Mapping[str, Sequence[int]]
) -> Table:
    """Counts by kind of rollout."""
    table = Table(
        title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=0, show_edge=False,
        caption=caption, caption_justify="left",
    )  # fmt: skip
    table.add_column("rollouts", no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    for kind, row in counts.items():
        table.add_row(kind, *map(str, row))
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


def run_text(found: RunExplanation, name: str, *, as_json: bool) -> str:
    """Why a run missed its goal."""
    if as_json:
        return strict_json.text(found.as_json())
    of = f", phase {found.phase}" if found.phase else ""
    return f"{name}, {found.controller}{of}:\n{found.sentence}."


def tick_text(record: TickRecord, *, as_json: bool) -> str:
    """Why a tick fell short."""
    found = explain(record)
    if as_json:
        return strict_json.text({"tick": record.tick, "status": record.status, **asdict(found)})
    said = f"{found.sentence[0].upper()}{found.sentence[1:]}."
    return f"{record.scenario}, {record.controller}, tick {record.tick} ({record.status}):\n{said}"
