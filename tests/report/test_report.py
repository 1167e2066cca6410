"""The report: complete, safe to open, exact, and never half-written."""

from __future__ import annotations

import csv
import html
import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plotly.offline import get_plotlyjs
from rich.console import Console
from side_by_side import needs_kernel

import coopqp
from coopqp.assessment import assess
from coopqp.base.errors import CoopqpError
from coopqp.controllers import QPController
from coopqp.execution.comparison import Comparison, summarize
from coopqp.report import curves, files
from coopqp.report.cells import cells, facts
from coopqp.report.curves import Chart, styles
from coopqp.report.figures.groups import groups, tick_times
from coopqp.report.figures.joints import joint_figures, joint_window
from coopqp.report.page import render
from coopqp.report.scene.playback import MAX_FRAMES, scene
from coopqp.report.table import summary
from coopqp.tasks import PointOnPlane

EVIL = "A <b>bold</b> </script><script>alert('x')</script> & $title [red]box[/red]"
UNREACHABLE = (0.30, 0.10, 0.0)  # m


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    """An unreachable goal, so that pseudoinverse laws blow up, and names that try to break out."""
    scenario = coopqp.load("point_on_point")
    task = replace(scenario.tasks[0], name=EVIL, goal=UNREACHABLE)
    return coopqp.compare(replace(scenario, description=EVIL, tasks=(task,)))


@pytest.fixture(scope="module")
def page(comparison: Comparison) -> str:
    """Without plotly.js, whose code holds addresses that it does not load by itself."""
    whole = render(comparison)
    assert whole.count(get_plotlyjs()) == 1
    return whole.replace(get_plotlyjs(), "")


def data_of(page: str, name: str) -> Any:
    """What a script tag of the page holds."""
    found = re.search(rf'<script type="application/json" id="{name}">(.*?)</script>', page, re.S)
    assert found
    return json.loads(found[1])


def test_each_task_of_a_cell_says_whether_it_is_reached(comparison: Comparison) -> None:
    scenario = comparison.scenario
    plane = PointOnPlane(name="here", normal=(0, 0, 1), through=(0, 0, 0.04))
    two = coopqp.compare(replace(scenario, tasks=(*scenario.tasks, plane)), controllers=["qp"])
    cell = cells(two.traces["qp"], two.metrics["qp"])["task_error"]
    missed = [task.name for task in assess(two.traces["qp"]).missed]
    assert 0 < len(missed) <= 2 == len(cell.each)
    assert list(cell.each) == [task.name in missed for task in two.traces["qp"].tasks]
    shown = [f'<span class="{"bad" if bad else "good"}">' for bad in cell.each]
    assert all(span in render(two) for span in shown)


def test_a_missed_goal_leads_to_the_command_that_explains_it(
    comparison: Comparison, tmp_path: Path
) -> None:
    page = render(comparison, tmp_path / "my out")
    said = f"<code>coopqp explain '{tmp_path / 'my out'}' --controller qp</code>"
    assert comparison.scenario.source
    assert html.unescape(page).count(said) == 1
    assert "coopqp explain" not in render(coopqp.compare(coopqp.load("point_on_point")), tmp_path)


def test_page_loads_nothing(page: str) -> None:
    assert not re.search(r"""(src|href)\s*=|@import|url\(|https?://""", page)
    assert "default-src 'none'" in page


def test_page_names_every_joint_verdict_and_fact(page: str, comparison: Comparison) -> None:
    joints = next(iter(comparison.traces.values())).joints
    solver = "kernel" if comparison.traces["qp"].compiled.any() else "daqp"
    for text in (*joints, *comparison.verdicts.values(), solver, "nao_t14", "kinematic"):
        assert html.escape(text, quote=False) in page
    assert f"{comparison.scenario.kappa:g} 1/s" in page


def test_page_takes_names_as_text(page: str) -> None:
    assert "<b>bold" not in page
    assert "alert('x')</script>" not in page
    assert html.escape(EVIL, quote=False) in page
    assert page.count("<script") == page.count("</script>") == 5


def test_bad_cells_have_a_symbol(page: str) -> None:
    assert '<td class="bad" data-heading="Goal reached"><span>✗&nbsp;no</span></td>' in page
    for cell in re.findall(r'<td class="bad[^>]*><span>(.)', page):
        assert cell == "✗"


def test_every_figure_shows_every_controller(page: str, comparison: Comparison) -> None:
    figures = data_of(page, "figures")
    drawn = [f for group in groups(comparison) for f in (*group.figures, *group.folded)]
    assert len(figures) == page.count('class="plot"') == len(drawn)
    for figure, title in zip(figures, (f.title for f in drawn), strict=True):
        if title == "Active limits":
            assert {line["legendgroup"] for line in figure["data"]} == {"qp"}
            continue
        if title.startswith("Time of a tick in"):
            continue
        shown = {line["legendgroup"] for line in figure["data"] if "legendgroup" in line}
        assert shown == set(comparison.traces)


