"""The page of a study: one file, which works offline and is small whatever the study's size."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from string import Template

import coopqp
from coopqp.report import style as styles
from coopqp.report.files import write_one
from coopqp.report.page import asset, breakable, script_json, text
from coopqp.report.strict_json import finite
from coopqp.report.style import OTHER_DASHES, OTHER_WIDTHS, QP_WIDTH, Style
from coopqp.report.sweep.bins import Binned, worst_error, worst_rows
from coopqp.report.sweep.table import difference, points
from coopqp.study.sweep import Study, scenario_of_row
from coopqp.study.sweep.results import Columns
from coopqp.study.sweep.study import DONE
from coopqp.study.sweep.summary import ERROR, MARGIN, Line, Pair, Summary

NAME = "report.html"
ROWS = "rows"  # folder with the scenarios of the worst rows
COLORS = (
    styles.BLUE, styles.VERMILION, styles.GREEN, styles.PURPLE, styles.ORANGE, styles.SKY,
    styles.BLACK,
)  # fmt: skip
MAX_LIMITS = 12  # that are shown for each controller
TESTS = (
    '<p class="hint">Success: interval of Bonett and Price, exact test of McNemar. Numbers: '
    "median of the differences, with order statistics as its interval, and the sign test.</p>"
)
WORDS = ("blocked_<wbr>by", "broken")  # columns of names


def write(study: Study, columns: Columns, summary: Summary, folder: Path) -> Path:
    """Write ``report.html``, and the scenarios that it links to."""
    binned, error = Binned.of(study, columns), worst_error(columns)
    worst = [worst_rows(binned, error, k) for k in range(len(binned.controllers))]
    numbers = columns.numbers("row")
    for row in (row for rows in worst for row in rows):
        path = folder / ROWS / f"{int(numbers[row])}.yaml"
        if not path.exists():
            write_one(path, scenario_of_row(study, int(numbers[row]))[0])
    write_one(folder / NAME, _render(study, columns, summary, binned, worst))
    return folder / NAME


def _render(
    study: Study, columns: Columns, summary: Summary, binned: Binned, worst: Sequence[Sequence[int]]
) -> str:
    drawn = [_style(k) for k in range(len(binned.controllers))]
    measures = [name for name in columns.kinds if name.startswith(ERROR)]
    data = {
        "controllers": list(binned.controllers),
        "colors": [style.color for style in drawn],
        "dashes": [style.dash for style in drawn],
        "widths": [style.width for style in drawn],
        "axes": [axis.as_json() for axis in binned.axes],
        "maps": list(binned.maps()),
        "bands": {name: binned.bands(columns.numbers(name)) for name in (*measures, MARGIN)},
        "margin": MARGIN,
        "flows": binned.flows(),
    }
    return Template(asset("sweep/page.html")).substitute(
        title=text(study.name),
        version=text(coopqp.__version__),
        facts=_facts(study, summary),
        summary=_summary(summary),
        reasons=_reasons(summary),
        paired=_paired(summary.pairs, exact=summary.exact),
        blocked="".join(_limits(line) for line in summary.lines),
        legend="".join(
            f"<span>{style.swatch()} {breakable(name)}</span>"
            for style, name in zip(drawn, binned.controllers, strict=True)
        ),
        worst="".join(
            _worst(name, rows, [axis.name for axis in binned.axes], columns)
            for name, rows in zip(binned.controllers, worst, strict=True)
        ),
        data=script_json(finite(data)),
        css=asset("page.css") + asset("sweep/page.css"),
        js=asset("sweep/page.js"),
    )


def _style(k: int) -> Style:
    """The first is drawn below the others, each of these below the next."""
    dashes, widths = ("", *OTHER_DASHES), (QP_WIDTH, *OTHER_WIDTHS)
    color = COLORS[k % len(COLORS)]
    return Style(color, dashes[k % len(dashes)], widths[min(k, len(widths) - 1)])


def _facts(study: Study, summary: Summary) -> str:
    missing = study.rows - summary.rows
    facts = {
        "scenario": study.scenario.path.stem,
        "variants": f"{study.points.count:,}",
        "controllers": str(len(study.controllers)),
        "rows": f"{summary.rows:,}" + (f", {missing:,} still to come" if missing else ""),
        "seed": str(study.seed),
    }
    return " · ".join(f"{name} <b>{text(value)}</b>" for name, value in facts.items())


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of cells that are HTML already; the first of each row is its name."""
    first, *others = heads
    head = f'<th class="name">{first}</th>' + "".join(f"<th>{x}</th>" for x in others)
    body = "".join(
        f'<tr><th scope="row" class="name">{row[0]}</th>'
        + "".join(_cell(*pair) for pair in zip(others, row[1:], strict=True))
        + "</tr>"
        for row in rows
    )
    table = f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody>"
    return f'<div class="wide"><table class="summary result">{table}</table></div>'


def _cell(head: str, cell: str) -> str:
    """With its heading, for narrow pages without columns."""
    words = re.sub(r"<[^>]*>", " ", head.replace("<wbr>", ""))
    kind = ' class="words"' if head in WORDS else ""
    return f'<td{kind} data-heading="{words.strip()}">{cell}</td>'


