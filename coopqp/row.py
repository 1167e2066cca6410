"""What a row is: one line of a QP or of an audit, with everything that is said of it in words.

A row knows its name, its unit and what it belongs to, so that nobody has to read that out of the
name again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal

Kind = Literal["joint", "share", "loop", "task", "limit", "free", "dynamics", "motor", "hand"]
Side = Literal["lower", "upper"]


@dataclass(frozen=True, kw_only=True)
class Row:
    """One variable, equality, inequality or bound.

    Attributes:
        name: for people, such as "limit.position[RElbowRoll].upper".
        kind: what it belongs to.
        owner: which one of the kind: an arm for a loop, a task's or a limit's name.
        unit: of what it bounds or asks for, such as "rad" or "m/s".
        joint: whose, where it belongs to one joint.
        side: which, where there are two.
        label: what a sentence calls it, such as "RElbowRoll (upper)"; the name when empty.
        of_place: whether it bounds a place, so that its excess in a QP of velocities, times dt,
            has the unit given.
        bodies: the two whose distance it is; none for other rows.
        kept: distance that is kept free between them [m]; rows that differ in it alone are equal.
    """

    name: str
    kind: Kind
    owner: str = ""
    unit: str = ""
    joint: str = ""
    side: Side | None = None
    label: str = ""
    of_place: bool = False
    bodies: tuple[str, ...] = ()
    kept: float = field(default=0.0, compare=False)

    def __str__(self) -> str:
        return self.name

    @property
    def words(self) -> str:
        """What a sentence calls it."""
        return self.label or self.name


def names_of(rows: Sequence[Row]) -> tuple[str, ...]:
    """The names of rows, in their order."""
    return tuple(row.name for row in rows)


@lru_cache(maxsize=64)
def joint_rows(joints: tuple[str, ...], units: tuple[str, ...]) -> tuple[Row, ...]:
    """The velocities of joints, the variables of most QPs.

    Args:
        joints: their names.
        units: of their coordinates, "rad" or "m".
    """
    return tuple(
        Row(name=joint, kind="joint", unit=f"{unit}/s", joint=joint)
        for joint, unit in zip(joints, units, strict=True)
    )