def test_blown_up_joints_stay_readable(comparison: Comparison) -> None:
    figures = [figure for part in joint_figures(Chart(comparison)) for figure in part]
    assert len(figures) == len(comparison.traces["qp"].joints)
    for figure in figures:
        bottom, top = figure.layout["yaxis"]["range"]
        assert top - bottom < 3.7 * (2 * 2.0857)
    notes = [note for figure in figures for note in figure.notes]
    assert any("pseudoinverse goes off the chart" in note for note in notes)
    assert not any(note.startswith("▲ qp ") for note in notes)


def test_lines_are_told_apart_without_colour(comparison: Comparison) -> None:
    looks = styles(comparison.traces)
    assert len({look.dash for look in looks.values()}) == len(looks)
    assert looks["qp"].width == max(look.width for look in looks.values())


def test_thinning_keeps_peaks() -> None:
    t, y = np.linspace(0.0, 1.0, 30_001), np.zeros(30_001)
    y[17_321] = 5.0
    kept_t, kept_y = curves.thinned(t, y)
    assert len(kept_y) <= curves.MAX_POINTS + 2
    assert kept_y.max() == 5.0
    assert kept_t[kept_y.argmax()] == t[17_321]


def test_times_of_ticks_stand_beside_those_of_the_same_language_alone() -> None:
    trace = coopqp.compare(coopqp.load("planar_pair"), controllers=["qp"]).traces["qp"]
    runs = {"compiled": True, "plain": False, "left": np.arange(trace.ticks) > 1}
    traces = {k: replace(trace, compiled=trace.compiled * 0 + on > 0) for k, on in runs.items()}
    found = summarize(coopqp.load("planar_pair"), traces)
    shown = {
        figure.title: {line["legendgroup"] for line in figure.data}
        for figure in tick_times(Chart(found))
    }
    assert shown == {
        "Time of a tick in C++": {"compiled", "left"},
        "Time of a tick in Python": {"plain", "left"},
    }
    tick = {name: cells(traces[name], found.metrics[name])["tick"].lines for name in traces}
    assert [lines[1:] for lines in tick.values()] == [("C++",), ("Python",), ("C++", "2 in Python")]


@needs_kernel
def test_the_solver_has_one_name(comparison: Comparison) -> None:
    assert ("QP solver", "kernel") in facts(comparison)
    both = coopqp.compare(
        replace(
            comparison.scenario,
            controllers={"a": QPController(), "b": QPController(engine="python")},
        )
    )
    assert ("QP solver", "kernel (a); daqp (b)") in facts(both)


def test_what_leaves_the_chart_is_told_where_it_is_farthest_off() -> None:
    lines = {"up": np.array([1.0, 5.0]), "down": np.array([1.9, 0.5]), "inside": np.array([1.5])}
    notes = curves.off_chart(curves.Window(1.0, 2.0), lines, "m")
    assert notes == ("▲ up goes off the chart, to 5 m", "▲ down goes off the chart, to 0.5 m")


def test_a_narrow_page_needs_no_scrolling(page: str) -> None:
    """Every table scrolls by itself, or has its headings again in each entry to become cards."""
    tables = re.findall(r'(<div class="wide">)?<table class="([^"]*)"', page)
    assert tables
    assert all(wrapped or "result" in classes for wrapped, classes in tables)
    (body,) = re.findall(r'<table class="summary result">.*?<tbody>(.*?)</tbody>', page, re.S)
    entries = re.findall(r"<td([^>]*)>", body)
    assert all("data-heading=" in entry or "verdict" in entry for entry in entries)


@pytest.mark.parametrize(
    ("lower", "upper"), [(-np.inf, np.inf), (-1.0, np.inf), (-np.inf, 1.0), (-1.0, 1.0)]
)
def test_joint_without_limits_is_shown(lower: float, upper: float) -> None:
    shown = joint_window(lower, upper, [np.linspace(0.0, 0.4, 9), np.linspace(0.0, 1e4, 9)])
    assert shown.bottom < 0.0 < 0.4 < shown.top < 20.0


def test_playback_marks_joints_beyond_their_limits(comparison: Comparison) -> None:
    drawn = scene(comparison)
    (goal,) = drawn["goals"]
    assert goal["name"] == EVIL
    assert goal["at"] == len(drawn["t"]) * [list(UNREACHABLE)]
    assert (goal["first"], goal["last"]) == (0, len(drawn["t"]) - 1)
    assert len(drawn["t"]) <= MAX_FRAMES
    worst = {
        run["name"]: max(np.max(arm["state"]) for arm in run["arms"])
        for run in drawn["controllers"]
    }
    assert worst["qp"] <= 1
    assert worst["pseudoinverse"] == 2


