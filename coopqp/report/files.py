"""The report as files: the page, the metrics as JSON and every tick as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.checked import Array
from coopqp.closed_chain import AXES
from coopqp.comparison import Comparison
from coopqp.errors import CoopqpError, InternalError
from coopqp.report import folder as report_folder
from coopqp.report import strict_json
from coopqp.report.folder import publish, replace_file
from coopqp.report.page import render
from coopqp.report.trace_columns import Beside
from coopqp.study.sweep.journal import PATTERN as JOURNALS
from coopqp.trace import InputTrace, Trace
from coopqp.wording import by_user, raised

NAMES = ("report.html", "metrics.json", "trace.csv", "scenario.yaml")


def write(comparison: Comparison, folder: Path) -> list[Path]:
    """Write ``report.html``, ``metrics.json``, ``trace.csv`` and ``scenario.yaml``.

    They change all at once, also when the process is killed (:mod:`coopqp.report.folder`).

    Args:
        comparison: from :func:`coopqp.compare`.
        folder: made if it does not exist; files of these names are replaced.

    Returns:
        What was written.

    Raises:
        CoopqpError: the folder cannot be made or written to; a user's code keeps the page from
            being drawn, and all else is written.
        InternalError: the page could not be drawn; all else is written.
    """
    contents = {"metrics.json": metrics_json(comparison), "trace.csv": trace_csv(comparison)}
    if comparison.scenario.source:
        contents["scenario.yaml"] = comparison.scenario.portable  # for explain and replay
    fault: BaseException | None = None
    try:
        contents["report.html"] = render(comparison)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # noqa: BLE001 - a finished run is not lost for its pictures
        fault = error
    try:
        written = publish(contents, folder)
    except OSError as error:
        reason = error.strerror or str(error)
        raise CoopqpError(f"cannot write the report to '{folder}': {reason}") from error
    if fault:
        kept = ", ".join(path.name for path in written)
        words = f"the page cannot be drawn: {raised(fault)}; {kept} are written to '{folder}'"
        theirs = isinstance(fault, CoopqpError) or by_user(fault)
        raise (CoopqpError if theirs else InternalError)(words) from fault
    return [folder / name for name in NAMES if name in contents]


def write_one(path: Path, content: str) -> None:
    """Write one file; the old one stays when that fails.

    Raises:
        CoopqpError: it cannot be written.
    """
    try:
        replace_file(path, content)
    except OSError as error:
        raise CoopqpError(f"cannot write '{path}': {error.strerror or error}") from error


def check_folder(folder: Path) -> None:
    """Refuse a folder that no report can be written to, before a long run and not after it.

    Raises:
        CoopqpError: with the reason.
    """
    if next(folder.glob(JOURNALS), None):
        words = "holds a study, whose page a report would replace; give another --out"
        raise CoopqpError(f"'{folder}' {words}")
    report_folder.check_folder(folder, NAMES)


def metrics_json(comparison: Comparison) -> str:
    """``metrics.json``: what is not finite is null, because JSON has no word for it."""
    return strict_json.text(comparison.as_json()) + "\n"


def trace_csv(comparison: Comparison) -> str:
    """``trace.csv``: a row for each controller and instant, with numbers that read back exactly.

    The last row of a controller is the end of its run, after which there is no command. Columns
    are empty where a controller has nothing to say: ``commanded`` where the joints do exactly as
    told, ``measured`` where no sensor says otherwise, ``gap`` where the model has no error,
    ``memory`` where the law remembers nothing, ``input`` where nothing arrived.
    ``docs/recordings.md`` has all columns.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    traces = comparison.traces
    joints = list(dict.fromkeys(joint for trace in traces.values() for joint in trace.joints))
    memory = max(trace.memory.shape[1] for trace in traces.values())
    beside = Beside(
        list(traces.values()), [arm.name for arm in comparison.scenario.robot_model.arms]
    )
    writer.writerow(_header(joints, memory, next(iter(traces.values())), beside))
    for name, trace in traces.items():
        writer.writerows(_rows(name, trace, joints, memory, beside))
    return stream.getvalue()


