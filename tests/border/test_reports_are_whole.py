"""A report is the old one or the new one, and no run is lost for its pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from command_line import refused, typed
from scenario_files import cut

import coopqp
from coopqp.base.errors import InternalError
from coopqp.execution.comparison import Comparison
from coopqp.report import files
from tests.border import kills

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return coopqp.compare(cut(coopqp.load("point_on_point"), 3), controllers=["qp"])


@pytest.mark.full
def test_a_killed_writer_leaves_one_whole_report(capsys: pytest.CaptureFixture[str]) -> None:
    assert kills.main(["--kills", "5"]) == 0
    assert capsys.readouterr().out.startswith("5 kills")


def test_files_of_an_earlier_report_do_not_stay(comparison: Comparison, tmp_path: Path) -> None:
    files.write(comparison, tmp_path)
    (tmp_path / "mine.txt").write_text("mine")
    assert len(files.write(comparison, tmp_path)) == 4
    bare = replace(comparison, scenario=replace(comparison.scenario, source=""))
    files.write(bare, tmp_path)
    seen = {path.name for path in tmp_path.iterdir() if not path.name.startswith(".")}
    assert seen == {"report.html", "metrics.json", "trace.csv", "mine.txt"}


def test_a_folder_in_the_way_is_said_before_the_run(tmp_path: Path) -> None:
    (tmp_path / "metrics.json").mkdir()
    said = refused("compare", "point_on_point", "--out", tmp_path)
    assert "metrics.json' is a folder, but a file is to be written there" in said


def test_a_page_that_cannot_be_drawn_takes_nothing_else_along(
    comparison: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_: Comparison, folder: Path) -> str:
        raise ValueError("math domain error")

    files.write(comparison, tmp_path)
    monkeypatch.setattr(files, "render", broken)
    with pytest.raises(InternalError, match=r"cannot be drawn: .*raises ValueError: math domain"):
        files.write(comparison, tmp_path)
    assert not (tmp_path / "report.html").exists()  # the old one is of another run
    assert (tmp_path / "trace.csv").read_text() == files.trace_csv(comparison)


def test_what_nobody_foresaw_ends_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("two\nlines")

    monkeypatch.setattr("coopqp.report.mobility.study", broken)
    result = typed("mobility", "point_on_point")
    assert result.exit_code == 70
    (line,) = result.stderr.splitlines()
    assert "raises RuntimeError: two lines; this is a fault of coopqp, please report it" in line
    result = typed("--debug", "mobility", "point_on_point")
    assert result.exit_code == 70
    assert "Traceback" in result.stderr


def test_an_explanation_finds_the_robot_of_a_report(tmp_path: Path) -> None:
    seeds = ROOT / "tests" / "fuzz" / "seeds"
    assert typed("compare", seeds / "urdf.yaml", "--out", tmp_path / "out").exit_code == 0
    result = typed("explain", tmp_path / "out")
    assert result.exit_code == 0, result.stderr
