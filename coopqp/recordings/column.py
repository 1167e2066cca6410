"""The table of recorded columns: what is recorded of a run, its unit, shape and meaning.

``trace.csv``, Parquet, MCAP, rosbag2, the ring of a live loop and the reading of all of them are
made from it, and a test holds ``docs/recordings.md`` against it. A column is called ``NAME``,
``NAME[KEY]`` or ``NAME[KEY].PART``, such as ``q[RElbowRoll]`` and ``loop_offset[1].rot_x``. Numbers
stay arrays: float64, in which NaN is an empty cell, and int64 for whole numbers; in texts "" is.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from coopqp.execution.instants import parts_of, rows_of
from coopqp.model.closed_chain import AXES, AXIS_UNITS
from coopqp.scenario.scenario import Scenario
from coopqp.signal import Kind
from coopqp.trace import Trace

Columns = Mapping[str, NDArray[Any]]
"""By name; all have as many rows."""
Units = Mapping[str, str]
"""Of joints, and of tasks, their parts and rows, by name."""

_ROTATION = tuple(f"R{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))
_WRENCH = {"fx": "N", "fy": "N", "fz": "N", "tx": "N m", "ty": "N m", "tz": "N m"}


@dataclass(frozen=True, kw_only=True)
class Layout:
    """What there is one column of each."""

    joints: tuple[str, ...]
    loops: int = 0
    memory: int = 0  # numbers that the law remembers
    inputs: Mapping[str, Kind] = field(default_factory=dict)
    tasks: tuple[str, ...] = ()  # and their parts
    rows: tuple[str, ...] = ()  # of all tasks
    limits: tuple[tuple[str, str], ...] = ()  # name and unit
    arms: tuple[str, ...] = ()


def layout_of(traces: Collection[Trace]) -> Layout:
    """What any of the traces has."""

    def all_of(names: Callable[[Trace], Iterable[Any]]) -> tuple[Any, ...]:
        return tuple(dict.fromkeys(name for trace in traces for name in names(trace)))

    return Layout(
        joints=all_of(lambda trace: trace.joints),
        loops=max(trace.loop_offset.shape[1] // 6 for trace in traces),
        memory=max(trace.memory.shape[1] for trace in traces),
        inputs={name: kept.kind for trace in traces for name, kept in trace.inputs.items()},
        tasks=all_of(lambda trace: (task.name for task in trace.tasks)),
        rows=all_of(lambda trace: trace.task_rows),
        limits=all_of(_limits),
        arms=all_of(lambda trace: trace.points),
    )


@dataclass(frozen=True)
class Shape:
    """What a field has one column of each."""

    # what follows the field's name, in a list for each key
    columns: Callable[[Layout], list[list[str]]]
    # unit of a column by its key and part, where it depends on them
    unit: Callable[[Units, str, str], str] = lambda units, key, part: ""
    named: bool = True  # whether its columns begin with the field's name


def _each(keys: Iterable[object]) -> list[list[str]]:
    return [[f"[{key}]"] for key in keys]


def _of_hand(parts: Sequence[str]) -> Callable[[Layout], list[list[str]]]:
    return lambda layout: [[f"[{arm}].{part}" for part in parts] for arm in layout.arms]


def _of_input(parts: Callable[[Kind], Iterable[str]]) -> Callable[[Layout], list[list[str]]]:
    return lambda layout: [[f"[{k}].{p}" for p in parts(kind)] for k, kind in layout.inputs.items()]


def _by_key(units: Units, key: str, part: str) -> str:
    return units.get(key, "")


PLAIN = Shape(lambda layout: [[""]])
XYZ = Shape(lambda layout: [["x", "y", "z"]], named=False)
ROTATION = Shape(lambda layout: [list(_ROTATION)], named=False)
JOINT = Shape(lambda layout: _each(layout.joints), _by_key)
MOTOR = Shape(
    lambda layout: _each(layout.joints),
    lambda units, key, part: {"rad": "N m", "m": "N"}.get(units.get(key, ""), ""),
)
LOOP = Shape(
    lambda layout: [[f"[{loop + 1}].{axis}" for axis in AXES] for loop in range(layout.loops)],
    lambda units, key, part: dict(zip(AXES, AXIS_UNITS, strict=True)).get(part, ""),
)
MEMORY = Shape(lambda layout: _each(range(layout.memory)))
VALUE = Shape(_of_input(lambda kind: kind.value_columns))
SENT = Shape(_of_input(lambda kind: (*kind.value_columns, "sent")))
RATE = Shape(_of_input(lambda kind: kind.rate_columns))
TASK = Shape(lambda layout: _each(layout.tasks), _by_key)
ROW = Shape(lambda layout: _each(layout.rows), _by_key)
LIMIT = Shape(
    lambda layout: [[f"[{owner}].{unit}"] for owner, unit in layout.limits],
    lambda units, key, part: part,
)
PUSH = Shape(lambda layout: _each(_WRENCH), lambda units, key, part: _WRENCH[key])
HAND = Shape(lambda layout: _each(layout.arms))
HAND_POINT = Shape(_of_hand("xyz"))
HAND_WRENCH = Shape(_of_hand(tuple(_WRENCH)), lambda units, key, part: _WRENCH.get(part, ""))


def _limits(trace: Trace) -> tuple[tuple[str, str], ...]:
    return tuple(dict.fromkeys((row.owner, row.unit) for row in trace.margins))


def _margins(trace: Trace) -> list[tuple[list[str], NDArray[Any]]]:
    """For each limit, what its rows are called and their margins, shape (rows, T)."""
    found = []
    for key in _limits(trace):
        rows = [row for row in trace.margins if (row.owner, row.unit) == key]
        left = np.array([trace.margins[row] for row in rows])
        found.append(([row.label for row in rows], left))
    return found


def _nearest(trace: Trace) -> Any:
    """Where a margin is least; nowhere without the limit."""
    found = []
    for words, left in _margins(trace):
        finite = np.isfinite(left.min(axis=0))
        found.append(np.where(finite, np.array(words, object)[left.argmin(axis=0)], ""))
    return np.array(found, object).T


def _unless_zero(values: NDArray[Any]) -> NDArray[Any]:
    return values if values.any() else np.full(values.shape, np.nan)


def _push(trace: Trace) -> Any:
    push = trace.signals.get("push")
    return None if push is None or not push.any() else push


def _commanded(trace: Trace) -> Any:
    same = np.array_equal(trace.commanded, trace.q[:-1])
    return np.full(trace.v.shape, np.nan) if same else trace.commanded


def _inputs(*keys: str) -> Callable[[Trace], Any]:
    def values(trace: Trace) -> Any:
        parts = [np.zeros((trace.ticks, 0))]
        for kept in trace.inputs.values():
            parts += [getattr(kept, key).reshape(trace.ticks, -1) for key in keys]
        return np.concatenate(parts, axis=1)

    return values


def _phase(trace: Trace) -> Any:
    """Its name; the end belongs to the last."""
    if not trace.phases:
        return None
    found = np.full(trace.ticks + 1, "", object)
    for phase in trace.phases:
        found[phase.first :] = phase.name
    return found


@dataclass(frozen=True)
class Field:
    """A line of the table."""

    name: str
    shape: Shape  # what it has one column of each
    unit: str  # of its columns; {} is the shape's
    meaning: str
    # what it has a row of; there is an instant more than ticks
    per: Literal["tick", "instant"] = "tick"
    # its values in a trace, shape (rows, columns), or None where it has none; the attribute or the
    # plant's signal of its name if omitted
    of: Callable[[Trace], Any] | None = None
    kind: Literal["number", "text", "whole"] = "number"
    interleaved: bool = False  # whether its columns alternate with the line before's, key by key

    def groups(self, layout: Layout) -> list[list[str]]:
        """Names of its columns, in a list for each key."""
        name = self.name if self.shape.named else ""
        return [[f"{name}{rest}" for rest in rests] for rests in self.shape.columns(layout)]

    def columns(self, layout: Layout) -> list[str]:
        return [column for group in self.groups(layout) for column in group]

    def values(self, trace: Trace) -> Any:
        """Its values in a trace; None where it has none."""
        if self.of is not None:
            return self.of(trace)
        return getattr(trace, self.name, trace.signals.get(self.name))


# fmt: off
TABLE: tuple[Field, ...] = (
    Field("controller", PLAIN, "", "whose row it is: one block a controller", "instant",
          lambda trace: np.full(trace.ticks + 1, trace.controller, object), "text"),
    Field("tick", PLAIN, "1", "which instant of it, from 0 on", "instant",
          lambda trace: np.arange(trace.ticks + 1), "whole"),
    Field("t", PLAIN, "s", "when", "instant"),
    Field("q", JOINT, "{}", "where the joints were", "instant"),
    Field("v", JOINT, "{}/s", "commanded, or the plant's after the tick where torques are"),
    Field("commanded", JOINT, "{}", "from where the tick decided; empty where that is q",
          of=_commanded),
    Field("measured", JOINT, "{}", "what the sensors said"),
    Field("loop_offset", LOOP, "{}", "what each loop is open by in the model, "
          "[real robots](real_robots.md)", of=lambda trace: _unless_zero(trace.loop_offset)),
    Field("memory", MEMORY, "", "what the law remembered when the tick began",
          of=lambda trace: _unless_zero(trace.memory)),
    Field("input", SENT, "", "what arrived at an [input](signals.md) for this tick; `sent`: when "
          "it was sent [s]; empty where nothing did", of=_inputs("arrived", "sent")),
    Field("followed", VALUE, "", "what the limiter made of it, which the tasks follow; a rotation "
          "as the quaternion qx, qy, qz, qw", of=_inputs("value"), interleaved=True),
    Field("followed_rate", RATE, "", "how fast that moves; of a rotation the angular velocity",
          of=_inputs("rate"), interleaved=True),
    Field("tau", MOTOR, "{}", "torques of the motors",
          of=lambda trace: trace.signals.get("tau", np.full(trace.v.shape, np.nan))),
    Field("position", XYZ, "m", "the object's position", "instant"),
    Field("rotation", ROTATION, "1", "its rotation matrix, row by row", "instant"),
    Field("loop_position", PLAIN, "m", "largest loop error", "instant"),
    Field("loop_orientation", PLAIN, "rad", "the same of orientations", "instant"),
    Field("error", TASK, "{}", "norm of the error to the moving reference; a task of several parts "
          "has a column for each", "instant", lambda trace: trace.task_error),
    Field("e", ROW, "{}", "the row's error, value minus reference: `x - e[reach.x]` is where the "
          "reference of `reach` is. 0 for tasks that ask for a velocity alone", "instant"),
    Field("rate", ROW, "{}/s", "how fast the row's reference moves: the feed-forward, or the "
          "velocity that is asked for", "instant"),
    Field("margin", LIMIT, "{}", "what is left after the tick where the limit is nearest; negative "
          "where it is broken",
          of=lambda trace: np.array([left.min(axis=0) for _, left in _margins(trace)]).T),
    Field("nearest", LIMIT, "", "where that is, such as `RElbowRoll (upper)`",
          of=_nearest, kind="text", interleaved=True),
    Field("push", PUSH, "{}", "what pushes the object at the tick's end, where something does in "
          "the run, world axes", of=_push),
    Field("hand_wrench", HAND_WRENCH, "{}", "what each hand did to the object at the tick's end, "
          "world axes, where the plant tells [forces](forces.md#plants)"),
    Field("hand_point", HAND_POINT, "m", "and where"),
    Field("normal_force", HAND, "N", "of hands that press"),
    Field("tangential_force", HAND, "N", "likewise"),
    Field("friction_use", HAND, "1", "likewise; empty while they press on nothing"),
    Field("edge_use", HAND, "1", "likewise; empty while they press on nothing"),
    Field("slip", HAND, "m", "how far the object slipped along a hand that presses, or the grip "
          "gave way on `quasi_static`"),
    Field("held", PLAIN, "1", "whether hands that press hold the object: 1 or 0"),
    Field("status", PLAIN, "", "what became of the tick, [priorities](priorities.md)",
          of=lambda trace: np.array(trace.status, object), kind="text"),
    Field("scale", PLAIN, "1", "least share of its rate at which a hard or scaled task runs, 1 "
          "where there are none"),
    Field("tick_us", PLAIN, "us", "how long the tick took"),
    Field("phase", PLAIN, "", "where there are [phases](phases.md); their tasks are `PHASE.TASK`",
          "instant", _phase, "text"),
)
# fmt: on
#: Columns that every recorded run has.
NEEDED = ("controller", "tick", "t", "status", "tick_us")


def names(layout: Layout, fields: Collection[str] | None = None) -> list[str]:
    """All columns in their order."""
    found, leader = [], 0
    for n, line in enumerate(TABLE):
        leader = leader if line.interleaved else n
        if fields is None or line.name in fields:
            found += [(leader, i, n, group) for i, group in enumerate(line.groups(layout))]
    return [column for *_, group in sorted(found) for column in group]


def of_field(name: str, layout: Layout) -> list[str]:
    """The columns of one field."""
    return next(line for line in TABLE if line.name == name).columns(layout)


def columns_of(trace: Trace) -> dict[str, NDArray[Any]]:
    """All that is recorded of a run, a row an instant; the end has no tick. Empty: not finite."""
    layout, found = layout_of([trace]), dict[str, NDArray[Any]]()
    for line in TABLE:
        values = line.values(trace)
        if values is None:
            continue
        own = line.columns(layout)
        block = np.asarray(values).reshape(len(values), len(own))
        if line.kind == "number":
            block = np.where(np.isfinite(block), block, np.nan)
        if line.per == "tick":
            end = np.full((1, len(own)), "" if line.kind == "text" else np.nan, block.dtype)
            block = np.vstack([block, end])
        found |= dict(zip(own, np.ascontiguousarray(block.T), strict=True))
    return found


def split(column: str) -> tuple[str, ...]:
    """NAME, KEY and PART, as many as there are."""
    name, bracket, rest = column.partition("[")
    if not bracket:
        return (column,)
    if rest.endswith("]"):
        return name, rest[:-1]
    key, _, part = rest.rpartition("].")
    return name, key, part


def joined(parts: Sequence[str]) -> str:
    """The column of NAME, KEY and PART."""
    name, *rest = parts
    return name + "".join((f"[{part}]", f".{part}")[i] for i, part in enumerate(rest))


def field_of(column: str) -> Field | None:
    """The line of the table that a column is of; None for a column of one's own."""
    name = split(column)[0]
    for line in TABLE:
        if name in ([line.name] if line.shape.named else line.columns(Layout(joints=()))):
            return line
    return None


def kind_of(column: str) -> str:
    """Whether its values are numbers, whole numbers or texts."""
    line = field_of(column)
    return line.kind if line else "number"


def cells(values: NDArray[Any]) -> list[Any]:
    """A column as a list; None where it is empty."""
    found: list[Any] = values.tolist()
    empty = np.isnan(values) if values.dtype.kind == "f" else values == ""
    for k in np.flatnonzero(empty):
        found[k] = None
    return found


def unit_of(scenario: Scenario) -> Callable[[str], str]:
    """A function from a column to its unit; "" where it has none, or nobody knows it."""
    chain = scenario.chain
    units = dict(zip(chain.joint_names, chain.joint_units, strict=True))
    for phase in scenario.schedule:  # and of each part and each row of all tasks
        begin = f"{phase.name}." if scenario.phases else ""
        rows = rows_of(phase.tasks, chain)
        for part, own in parts_of(phase.tasks, chain):
            units |= {begin + name: part.unit for name in (part.name, *rows[own])}

    def unit(column: str) -> str:
        line = field_of(column)
        if line is None or "{}" not in line.unit:
            return line.unit if line else ""
        _, key, part = (*split(column), "", "")[:3]
        return line.unit.format(line.shape.unit(units, key, part))

    return unit
