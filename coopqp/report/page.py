"""One HTML page that holds everything, plotly.js included, and works offline."""

from __future__ import annotations

import html
import json
from pathlib import Path
from string import Template
from typing import Any

from plotly.offline import get_plotlyjs

from coopqp import __version__
from coopqp.comparison import Comparison
from coopqp.report import audit
from coopqp.report.cells import COLUMNS, Cell, Column, cells, facts
from coopqp.report.curves import Figure
from coopqp.report.figures.groups import Group, groups
from coopqp.report.how_to_read import how_to_read
from coopqp.report.scene.playback import scene
from coopqp.report.style import Style, styles

HERE = Path(__file__).parent
PANES_A_ROW = {1: 1, 2: 2, 4: 2}  # by the number of controllers; three for the others
WRAPPING = ("task_error", "limit", "speed", "margin", "motors")  # columns that may get narrow


def render(comparison: Comparison) -> str:
    """The report as one page."""
    looks, parts = styles(comparison.traces), groups(comparison)
    plots = [
        {"data": figure.data, "layout": figure.layout, "overTime": figure.over_time}
        for group in parts
        for figure in (*group.figures, *group.folded)
    ]
    return Template(_read("page.html")).substitute(
        title=text(comparison.scenario.name),
        description=text(comparison.scenario.description),
        version=text(__version__),
        facts=_facts(comparison),
        summary=_summary(comparison, looks),
        notes=_notes(comparison),
        how=_how(comparison),
        legend=_legend(looks),
        columns=PANES_A_ROW.get(len(looks), 3),
        panes="".join(_pane(name, style) for name, style in looks.items()),
        leading="".join(_group(group) for group in parts if group.leads),
        groups="".join(_group(group) for group in parts if not group.leads),
        audit=audit.rows(comparison.traces),
        audit_hidden="" if audit.audited(comparison.traces) else "hidden",
        scene=script_json(scene(comparison)),
        figures=script_json(plots),
        css=_read("page.css"),
        plotly=get_plotlyjs(),
        playback_js="".join(
            _read(f"scene/{name}.js") for name in ("surfaces", "camera", "playback")
        ),
        curves_js=_read("curves.js"),
    )


def text(value: str) -> str:
    """Text between tags."""
    return html.escape(value, quote=False)


def script_json(value: Any) -> str:
    """JSON inside a script tag, which ends at the first ``</script``, wherever that comes from."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def breakable(name: str) -> str:
    """A name as text that may be broken after its underscores."""
    return text(name).replace("_", "_<wbr>")


def _read(name: str) -> str:
    return (HERE / name).read_text(encoding="utf-8")


def _facts(comparison: Comparison) -> str:
    return " · ".join(f"{text(name)} <b>{text(value)}</b>" for name, value in facts(comparison))


def _summary(comparison: Comparison, looks: dict[str, Style]) -> str:
    heads = "".join(
        f'<th scope="col" title="{html.escape(column.help)}">{column.heading}'
        f"<small>{column.unit}</small></th>"
        for column in COLUMNS.values()
    )
    rows = "".join(_row(comparison, name, style) for name, style in looks.items())
    return (
        '<table class="summary result"><thead><tr><th scope="col" class="name">Controller</th>'
        f'<th scope="col" class="verdict">Verdict</th>{heads}</tr></thead>'
        f"<tbody>{rows}</tbody></table>"
    )


def _notes(comparison: Comparison) -> str:
    """What of the robot the limits do not bound."""
    return "".join(f'<p class="notes">{text(note)}</p>' for note in comparison.notes)


def _row(comparison: Comparison, name: str, style: Style) -> str:
    row = cells(comparison.traces[name], comparison.metrics[name])
    entries = "".join(
        _entry(row[key], column, wraps=key in WRAPPING) for key, column in COLUMNS.items()
    )
    return (
        f'<tr><th scope="row" class="name">{breakable(name)}{style.swatch()}</th>'
        f'<td class="verdict">{text(comparison.verdicts[name])}</td>{entries}</tr>'
    )


def _entry(cell: Cell, column: Column, *, wraps: bool) -> str:
    """The heading comes again where a page is too narrow for columns."""
    first, *more = map(text, cell.lines)
    lines = [f"{cell.symbol}&nbsp;{first}" if cell.symbol else first, *more]
    kind = {None: "", True: "bad", False: "good"}[cell.bad] + (" wraps" if wraps else "")
    heading = f"{column.heading}, {column.unit}" if column.unit else column.heading
    shown = "".join(f"<span>{line}</span>" for line in lines)
    return f'<td class="{kind}" data-heading="{heading}">{shown}</td>'


def _legend(looks: dict[str, Style]) -> str:
    return "".join(
        f'<label title="Hide or show"><input type="checkbox" checked autocomplete="off" '
        f'data-controller="{html.escape(name)}">{style.swatch()} {text(name)}</label>'
        for name, style in looks.items()
    )


def _pane(name: str, style: Style) -> str:
    return (
        f'<div class="pane"><h3>{style.swatch()}<span>{breakable(name)}</span></h3>'
        '<canvas></canvas><p class="readout"></p></div>'
    )


def _group(group: Group) -> str:
    hint = f'<p class="hint">{text(group.hint)}</p>' if group.hint else ""
    words = "".join(
        f'<p class="hint"><b>{text(word)}</b>: {text(said)}</p>'
        for word, said in group.words.items()
    )
    shown = f'<div class="grid">{"".join(map(_figure, group.figures))}</div>'
    folded = (
        f"<details><summary>{text(group.more)}</summary>"
        f'<div class="grid">{"".join(map(_figure, group.folded))}</div></details>'
    )
    return (
        f'<section><div class="lead"><h2>{text(group.title)}</h2>{hint}{words}</div>'
        f"{shown if group.figures else ''}{folded if group.folded else ''}</section>"
    )


def _figure(figure: Figure) -> str:
    notes = "".join(f'<span class="note">{text(note)}</span>' for note in figure.notes)
    about = f", {text(figure.about)}" if figure.about else ""
    kind = ' class="alone"' if figure.alone else ""
    return (
        f"<figure{kind}><figcaption>"
        f"{text(figure.title)}<small>{about} [{text(figure.unit)}]</small>{notes}"
        '</figcaption><div class="plot"></div></figure>'
    )


def _how(comparison: Comparison) -> str:
    """For readers who know neither the paper nor QPs."""
    return "".join(f"<p>{text(paragraph)}</p>" for paragraph in how_to_read(comparison))
