"""The table of recorded columns: docs are held against it, and a new field is one line of it."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from explained import traced
from scenario_files import HEAD

import coopqp
from coopqp.execution.comparison import Comparison
from coopqp.online import recording as live
from coopqp.online.recording import LiveRecording
from coopqp.recordings import EXPORTS, column, export, read
from coopqp.report import files
from coopqp.trace import Trace

DOCS = Path(__file__).parents[2] / "docs" / "recordings.md"
SHORT = """\
dt: 0.01
duration: 0.2
controllers: [qp]
tasks: [{point_on_point: {goal: [0.16, 0, 0.05], profile: {duration: 0.1}}}]
"""


@pytest.fixture
def comparison(tmp_path: Path) -> Comparison:
    (tmp_path / "given.yaml").write_text(HEAD + SHORT, encoding="utf-8")
    return coopqp.compare(coopqp.load(tmp_path / "given.yaml"))


#: How the docs write a field's columns, after its name, and the units of what it depends on.
IN_DOCS: dict[column.Shape, tuple[str, tuple[str, ...]]] = {
    column.PLAIN: ("", ()),
    column.XYZ: ("x`, `y`, `z", ()),
    column.ROTATION: ("R11` ... `R33", ()),
    column.JOINT: ("[JOINT]", ("rad", "m")),
    column.MOTOR: ("[JOINT]", ("N m", "N")),
    column.LOOP: ("[LOOP].AXIS", ("m", "rad")),
    column.MEMORY: ("[I]", ()),
    column.VALUE: ("[NAME].PART", ()),
    column.SENT: ("[NAME].PART", ()),
    column.RATE: ("[NAME].PART", ()),
    column.TASK: ("[TASK]", ("the task's unit",)),
    column.ROW: ("[TASK.ROW]", ("the task's unit",)),
    column.LIMIT: ("[LIMIT].UNIT", ("UNIT",)),
    column.PUSH: ("[PART]", ("N", "N m")),
    column.HAND: ("[ARM]", ()),
    column.HAND_POINT: ("[ARM].PART", ()),
    column.HAND_WRENCH: ("[ARM].PART", ("N", "N m")),
}


def in_docs(line: column.Field) -> str:
    """A line of the table as the docs have it."""
    words, units = IN_DOCS[line.shape]
    name = f"`{line.name if line.shape.named else ''}{words}`"
    unit = line.unit
    if "{}" in unit:
        unit = ", ".join(unit.format(of) for of in units)
    return f"| {name} | {unit} | {line.per} | {line.meaning} |"


def test_the_docs_have_the_table() -> None:
    text = DOCS.read_text(encoding="utf-8")
    rows = "\n".join(map(in_docs, column.TABLE))
    assert f"| column | unit | per | |\n|---|---|---|---|\n{rows}\n\n" in text, rows


@pytest.mark.parametrize("kind", ["csv", *(known.name for known in EXPORTS)])
def test_a_new_field_is_a_line_and_where_it_is_measured(
    kind: str, comparison: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two joints' motors the plant tells the temperature; the second is not known at first."""
    heat = column.Field("heat", column.JOINT, "K", "how warm each motor is")
    monkeypatch.setattr(column, "TABLE", (*column.TABLE, heat))
    trace = comparison.traces["qp"]
    measured = 300.0 + np.arange(trace.v.size).reshape(trace.v.shape) / 3.0
    measured[:5, 1] = np.nan
    warm = replace(trace, signals={**trace.signals, "heat": measured})
    path, scenario = traced(replace(comparison, traces={"qp": warm}), tmp_path), comparison.scenario
    if kind != "csv":
        run, path = read(path), tmp_path / f"qp.{kind}"
        export(run, scenario, kind, "qp", path)
    names = [f"heat[{joint}]" for joint in trace.joints]
    found = read(path).numbers(names, empty=True)
    np.testing.assert_array_equal(found, np.vstack([measured, np.full((1, len(names)), np.nan)]))
    assert column.unit_of(scenario)(names[0]) == "K"


def test_a_new_field_of_a_live_loop_is_a_line_and_where_it_is_measured(
    comparison: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    effort = column.Field("effort", column.JOINT, "{}", "how far each joint goes in the tick")
    monkeypatch.setattr(column, "TABLE", (*column.TABLE, effort))
    monkeypatch.setitem(live.MEASURED, "effort", lambda state, command: 2.0 * command.v)
    scenario = comparison.scenario
    law = scenario.controllers["qp"].build(scenario.problem())
    path, state = tmp_path / "run.arrows", law.start()
    v = []
    with LiveRecording(path, scenario, law, state, controller="qp", every=0.0) as recording:
        for _ in range(5):
            command = law.tick(state)
            recording.tick(state, command, 1.0)
            v.append(command.v.copy())
            state.advance(command.v, scenario.dt)
    names = [f"effort[{joint}]" for joint in scenario.chain.joint_names]
    np.testing.assert_array_equal(read(path).numbers(names), 2.0 * np.array(v))


def test_what_is_not_finite_is_empty(comparison: Comparison) -> None:
    """Not the text nan: in all columns, also where a task raised."""
    trace: Trace = comparison.traces["qp"]
    raised: Any = trace.task_error.copy()
    raised[3] = np.nan
    measured = np.full(trace.v.shape, np.nan)
    measured[1:, 0], measured[2, 1] = 0.5, np.inf
    told = replace(trace, task_error=raised, measured=measured, tick_us=np.nan * trace.tick_us)
    text = files.trace_csv(replace(comparison, traces={"qp": told}))
    rows = list(csv.DictReader(io.StringIO(text)))
    cells = {cell for row in rows for cell in row.values()}
    assert not {"nan", "inf", "-inf", "None"} & cells
    assert rows[3]["error[point_on_point]"] == ""
    assert [row["tick_us"] for row in rows] == [""] * len(rows)


def test_columns_stand_in_the_order_of_the_table(comparison: Comparison) -> None:
    names = column.names(column.layout_of(list(comparison.traces.values())))
    assert names[:3] == ["controller", "tick", "t"]
    near = names.index("nearest[position].rad")
    assert names[near - 1] == "margin[position].rad"
    assert len(set(names)) == len(names)