def _summary(summary: Summary) -> str:
    names = list(dict.fromkeys(name for line in summary.lines for name in line.errors))
    errors = [f"{text(name)}<small>median, 95 %</small>" for name in names]
    share = "%" if summary.exact else "%, 95 % interval"
    heads = [
        "Controller", "done", "invalid", "failed", f"success<small>{share}</small>",
        "reached<small>%</small>", *errors, "least margin<small>median, 5 % [rad or m]</small>",
    ]  # fmt: skip
    lines = enumerate(summary.lines)
    return _table(heads, [_line(k, line, names, exact=summary.exact) for k, line in lines])


def _line(k: int, line: Line, names: Sequence[str], *, exact: bool) -> list[str]:
    states = [f"{line.states.get(state, 0):,}" for state in ("done", "invalid", "failed")]
    reached = f"{100.0 * line.reached.count / line.reached.of:.1f}" if line.reached.of else "-"
    quantiles = [*(line.errors[name] for name in names), line.margin]
    shown = [f"{a:.3g}, {b:.3g}" if a == a else "-" for a, b in quantiles]
    name = f'<i style="background:{COLORS[k % len(COLORS)]}"></i>{breakable(line.controller)}'
    return [name, *states, line.success.percent(1, exact=exact), reached, *shown]


def _reasons(summary: Summary) -> str:
    if not summary.reasons:
        return ""
    reasons = list(summary.reasons.items())[:MAX_LIMITS]
    items = "".join(f"<li><b>{count:,}</b> {text(reason)}</li>" for reason, count in reasons)
    more = len(summary.reasons) - MAX_LIMITS
    rest = f"<li>and {more} other reasons</li>" if more > 0 else ""
    done = any(line.states.get(DONE) for line in summary.lines)
    none = "" if done else '<p class="hint"><b>No row is done</b>, so there are no figures.</p>'
    return (
        f"{none}<details{'' if done else ' open'}><summary>Why rows are not done</summary>"
        f'<ul class="notes">{items}{rest}</ul></details>'
    )


def _paired(pairs: Sequence[Pair], *, exact: bool) -> str:
    if not pairs:
        return ""
    tested = "" if exact else ", p, 95 % interval"
    heads = [
        f"Less {breakable(pairs[0].reference)}, on the same variants", "both succeed", "only this",
        "only the reference", "neither", f"success<small>points{tested}</small>",
        *(f"{text(name)}<small>median{tested}</small>" for name in pairs[0].numbers),
    ]  # fmt: skip
    rows = []
    for p in pairs:
        counts = (p.success.both, p.success.only_one, p.success.only_reference, p.success.neither)
        numbers = (difference(number, exact=exact) for number in p.numbers.values())
        values = [points(p.success.difference, exact=exact), *numbers]
        lines = (f'<span class="lines">{v.replace(chr(10), "<br>")}</span>' for v in values)
        rows.append([breakable(p.controller), *(f"{n:,}" for n in counts), *lines])
    hint = "" if exact else TESTS
    return f"<section><h2>Controllers against each other</h2>{hint}{_table(heads, rows)}</section>"


def _limits(line: Line) -> str:
    """Bars: how often a limit has blocked the way, or was violated."""
    blocked = _bars("ends at it, short of the goal", line.blocked_by, line.success.of)
    beyond = _bars("goes beyond it", line.broken, line.success.of)
    bars = blocked + beyond or '<p class="hint">No limit in the way, none broken.</p>'
    return f"<div><h3>{breakable(line.controller)}</h3>{bars}</div>"


def _bars(title: str, counts: dict[str, int], of: int) -> str:
    if not counts:
        return ""
    width = 50.0 / max(counts.values())
    rows = "".join(
        f'<div class="limit"><span>{breakable(name)}</span>'
        f'<b style="width:{width * n:.1f}%"></b>{n:,} ({100.0 * n / of:.1f} %)</div>'
        for name, n in list(counts.items())[:MAX_LIMITS]
    )
    return f'<p class="hint">{title}</p>{rows}'


def _worst(name: str, rows: Sequence[int], varied: Sequence[str], columns: Columns) -> str:
    head = f"<h3>{breakable(name)}</h3>"
    if not rows:
        return f"{head}<p class='hint'>No row is done that does not succeed.</p>"
    errors = [x for x in columns.kinds if x.startswith(ERROR)]
    shown = [*varied, *errors, MARGIN, "blocked_by", "broken"]
    values = [_cells(columns, column, rows) for column in shown]
    numbers = columns.numbers("row")[list(rows)].astype(int)
    table = [
        [f'<a href="{ROWS}/{number}.yaml">{number}</a>', *(v[k] for v in values)]
        for k, number in enumerate(numbers)
    ]
    heads = ["row", *(breakable(column).replace(".", ".<wbr>") for column in shown)]
    return f'{head}<div class="worst">{_table(heads, table)}</div>'


def _cells(columns: Columns, name: str, rows: Sequence[int]) -> list[str]:
    if columns.kinds[name] == "string":
        codes, texts = columns.codes(name)
        return [text(texts[codes[row]]) if codes[row] >= 0 else "" for row in rows]
    numbers = columns.numbers(name)
    return [f"{numbers[row]:.4g}" for row in rows]
