"""What every format keeps: all cells, so that ticks and runs are explained as from trace.csv."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import refused, refused_in_one_line, typed
from scenario_files import HEAD

from coopqp.base.errors import CoopqpError
from coopqp.execution.comparison import compare
from coopqp.recordings import NAMES, export, format_of, read
from coopqp.recordings.column import Columns
from coopqp.report import files
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import load
from coopqp.study.tick_record import TickRecord
from coopqp.study.trace_file import recorded_tick

PACKAGES = {"mcap": "mcap", "rosbag2": "rosbags", "parquet": "pyarrow", "lerobot": "pyarrow"}
every_format = pytest.mark.parametrize("name", NAMES)
TICKS = (0, 70, 150)  # one of each phase


@pytest.fixture(scope="module")
def columns(written: Any) -> Columns:
    """The columns of the report."""
    return read(written.trace_csv).of("qp").columns


@pytest.fixture(scope="module")
def solved(written: Any) -> dict[int, TickRecord]:
    """Ticks of the report, solved again."""
    trace, given = written.trace_csv, load(written.trace_csv.parent / "scenario.yaml")
    return {tick: recorded_tick(trace, given, "qp", tick) for tick in TICKS}


@pytest.fixture(scope="module")
def explained(written: Any) -> str:
    """What is said of the report's run."""
    said = typed("explain", written.trace_csv, "--controller", "qp")
    assert said.exit_code == 0
    return said.stdout


@every_format
def test_every_column_is_kept(name: str, written: Any, columns: Columns) -> None:
    found = read(written.exported[name]).columns
    assert set(found) == set(columns)
    for key, values in columns.items():
        assert found[key].dtype == values.dtype
        np.testing.assert_array_equal(found[key], values)


@every_format
def test_ticks_are_explained_and_solved_again_bit_for_bit(
    name: str, written: Any, solved: dict[int, TickRecord]
) -> None:
    path = written.exported[name]
    scenario = format_of(path).scenario(path, Catalog())
    for tick in TICKS:
        assert recorded_tick(path, scenario, "qp", tick) == solved[tick]
    said = typed("replay", path, "--tick", 150, "--solver", "daqp", "--json")
    assert '"difference": 0.0' in said.stdout
    assert not said.stderr  # it comes out as recorded


@every_format
def test_runs_are_explained_alike(name: str, written: Any, explained: str) -> None:
    assert typed("explain", written.exported[name]).stdout == explained


@every_format
def test_a_damaged_file_is_refused_in_one_line(name: str, written: Any, tmp_path: Path) -> None:
    path = written.exported[name]
    damaged = tmp_path / path.name
    if path.is_dir():
        for part in (part for part in path.rglob("*") if part.is_file()):
            content, there = part.read_bytes(), damaged / part.relative_to(path)
            cut = len(content) if part.suffix == ".yaml" else len(content) // 2
            there.parent.mkdir(parents=True, exist_ok=True)
            there.write_bytes(content[:cut])
    else:
        damaged.write_bytes(path.read_bytes()[:-100])
    assert str(damaged) in refused_in_one_line("explain", damaged)


@every_format
def test_a_missing_package_is_named_with_its_extra(
    name: str, written: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in [m for m in sys.modules if m.split(".")[0] == PACKAGES[name]]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, PACKAGES[name], None)
    if name == "mcap":
        monkeypatch.setitem(sys.modules, "foxglove", None)
    for arguments in (
        ["export", written.trace_csv, "--to", name, "--controller", "qp", "--out", tmp_path / "x"],
        ["explain", written.exported[name]],
    ):
        assert "needs: pip install 'coopqp[recordings]'" in refused(*arguments)
    assert not list(tmp_path.iterdir())


