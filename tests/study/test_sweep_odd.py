"""Studies whose rows are not what one hoped for, and folders with little in them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import typed
from plate_study import HERE, STUDY, table_of, written

from coopqp.controller_run import run
from coopqp.scenario.loader import load
from coopqp.study.sweep import read_study, sweep
from coopqp.study.sweep.variant import _blocked_by, _broken, succeeds

pytest.importorskip("pyarrow.parquet")

GOAL = "tasks.slide.goal: {box: [[0.30, -0.05, 0.0], [0.40, 0.10, 0.0]]}"
MASS = "object.mass: {log: [0.1, 2.0]}"


def study_in(folder: Path, *changes: tuple[str, str]) -> Path:
    """The study with some of its text replaced."""
    text = STUDY
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    return written(folder, text)


def test_where_no_row_is_done_the_table_says_why(plate: Path) -> None:
    path = study_in(plate, (MASS, "dt: {range: [0.02, 0.03]}"))
    result = typed("sweep", path, "--out", plate / "out", "--jobs", "1")
    assert result.exit_code == 0, result.output
    assert "kappa: found 100.0; needs at most 1/dt" in result.stdout
    assert {row["state"] for row in table_of(plate / "out")} == {"invalid"}
    assert typed("sweep", plate / "out", "--table", "--json").exit_code == 0


def test_a_journal_with_only_its_head_has_a_table(plate: Path) -> None:
    sweep(read_study(plate / "study.yaml"), plate / "out", engine=HERE)
    journal = plate / "out" / "journal.jsonl"
    head = journal.read_bytes().splitlines(keepends=True)[0]
    journal.write_bytes(head)
    result = typed("sweep", plate / "out", "--table")
    assert result.exit_code == 0, result.output
    assert "0 of 16 rows are there yet" in result.stdout


@pytest.mark.parametrize(
    ("key", "values", "labels"),
    [
        ("grasp", ["null", "rigid"], ["left out", "rigid"]),
        ("kappa", ["null", *(str(k) for k in range(3))], ["0", "1", "2", "left out"]),
        ("on_infeasible", ["hold", "scale"], ["hold", "scale"]),
    ],
)
def test_null_has_a_bin_of_its_own(
    plate: Path, key: str, values: list[str], labels: list[str]
) -> None:
    from coopqp.report.sweep.bins import Binned
    from coopqp.study.sweep.columns import Columns

    path = study_in(plate, (MASS, f"{key}: {{choice: [{', '.join(values)}]}}"))
    study = read_study(path)
    sweep(study, plate / "out", engine=HERE)
    binned = Binned.of(study, Columns.of(plate / "out"))
    (axis,) = (axis for axis in binned.axes if axis.name == key)
    assert sorted(axis.labels) == sorted(labels)
    for row, code in zip(table_of(plate / "out"), axis.code, strict=True):
        value = row[key]
        assert axis.labels[code] == (
            "left out" if value is None else f"{value:.4g}" if key == "kappa" else value
        )
    assert sum(map(sum, next(iter(binned.maps()))["all"])) == len(axis.code)
    list(binned.flows())


def test_many_numbers_and_null_are_in_bins_with_labels() -> None:
    from coopqp.report.sweep.bins import BINS, _axis

    class Found:
        def __init__(self) -> None:
            self.kinds = {"kappa": "double"}

        def numbers(self, name: str) -> np.ndarray:
            return values

    values = np.append(np.linspace(0.0, 32.0, 33), np.nan)
    axis = _axis(Found(), "kappa", log=False)  # type: ignore[arg-type]
    assert axis is not None
    assert axis.count == BINS + 1
    assert axis.labels[0] == "0 to 2"
    assert axis.labels[-1] == "left out"
    assert np.bincount(axis.code).tolist() == [2] * (BINS - 1) + [3, 1]


def test_a_loop_that_opens_is_why_a_run_does_not_succeed(plate: Path) -> None:
    """Goals are reached, and no limit is broken."""
    trace = run(load("planar_pair"), controller="qp")
    assert succeeds(trace)
    assert not list(_broken(trace))
    opened = replace(trace, loop_position=trace.loop_position + 1.2e-4)
    assert not any(opened.torn)
    assert not succeeds(opened)
    assert list(_broken(opened)) == ["loop"]


@pytest.mark.parametrize(("duration", "named"), [(0.08, True), (3.0, False)])
def test_speeds_that_hold_a_run_up_are_named(plate: Path, duration: float, named: bool) -> None:
    """It ends on its way, with joints as fast as they can; with more time it arrives."""
    text = (plate / "plate.yaml").read_text(encoding="utf-8")
    for before, after in (
        ("\nduration: 0.1", f"\nduration: {duration}"),
        ("duration: 0.1}", "duration: 0.05}"),
        ("gain: 5.0", "gain: 20.0"),
        ("goal: [0.36, 0.10, 0.0]", "goal: [0.46, 0.24, 0.0]"),
    ):
        assert before in text
        text = text.replace(before, after)
    (plate / "fast.yaml").write_text(text, encoding="utf-8")
    scenario = load(plate / "fast.yaml")
    trace = run(scenario, controller="qp")
    assert succeeds(trace) is not named
    model = scenario.robot_model.model
    full = (np.abs(trace.v) > 0.9999 * model.velocityLimit).mean(axis=0) > 0.25
    fast = {f"speed of {joint}" for joint, at in zip(trace.joints, full, strict=True) if at}
    found = {name for name in _blocked_by(trace) if name.startswith("speed")}
    assert found == (fast if named else set())
    assert fast or not named
    law = run(scenario, controller="pseudoinverse")
    assert not [name for name in _blocked_by(law) if name.startswith("speed")]
