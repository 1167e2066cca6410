"""One HTML page that holds everything, plotly.js included, and works offline."""

import html
import json
import os
import re
import shlex
from collections.abc import Iterable, Iterator, Sequence
from itertools import zip_longest
from pathlib import Path
from string import Template
from typing import Any

from plotly.offline import get_plotlyjs

from coopqp import __version__
from coopqp.assessment.assessment import FORCES
from coopqp.assessment.thresholds import ACCELERATION_UNLIMITED, SPEED_UP
from coopqp.base.spec import type_name
from coopqp.execution.comparison import Comparison
from coopqp.limits import JointAcceleration
from coopqp.report import audit
from coopqp.report.cells import COLUMNS, SYMBOLS, Cell, Column, cells, facts
from coopqp.report.curves import Figure, Style, styles
from coopqp.report.figures.groups import Group, groups
from coopqp.report.scene.playback import scene

HERE = Path(__file__).parent
KINDS = {None: "", True: "bad", False: "good"}  # of cells, by whether they are bad
PANES_A_ROW = {1: 1, 2: 2, 4: 2}  # by the number of controllers; three for the others
FEW = 4  # columns that narrow pages have room for
NAMES = ("blocked_<wbr>by", "broken")  # columns of names, in studies
#: Columns that may get narrow, so that the verdict does not.
WRAPPING = ("task_error", "limit", "speed", "acceleration", "margin", "loop", "motors", "tick")