def _header(joints: list[str], memory: int, trace: Trace, beside: Beside) -> list[str]:
    return [
        *("controller", "tick", "t"),
        *(f"q[{joint}]" for joint in joints),
        *(f"v[{joint}]" for joint in joints),
        *(f"commanded[{joint}]" for joint in joints),
        *(f"measured[{joint}]" for joint in joints),
        *(f"gap[{loop + 1}].{axis}" for loop in range(trace.gap.shape[1] // 6) for axis in AXES),
        *(f"memory[{i}]" for i in range(memory)),
        *(column for kept in trace.inputs.items() for column in _input_columns(*kept)),
        *(f"tau[{joint}]" for joint in joints),
        *("x", "y", "z"),
        *(f"R{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)),
        *("loop_position", "loop_orientation"),
        *(f"error[{task.name}]" for task in trace.tasks),
        *beside.of_instants,
        *beside.of_ticks,
        *("status", "scale", "tick_us"),
        *(["phase"] if trace.phases else []),
    ]


def _input_columns(name: str, kept: InputTrace) -> Iterator[str]:
    """What arrived and when it was sent, what was followed and how that moved."""
    values, rates = kept.kind.value_columns, kept.kind.rate_columns
    yield from (f"input[{name}].{column}" for column in values)
    yield f"input[{name}].sent"
    yield from (f"followed[{name}].{column}" for column in values)
    yield from (f"followed_rate[{name}].{column}" for column in rates)


def _rows(
    name: str, trace: Trace, joints: list[str], memory: int, beside: Beside
) -> Iterator[list[Any]]:
    # tolist() gives Python floats, which csv writes with all the digits they need.
    after = np.column_stack(
        [
            trace.position,
            trace.rotation.reshape(-1, 9),
            trace.loop_position,
            trace.loop_orientation,
        ]
    ).tolist()
    rows = zip(after, _errors(trace), beside.instants(trace), strict=True)
    after = [[*row, *errors, *asked] for row, errors, asked in rows]
    left = beside.ticks(trace)
    q, v = _by_joint(trace.q, trace, joints), _by_joint(trace.v, trace, joints)
    tau = _by_joint(trace.signals.get("tau", np.zeros((trace.ticks, 0))), trace, joints)
    t, us, scale = trace.t.tolist(), trace.tick_us.tolist(), trace.scale.tolist()
    known, phases = _known(trace, joints, memory), _phase_of_each_tick(trace)
    for k in range(trace.ticks):
        flags = [trace.status[k], scale[k], us[k], *phases[k]]
        yield [name, k, t[k], *q[k], *v[k], *known[k], *tau[k], *after[k], *left[k], *flags]
    end, nothing = trace.ticks, [""] * (2 * len(joints) + len(known[0]))
    none = [""] * len(beside.of_ticks)
    yield [name, end, t[end], *q[end], *nothing, *after[end], *none, "", "", "", *phases[end - 1]]


def _known(trace: Trace, joints: list[str], memory: int) -> list[list[Any]]:
    """What each tick decided from, beside time, joints and their velocity."""
    told = not np.array_equal(trace.commanded, trace.q[:-1])
    commanded = _by_joint(trace.commanded if told else trace.commanded[:, :0], trace, joints)
    sensed = np.isfinite(trace.measured).any()
    measured = _by_joint(trace.measured if sensed else trace.measured[:, :0], trace, joints)
    rows = []
    for values, width in ((trace.gap, trace.gap.shape[1]), (trace.memory, memory)):
        empty = width - values.shape[1] if values.any() else width
        shown: list[list[Any]] = values[:, : width - empty].tolist()
        rows.append([[*row, *[""] * empty] for row in shown])
    known = zip(commanded, measured, *rows, _arrived(trace), strict=True)
    return [[value for part in parts for value in part] for parts in known]


def _arrived(trace: Trace) -> list[list[Any]]:
    """What arrived at the inputs and what was made of it; empty where there is nothing."""
    columns = [np.zeros((trace.ticks, 0))]
    for kept in trace.inputs.values():
        columns += [kept.arrived, kept.sent[:, None], kept.value, kept.rate]
    rows: list[list[Any]] = np.concatenate(columns, axis=1).tolist()
    return [["" if value != value else value for value in row] for row in rows]


def _errors(trace: Trace) -> list[list[Any]]:
    """Task errors; empty in the phases that do not have the task."""
    errors: list[list[Any]] = trace.task_error.tolist()
    for i, task in enumerate(trace.tasks):
        counts = set(range(len(errors))[task.rows])
        for k, row in enumerate(errors):
            row[i] = row[i] if k in counts else ""
    return errors


def _phase_of_each_tick(trace: Trace) -> list[list[str]]:
    """Its name in a list, or an empty list where there are no phases."""
    found: list[list[str]] = [[] for _ in range(trace.ticks)]
    for phase in trace.phases:
        found[phase.first :] = [[phase.name]] * (trace.ticks - phase.first)
    return found


def _by_joint(values: Array, trace: Trace, joints: list[str]) -> list[list[Any]]:
    """Columns in the order of ``joints``; empty for joints that the trace does not have."""
    columns: list[list[Any]] = []
    for joint in joints:
        known = joint in trace.joints and values.shape[1] > 0
        column = values[:, trace.joints.index(joint)].tolist() if known else [""] * len(values)
        columns.append(column)
    return [list(row) for row in zip(*columns, strict=True)]
