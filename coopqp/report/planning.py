"""Answers of ``coopqp reach``, ``coopqp plan`` and ``coopqp time`` as text, JSON and files."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from string import Template
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from coopqp.base.errors import CoopqpError
from coopqp.base.table import csv_text
from coopqp.planning import Plan, Reach
from coopqp.planning.time_along import NOTHING, TimedPath, table_of_phases
from coopqp.report import strict_json
from coopqp.report.curves import BLACK, PALETTE, Json
from coopqp.report.files import write_one
from coopqp.report.page import asset, html_table, text
from coopqp.scenario.loader import load
from coopqp.scenario.planned import NEAR
from coopqp.scenario.scenario import Scenario
from coopqp.scenario.yaml import parsed, with_keys

PATH = "plan.csv"
#: Of a timed path: its table, and the page that shows what is active where.
TIMED, PAGE = "timed.csv", "timed.html"
TITLES = ("active limit", "time [s]", "share", "with 20 % more of it [s]")  # headings of its limits
#: Size of a picture, and of its margin [px]; colours of the limits that are active longest.
WIDTH, HEIGHT, MARGIN, GRAY = 940, 320, 40, "#555555"
COLORS = PALETTE[:-1]  # the frame is black


def configurations(found: Reach) -> Table:
    """A line for each way in which the arms bend, with the best configuration of it."""
    table = Table(box=None, pad_edge=False)
    for title in ("bend of the arms", "found", "joint margin", "clearance", "q [rad, m]"):
        table.add_column(title, justify="left" if title[0] in "bq" else "right")
    for bends, group in found.groups.items():
        best = group[0]
        clearance = f"{1e3 * best.clearance:.1f} mm" if np.isfinite(best.clearance) else "-"
        q = " ".join(f"{x:.4f}" for x in best.q)
        table.add_row(bends, f"{len(group)}", f"{best.joint_margin:.3f}", clearance, q)
    return table


def reach_json(found: Reach) -> str:
    """The same for machines."""
    rows = [
        {
            "q": one.q.tolist(), "bends": one.bends, "joint_margin": one.joint_margin,
            "clearance": one.clearance, "cut_off": one.cut_off,
        }
        for one in found.solutions
    ]  # fmt: skip
    return strict_json.text({
        "reachable": bool(found.solutions), "proven_unreachable": found.proven,
        "sentence": found.sentence, "tried": found.tried, "configurations": rows,
    })  # fmt: skip


def plan_json(found: Plan) -> str:
    """A plan without its points."""
    check = found.verification
    data: dict[str, Any] = {
        "found": found.success, "proven_unreachable": found.proven, "sentence": found.sentence,
        "length": found.length, "duration": float(found.t[-1]) if len(found.t) else 0.0,
        "seconds": found.seconds,
        "verified": {"points": check.points, "open": check.open} if check else None,
    }  # fmt: skip
    return strict_json.text(data)


def check_written(folder: Path | None, scenario: Scenario, name: str) -> None:
    """CoopqpError where a scenario would be written over that does not follow a table so named."""
    follows = (folder or Path()) / f"{scenario.name}.yaml"
    if folder is None or not follows.is_file():
        return
    broken = (CoopqpError, LookupError, OSError, TypeError, ValueError)
    with suppress(*broken):  # what is broken is not ours
        plan = parsed(follows, follows.read_text(encoding="utf-8")).data["reference"]["plan"]
        if Path(plan).name == name:
            return
    words = f"is there and does not follow {name}: it would be lost; give --out another folder"
    raise CoopqpError(f"'{follows}' {words}")


def write_plan(
    found: Plan, scenario: Scenario, folder: Path, keep: Sequence[str] = ()
) -> list[Path]:
    """Write the path, and the scenario with it, and the tasks to keep, as its reference.

    CoopqpError: it cannot be written, or the scenario is refused, and then nothing is.
    """
    keys = {"keep": list(keep)} if keep else {}
    with TemporaryDirectory() as tried:
        for path in _write(csv_text(found.columns), PATH, scenario, Path(tried), keys)[1:]:
            load(path, scenario.catalog)
    return _write(csv_text(found.columns), PATH, scenario, folder, keys)


def write_timed(
    parts: Sequence[TimedPath], tried: Sequence[dict[str, float]], scenario: Scenario, folder: Path
) -> list[Path]:
    """Write a timed path as a table and a page, and, from its start, the scenario that follows."""
    apart = float(np.abs(parts[0].at(0.0).q - scenario.chain.q_start).max())
    fits = apart < NEAR and not parts[0].speed[0]
    fits = fits and len(phase_titles(parts, scenario)) == len(parts)
    follower = scenario if fits else scenario.changed(source="")
    written = _write(csv_text(table_of_phases(parts, scenario.dt)), TIMED, follower, folder, {})
    write_one(folder / PAGE, _page(parts, tried, scenario))
    return [*written, folder / PAGE]


def _write(table: str, name: str, scenario: Scenario, folder: Path, keys: Json) -> list[Path]:
    path = folder / name
    write_one(path, table)
    if not scenario.source:
        return [path]
    follows = folder / f"{scenario.name}.yaml"
    changed = scenario.keys_with(path)
    changed["reference"] |= keys
    write_one(follows, with_keys(scenario.source, changed))
    return [path, follows]


def limits_table(found: TimedPath, tried: dict[str, float]) -> Table:
    """Which limit is active for how long, and how long the path takes with more of it."""
    table = Table(box=None, pad_edge=False)
    for title in TITLES:
        table.add_column(escape(title), justify="left" if title[0] == "a" else "right")
    for name, *cells in _active(found, tried):
        table.add_row(escape(name), *cells)
    return table


def _active(found: TimedPath, tried: dict[str, float]) -> Iterator[tuple[str, str, str, str]]:
    for name in [*found.shares, *(name for name in tried if name not in found.shares)]:
        share = found.shares.get(name)
        cells = ("", "") if share is None else (f"{share * found.duration:.3f}", f"{share:.1%}")
        yield name, *cells, f"{tried[name]:.4f}" if name in tried else ""


def _page(parts: Sequence[TimedPath], tried: Sequence[dict[str, float]], scenario: Scenario) -> str:
    page = Template(asset("timed.html"))
    sections = ""
    for title, found, more in zip(phase_titles(parts, scenario), parts, tried, strict=True):
        colors = dict(zip([name for name in found.shares if name != NOTHING], COLORS, strict=False))
        rows = [
            (f'<span style="color: {colors.get(name, GRAY)}">{text(name)}</span>', *cells)
            for name, *cells in _active(found, more)
        ]
        lines = filter(None, [*found.sentences, found.coarse(scenario.dt)])
        sentences = "".join(f"<p>{text(line)}</p>" for line in lines)
        sections += (
            f'<section><h2>{text(title)}</h2><aside class="how">{sentences}</aside>'
            f"{_picture(found, colors)}{html_table(TITLES, rows)}</section>"
        )
    about, css = text(scenario.description), asset("page.css")
    return page.substitute(title=text(scenario.name), about=about, css=css, of=sections)


def phase_titles(parts: Sequence[TimedPath], scenario: Scenario) -> list[str]:
    """What each part of a timed path is called."""
    names = [phase.name for phase in scenario.schedule if not phase.leads]
    return [f"Phase '{name}'" if len(parts) > 1 else "The whole path" for name in names]


def _picture(found: TimedPath, colors: dict[str, str]) -> str:
    """The speed along the path in the colour of what is active there, under what is possible."""
    way, top = found.profile, 1.05 * float(np.sqrt(found.profile.max_x.max()))
    x = MARGIN + (WIDTH - 2 * MARGIN) * way.s / way.s[-1]
    low = HEIGHT - MARGIN

    def line(points: Iterable[tuple[float, float]], color: str, width: float) -> str:
        at = " ".join(f"{a:.1f},{b:.1f}" for a, b in points)
        return f'<polyline points="{at}" fill="none" stroke="{color}" stroke-width="{width}"/>'

    heights = (np.sqrt(np.maximum(k, 0.0)) / top for k in (way.max_x, way.x))
    bound, y = (low - (low - MARGIN) * height for height in heights)
    parts = [line(zip(x, bound, strict=True), "#cccccc", 1.5)]
    parts.append(line([(MARGIN, MARGIN), (MARGIN, low), (WIDTH - MARGIN, low)], BLACK, 1.0))
    pairs = list(zip(x, y, strict=True))
    for k, name in enumerate(found.active):
        parts.append(line(pairs[k : k + 2], colors.get(name, GRAY), 3.0))
    label = f'<text x="{MARGIN}" y="{{}}" font-size="13">{{}}</text>'.format
    above = f"speed along the path, up to {top:.3g} rad/s; grey: what limits allow"
    parts.append(label(HEIGHT - 12, f"length of the path, 0 to {way.s[-1]:.3g} rad"))
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}">'
    return "".join([head, *parts, label(MARGIN - 8, above), "</svg>"])