def test_grippers_of_a_dataset_are_open_where_arms_have_let_go(written: Any) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    folder = written.exported["lerobot"]
    info = json.loads((folder / "meta" / "info.json").read_text())
    names = info["features"]["action"]["names"]
    rows = np.array(parquet.read_table(folder / "data")["action"].to_pylist())
    phases = read(written.trace_csv).of("qp").ticks.columns["phase"]
    released = {phase.name: phase.released for phase in load(folder.parent / "given.yaml").phases}
    for arm in ("left", "right"):
        opened = [100.0 * (arm in released[phase]) for phase in phases]
        assert rows[:, names.index(f"{arm}_gripper.pos")].tolist() == opened
    assert rows[:, [name.endswith("gripper.pos") for name in names]].any()


def test_time_that_stood_still_makes_no_dataset(written: Any, tmp_path: Path) -> None:
    run = read(written.trace_csv).of("qp")
    run.columns["t"][50:] += 0.3
    with pytest.raises(CoopqpError, match=r"time is up to 0\.3 s off one tick each 0\.01 s, and a"):
        export(
            run, load(written.trace_csv.parent / "scenario.yaml"), "lerobot", "qp", tmp_path / "x"
        )


def test_all_controllers_are_exported_a_file_each(written: Any, tmp_path: Path) -> None:
    for name in ("trace.csv", "scenario.yaml"):
        (tmp_path / name).write_bytes((written.trace_csv.parent / name).read_bytes())
    assert typed("export", tmp_path, "--to", "parquet").exit_code == 0
    assert typed("export", tmp_path, "--to", "parquet").exit_code == 0  # once more
    assert {p.name for p in tmp_path.glob("*.parquet")} == {"qp.parquet", "pseudoinverse.parquet"}
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--out", "x.mcap"], "--out is one file, but"),
        (["--controller", "qpp"], "did you mean 'qp'?"),
        (["--controller", "qp", "--out", "{folder}"], "is a folder"),
        (["--controller", "qp", "--out", "{folder}/trace.csv"], "is what is read"),
        (["--controller", "qp", "--out", "{folder}/trace.csv/x"], "cannot write"),
    ],
)
def test_what_cannot_be_exported_is_refused_in_one_line(
    arguments: list[str], words: str, written: Any
) -> None:
    folder = written.trace_csv.parent
    filled = [argument.format(folder=folder) for argument in arguments]
    assert words in refused_in_one_line("export", folder, "--to", "mcap", *filled)
    assert not list(folder.glob(".*mcap*"))


SHORT = """\
dt: 0.01
duration: 0.2
controllers: [qp]
tasks: [{point_on_point: {goal: [0.16, 0, 0.05], profile: {duration: 0.1}}}]
"""


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a run whose joints do exactly as told."""
    folder = tmp_path_factory.mktemp("short")
    (folder / "given.yaml").write_text(HEAD + SHORT, encoding="utf-8")
    files.write(compare(load(folder / "given.yaml")), folder)
    return folder


def cell_changed(text: str) -> str:
    header, *rows = text.splitlines()
    column = header.split(",").index("q[LElbowRoll]")
    cells = rows[9].split(",")
    cells[column] = repr(float(cells[column]) + 0.01)
    return "\n".join([header, *rows[:9], ",".join(cells), *rows[10:]]) + "\n"


@pytest.mark.parametrize(
    ("name", "damage", "words"),
    [
        ("scenario.yaml", lambda text: text.replace("dt: 0.01", "dt: 0.02"), "'qp' has 20 ticks"),
        ("trace.csv", lambda text: "".join(text.splitlines(True)[:9]), "'qp' has 7 ticks"),
        ("trace.csv", cell_changed, "trace.csv:11: q[LElbowRoll]: found"),
    ],
)
def test_a_run_that_is_none_of_its_scenario_is_not_exported(
    name: str, damage: Any, words: str, short: Path, tmp_path: Path
) -> None:
    for one in ("trace.csv", "scenario.yaml"):
        text = (short / one).read_text(encoding="utf-8")
        (tmp_path / one).write_text(damage(text) if one == name else text, encoding="utf-8")
    assert words in refused_in_one_line("export", tmp_path, "--to", "parquet")
    assert not list(tmp_path.glob("*parquet*"))