def test_plane_of_a_task_turns_in_the_playback() -> None:
    scenario = replace(coopqp.load("tilting_plane"), duration=3.0, dt=0.05, kappa=20.0)
    drawn = scene(coopqp.compare(scenario, controllers=["qp"]))
    corners = np.array(drawn["planes"][0]["corners"])
    sides = np.diff(corners, axis=1)
    normals = np.cross(sides[:, 0], sides[:, 1])
    assert corners.shape[1:] == (4, 3)
    assert not np.allclose(normals[0], normals[-1], atol=1e-4)


def test_metrics_json_is_strict_and_complete(comparison: Comparison) -> None:
    def refuse(word: str) -> None:
        raise AssertionError(word)

    found = json.loads(files.metrics_json(comparison), parse_constant=refuse)
    assert found == comparison.as_json()


def test_infinite_metrics_become_null(comparison: Comparison) -> None:
    free = {
        name: replace(trace, lower=trace.lower - np.inf, upper=trace.upper + np.inf)
        for name, trace in comparison.traces.items()
    }
    unlimited = summarize(comparison.scenario, free)
    found = json.loads(files.metrics_json(unlimited))
    assert found["controllers"]["qp"]["limit_margin_min"] is None
    assert "no limits" in render(unlimited)


def test_csv_reads_back_exactly(comparison: Comparison) -> None:
    rows = list(csv.DictReader(files.trace_csv(comparison).splitlines()))
    for name, trace in comparison.traces.items():
        own = [row for row in rows if row["controller"] == name]
        q = [[float(row[f"q[{joint}]"]) for joint in trace.joints] for row in own]
        v = [[row[f"v[{joint}]"] for joint in trace.joints] for row in own]
        turn = [[float(row[f"R{i}{j}"]) for i in (1, 2, 3) for j in (1, 2, 3)] for row in own]
        assert np.array_equal(q, trace.q)
        assert np.array_equal(np.array(v[:-1], float), trace.v)
        assert np.array_equal(turn, trace.rotation.reshape(-1, 9))
        assert set(v[-1]) == {""}


def test_write_gives_three_files_and_leaves_nothing_else(
    comparison: Comparison, tmp_path: Path
) -> None:
    written = files.write(comparison, tmp_path / "new" / "folder")
    names = ["report.html", "metrics.json", "trace.csv", "scenario.yaml"]
    assert [path.name for path in written] == names
    seen = {path for path in written[0].parent.iterdir() if not path.name.startswith(".report")}
    assert seen == set(written)


def test_failed_write_keeps_the_old_files(
    comparison: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = {path: path.read_bytes() for path in files.write(comparison, tmp_path)}
    write_text = Path.write_text

    def full_disk(path: Path, *args: Any, **options: Any) -> int:
        if path.name == "trace.csv":
            raise OSError(28, "No space left on device")
        return write_text(path, *args, **options)

    monkeypatch.setattr(Path, "write_text", full_disk)
    with pytest.raises(CoopqpError, match="No space left on device"):
        files.write(comparison, tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == old


def test_folder_that_is_a_file_is_refused(comparison: Comparison, tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    taken.write_text("mine")
    with pytest.raises(CoopqpError, match="taken"):
        files.write(comparison, taken)
    assert taken.read_text() == "mine"


def test_one_controller_is_enough(tmp_path: Path) -> None:
    scenario = replace(coopqp.load("point_on_point"), duration=0.05)
    task = replace(scenario.tasks[0], profile=coopqp.Profile(duration=0.05))
    alone = coopqp.compare(replace(scenario, tasks=(task,)), controllers=["pseudoinverse"])
    assert 'panes-1"' in files.write(alone, tmp_path)[0].read_text(encoding="utf-8")


def test_table_fits_the_terminal_and_shows_names_as_they_are(comparison: Comparison) -> None:
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(summary(comparison))
    lines = console.export_text().splitlines()
    assert max(map(len, lines)) <= 100
    assert "[red]" in " ".join(lines)
    assert "✗ no" in " ".join(lines)


@needs_kernel
def test_runs_that_nobody_timed_have_a_page_without_times() -> None:
    scenario = coopqp.load("planar_pair")
    laws = "qp", "pseudoinverse"
    given = {law: coopqp.run(scenario, controller=law, timed=law == "qp") for law in laws}
    found = summarize(scenario, given)
    assert found.metrics["qp"]["tick_us"]["median"] > 0.0
    assert found.metrics["pseudoinverse"]["tick_us"] is None
    assert "Time of a tick" in render(found)
    assert "Time of a tick" not in render(summarize(scenario, {"-": given["pseudoinverse"]}))