def render(comparison: Comparison, folder: Path | None = None) -> str:
    """The report as one page; in a folder it says how to have a missed goal explained."""
    looks, parts = styles(comparison.traces), groups(comparison)
    figures = [figure for group in parts for figure in (*group.figures, *group.folded)]
    plots = [{"data": x.data, "layout": x.layout, "overTime": x.over_time} for x in figures]
    return Template(asset("page.html")).substitute(
        title=text(comparison.scenario.name),
        description=text(comparison.scenario.description),
        version=text(__version__),
        facts=" · ".join(f"{text(name)} <b>{text(value)}</b>" for name, value in facts(comparison)),
        summary=_summary(comparison, looks, folder),
        notes="".join(f'<p class="notes">{text(note)}</p>' for note in comparison.notes),
        how="".join(f"<p>{text(paragraph)}</p>" for paragraph in how_to_read(comparison)),
        legend=_legend(looks),
        columns=PANES_A_ROW.get(len(looks), 3),
        panes="".join(_pane(name, style) for name, style in looks.items()),
        leading="".join(_group(group) for group in parts if group.leads),
        groups="".join(_group(group) for group in parts if not group.leads),
        audit=audit.rows(comparison.traces),
        audit_hidden="" if audit.audited(comparison.traces) else "hidden",
        scene=script_json(scene(comparison)),
        figures=script_json(plots),
        css=asset("page.css"),
        plotly=get_plotlyjs(),
        playback_js="".join(asset(f"scene/{x}.js") for x in ("surfaces", "camera", "playback")),
        curves_js=asset("curves.js"),
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


def asset(name: str) -> str:
    """A text file of this folder."""
    return (HERE / name).read_text(encoding="utf-8")


def html_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of cells that are HTML already; the first of each row is its name.

    On narrow pages each row of many columns is a card, where every cell has its heading.
    """
    first, *others = heads
    words = [re.sub(r"<[^>]*>", " ", head.replace("<wbr>", "")).strip() for head in others]
    kinds = [' class="words"' if head in NAMES else "" for head in others]
    tags = [f'<td{x} data-heading="{word}">' for x, word in zip(kinds, words, strict=True)]
    head = f'<th class="name">{first}</th>' + "".join(f"<th>{x}</th>" for x in others)
    body = "".join(
        f'<tr><th scope="row" class="name">{name}</th>'
        + "".join(f"{tag}{cell}</td>" for tag, cell in zip(tags, cells, strict=True))
        + "</tr>"
        for name, *cells in rows
    )
    kind = "summary result" if len(heads) > FEW else "summary"
    rows_of_table = f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody>"
    return f'<div class="wide"><table class="{kind}">{rows_of_table}</table></div>'


def _summary(comparison: Comparison, looks: dict[str, Style], folder: Path | None) -> str:
    heads = "".join(
        f'<th scope="col" title="{html.escape(column.help)}">{column.heading}'
        f"<small>{column.unit}</small></th>"
        for column in COLUMNS.values()
    )
    rows = "".join(_row(comparison, name, style, folder) for name, style in looks.items())
    return (
        '<table class="summary result"><thead><tr><th scope="col" class="name">Controller</th>'
        f'<th scope="col" class="verdict">Verdict</th>{heads}</tr></thead>'
        f"<tbody>{rows}</tbody></table>"
    )


def _row(comparison: Comparison, name: str, style: Style, folder: Path | None) -> str:
    traces = comparison.traces
    row = cells(traces[name], comparison.metrics[name], traces.values())
    entries = "".join(_entry(row[k], column, wraps=k in WRAPPING) for k, column in COLUMNS.items())
    missed = comparison.scenario.source and row["reached"].bad
    why = _explained_by(comparison, name, folder) if folder and missed else ""
    return (
        f'<tr><th scope="row" class="name">{breakable(name)}{style.swatch()}</th>'
        f'<td class="verdict">{text(comparison.verdicts[name])}{why}</td>{entries}</tr>'
    )


def _explained_by(comparison: Comparison, name: str, folder: Path) -> str:
    words = ["coopqp", "explain", str(folder), "--controller", name]
    own = zip(("--tasks", "--plugins"), comparison.scenario.catalog.folders, strict=True)
    words += [word for key, paths in own for path in paths for word in (key, os.path.relpath(path))]
    return f'<small class="why">Why? <code>{text(shlex.join(words))}</code></small>'


def _entry(cell: Cell, column: Column, *, wraps: bool) -> str:
    """With its heading, for narrow pages without columns."""
    of_line = {bad: f' class="{kind}"' if cell.each else "" for bad, kind in KINDS.items()}
    shown = "".join(
        f"<span{of_line[bad]}>{SYMBOLS[bad].replace(' ', '&nbsp;')}{text(line)}</span>"
        for bad, line in zip_longest(cell.each or (cell.bad,), cell.lines)
    )
    kind = ("" if cell.each else KINDS[cell.bad]) + (" wraps" if wraps else "")
    heading = f"{column.heading}, {column.unit}" if column.unit else column.heading
    return f'<td class="{kind}" data-heading="{heading}">{shown}</td>'


def _legend(looks: dict[str, Style]) -> str:
    return "".join(
        f'<label title="Hide or show"><input type="checkbox" checked autocomplete="off" '
        f'data-controller="{html.escape(name)}">{style.swatch()} {text(name)}</label>'
        for name, style in looks.items()
    )


def _pane(name: str, style: Style) -> str:
    title = f"<h3>{style.swatch()}<span>{breakable(name)}</span></h3>"
    return f'<div class="pane">{title}<canvas></canvas><p class="readout"></p></div>'


def _group(group: Group) -> str:
    hint = f'<p class="hint">{text(group.hint)}</p>' if group.hint else ""
    terms = ((text(term), text(meaning)) for term, meaning in group.terms.items())
    words = "".join(f'<p class="hint"><b>{term}</b>: {meaning}</p>' for term, meaning in terms)
    both = ("".join(map(_figure, figures)) for figures in (group.figures, group.folded))
    shown, folded = (f'<div class="grid">{x}</div>' if x else "" for x in both)
    if folded:
        folded = f"<details><summary>{text(group.more)}</summary>{folded}</details>"
    lead = f'<div class="lead"><h2>{text(group.title)}</h2>{hint}{words}</div>'
    return f"<section>{lead}{shown}{folded}</section>"


def _figure(figure: Figure) -> str:
    notes = "".join(f'<span class="note">{text(note)}</span>' for note in figure.notes)
    about = f", {text(figure.about)}" if figure.about else ""
    kind = ' class="alone"' if figure.alone else ""
    caption = f"{text(figure.title)}<small>{about} [{text(figure.unit)}]</small>{notes}"
    return f'<figure{kind}><figcaption>{caption}</figcaption><div class="plot"></div></figure>'


def how_to_read(comparison: Comparison) -> Iterator[str]:
    """Paragraphs: the closed loop, what forces are in the run, and what the laws do."""
    yield (
        "Joints of arms that hold one object are not free: whatever they do, every hand has to "
        "stay where it holds the object. This condition is the closed loop. The loop error is "
        "what steps of finite length leave; Baumgarte stabilisation with the gain κ pulls it back."
    )
    advice = "joint_acceleration in the scenario's limits bounds it here as well"
    if any(isinstance(limit, JointAcceleration) for limit in comparison.scenario.limits):
        advice = "the scenario's joint_acceleration bounds it"
    yield (
        "The acceleration is how fast the speed of a joint changes from one tick to the next. "
        "The loop for robots, OnlineLoop, allows as much as brings a joint from rest to its full "
        f"speed in {SPEED_UP:g} s, or {ACCELERATION_UNLIMITED:g} rad/s2 without a speed limit; "
        f"{advice}. The time of a tick has to stay below the control period, "
        f"{1e3 * comparison.scenario.dt:g} ms."
    )
    of_forces = list(_forces(comparison))
    yield from of_forces
    laws = [type_name(type(law)) for law in comparison.scenario.controllers.values()]
    if not of_forces or any("pseudoinverse" in law for law in laws):
        yield from _laws(comparison)


def _forces(comparison: Comparison) -> Iterator[str]:
    """What the hands do to each other; nothing where the scenario asks for none of it."""
    scenario, traces = comparison.scenario, comparison.traces.values()
    if any("normal_force" in trace.signals for trace in traces):
        yield (
            "Nothing fastens the object to hands that press. They hold it between them, and "
            "friction bears what goes along their faces: at most the coefficient of friction times "
            "the normal force, so that more is borne the harder they press. Beyond that the object "
            "slips. A pad also bears torques, by pressing more on one side than on the other; with "
            "all of the pressure on an edge it tips."
        )
    if any(task.unit in FORCES for trace in traces for task in trace.tasks):
        yield (
            "The squeeze is the force with which two hands press on each other through the object. "
            "It moves nothing, so that it has to be asked for, and measured, as a force."
        )
    if getattr(scenario.plant, "spring_hands", None):
        yield (
            "Between each arm and the object there is a spring, such as a rubber pad. Hands that "
            "approach each other by a millimetre squeeze by a millimetre times the stiffness of "
            "all that yields."
        )
    tasks = [task for phase in scenario.schedule for task in phase.tasks]
    if any(type_name(type(task)) == "impedance" for task in tasks):
        yield (
            "An impedance lets the object give way like a mass on springs: a push F moves it by "
            "F / K, with the stiffness K as stated. While it is pushed its error is how far it has "
            "given way, as it was asked to."
        )


def _laws(comparison: Comparison) -> Iterator[str]:
    bounded = "and no joint goes beyond its limits"
    if not comparison.scenario.limits:
        bounded = "and joints keep the limits that the scenario lists (this one lists none)"
    yield (
        "The pseudoinverse laws compute joint speeds that move the object and keep the loop "
        "closed, but they do not know the joint limits; the null-space variant follows a gradient "
        "away from limits, projected into the null space, and cannot stop at them. The QP solves a "
        "small optimisation problem in every control period, with two hard conditions: the loop "
        f"stays closed, {bounded}. It follows the task as well as these allow."
    )
    yield (
        "So the curves are much alike while no limit is active. Where one is, the QP stops at "
        "it and goes on with the other joints, or keeps a task error. A pseudoinverse law goes "
        "on into the hatched region: a motion that only looks good, because the real robot "
        "cannot make it."
    )
