"""The columns of a recorded run: their names, units and values.

A name is NAME, NAME[KEY] or NAME[KEY].PART, such as ``t``, ``q[RElbowRoll]`` and ``gap[1].rot_x``.
What each means is in ``docs/recordings.md``. A value is a number, a text, or nothing; as a text a
number has all the digits that it needs to be read back exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from coopqp.closed_chain import AXES, AXIS_UNITS
from coopqp.errors import CoopqpError, InvalidValueError
from coopqp.recordings.format import Cells
from coopqp.scenario.scenario import Scenario

#: Columns that every recorded run has.
NEEDED = frozenset({"controller", "tick", "t", "status", "tick_us"})
_TEXTS = ("controller", "status", "phase", "nearest")
_WHOLE = ("tick",)
_ROTATION = tuple(f"R{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))
_FIXED = {
    "t": "s", "x": "m", "y": "m", "z": "m", "loop_position": "m", "loop_orientation": "rad",
    "tick": "1", "scale": "1", "tick_us": "us", "held": "1", **dict.fromkeys(_ROTATION, "1"),
}  # fmt: skip
_OF_HANDS = {
    "hand_point": "m", "normal_force": "N", "tangential_force": "N", "slip": "m",
    "friction_use": "1", "edge_use": "1",
}  # fmt: skip

Value = float | int | str | None
UnitOf = Callable[[str], str]


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


def is_text(column: str) -> bool:
    """Whether its values are texts."""
    return split(column)[0] in _TEXTS


def is_whole(column: str) -> bool:
    """Whether its values are whole numbers."""
    return column in _WHOLE


def value(cells: Cells, column: str) -> Value:
    """What a row has in a column; None where it has nothing.

    Raises:
        InvalidValueError: no number where there must be one.
    """
    text = cells.texts[column]
    if text == "" or is_text(column):
        return text or None
    try:
        number = float(text)
        return int(number) if is_whole(column) else number
    except (ValueError, OverflowError):
        words = f"{column}: found '{text[:40]}', needs a number; the trace is damaged"
        raise InvalidValueError(f"{cells.place}: {words}") from None


def text(found: Value) -> str:
    """A value as a cell has it."""
    return "" if found is None else str(found)


def nested(cells: Cells) -> dict[str, Any]:
    """A row as JSON objects inside each other: ``{"q": {"RElbowRoll": 0.9}}``.

    JSON has no word for NaN and infinities; they are the texts "nan", "inf" and "-inf".
    """
    found: dict[str, Any] = {}
    for column in cells.texts:
        *into, last = split(column)
        inside = found
        for part in into:
            inside = inside.setdefault(part, {})
        number = value(cells, column)
        finite = not isinstance(number, float) or math.isfinite(number)
        inside[last] = number if finite else str(number)
    return found


def flat(place: str, found: Any) -> Cells:
    """The row that :func:`nested` was given.

    Raises:
        CoopqpError: it is no such object.
    """
    if not isinstance(found, dict):
        raise CoopqpError(f"{place}: found no row of a run; the file is damaged")
    texts: dict[str, str] = {}

    def unfold(inside: Mapping[str, Any], parts: tuple[str, ...]) -> None:
        for key, inner in inside.items():
            if isinstance(inner, dict) and len(parts) < 2:
                unfold(inner, (*parts, key))
            else:
                texts[joined((*parts, key))] = text(inner)

    unfold(found, ())
    check_needed(place, texts)
    return Cells(place, texts)


def check_needed(place: str, columns: Iterable[str]) -> None:
    """Refuse what is no recorded run.

    Raises:
        CoopqpError: a column that every run has is missing.
    """
    missing = sorted(NEEDED - set(columns))
    if missing:
        raise CoopqpError(f"{place}: holds no run of coopqp: has no column '{missing[0]}'")


def unit_of(scenario: Scenario) -> UnitOf:
    """A function from a column to its unit; "" where it has none, or nobody knows it.

    Args:
        scenario: as the controller holds it, :meth:`Scenario.held_by`.
    """
    chain = scenario.chain
    joints = dict(zip(chain.joint_names, chain.joint_units, strict=True))
    asked = _asked(scenario)
    axes = dict(zip(AXES, AXIS_UNITS, strict=True))

    def unit(column: str) -> str:
        if column in _FIXED:
            return _FIXED[column]
        name, key, part = (*split(column), "", "")[:3]
        of_joint, of_task = joints.get(key, ""), asked.get(key, "")
        return {
            **dict.fromkeys(("q", "commanded", "measured"), of_joint),
            "v": f"{of_joint}/s",
            "tau": {"rad": "N m", "m": "N"}.get(of_joint, ""),
            "gap": axes.get(part, ""),
            **dict.fromkeys(("error", "e"), of_task),
            "rate": f"{of_task}/s",
            "margin": part,
            "hand_wrench": "N m" if part.startswith("t") else "N",
            **_OF_HANDS,
        }.get(name, "")

    return unit


def _asked(scenario: Scenario) -> dict[str, str]:
    """Unit of each part and each row of all tasks, by their names in the trace."""
    found: dict[str, str] = {}
    for phase in scenario.schedule:
        begin = f"{phase.name}." if scenario.phases else ""
        for task in phase.tasks:
            parts = task.parts(scenario.chain)
            units = [part.unit for part in parts for _ in range(part.rows)]
            rows = zip(task.rows(scenario.chain), units, strict=True)
            found |= {f"{begin}{task.name}.{row}": unit for row, unit in rows}
            for part in parts:
                name = f"{task.name}.{part.name}" if part.name else task.name
                found[begin + name] = part.unit
    return found
