"""What a task or a limit shows of itself in pictures: markers in the world, at one instant.

A marker without a place of its own, such as a direction to point along, is drawn at the object.
Arrays, lists and tuples may be given; they are kept as arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import PlainValidator

from coopqp.base.spec import Array, Positive, Vector3, spec
from coopqp.base.wording import raised

#: How far R R' may be from the identity.
ORTHONORMAL = 1e-6


def _finite(value: Any, shape: tuple[int, ...]) -> Array:
    """A copy, since references reuse their arrays."""
    try:
        array = np.array(value, float)
    except TypeError:
        array = np.zeros(0)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"needs {' x '.join(map(str, shape))} finite numbers")
    return array


def _direction(value: Any) -> Array:
    vector = _finite(value, (3,))
    length = np.linalg.norm(vector)
    if not length > 0.0:
        raise ValueError("needs a direction, but all three numbers are zero")
    return np.asarray(vector / length, float)


def _rotation(value: Any) -> Array:
    R = _finite(value, (3, 3))
    if np.abs(R @ R.T - np.eye(3)).max() > ORTHONORMAL or np.linalg.det(R) < 0.0:
        raise ValueError("needs a rotation matrix")
    return R


Point = Annotated[Array, PlainValidator(lambda value: _finite(value, (3,)))]
"""Shape (3,) [m]."""
UnitVector = Annotated[Array, PlainValidator(_direction)]
"""Shape (3,); given with any length."""
Rotation = Annotated[Array, PlainValidator(_rotation)]
"""Shape (3, 3)."""


@spec
class PointMarker:
    """A point."""

    at: Point


@spec
class LineMarker:
    """A line without ends."""

    direction: UnitVector
    through: Point | None = None
    """A point of it; None where only the direction counts."""


@spec
class PlaneMarker:
    """A plane without ends."""

    normal: UnitVector
    through: Point


@spec
class CircleMarker:
    """A circle, the line and not the disc."""

    center: Point
    normal: UnitVector
    radius: Positive
    """[m]"""


@spec
class SphereMarker:
    """The surface of a ball."""

    center: Point
    radius: Positive
    """[m]"""


@spec
class SolidMarker:
    """A body that stands still; seen where it is at first, in all frames."""

    kind: Literal["mesh", "box", "cylinder", "capsule", "sphere", "ellipsoid"]
    """What it is, with its size as in :class:`coopqp.robot.Shape`."""
    size: tuple[float, ...]
    """[m], of a mesh the scale."""
    rotation: Rotation
    position: Point
    mesh: Path | None = None
    """File of a mesh."""


@spec
class PoseMarker:
    """Axes of a frame, the columns of its rotation."""

    rotation: Rotation
    position: Point | None = None
    """Its origin; None where only the orientation counts."""


@spec
class TrackedMarker:
    """The point of the object that a task steers; its way is drawn."""

    point: Vector3 = (0.0, 0.0, 0.0)
    """In the object frame, with which it moves [m]; not in the world as the others."""


@spec
class PostureMarker:
    """Values that joints go to; drawn as the arms would stand, other joints as they are."""

    goal: dict[str, float | list[float]] | list[float]
    """By arm (base first) or joint, or all of them in the order of the joints [rad, m]."""


@spec
class RelativeMarker:
    """Axes of a frame, the columns of its rotation, that moves with the first arm."""

    rotation: Rotation
    """The axes as columns, in that arm's object frame."""
    position: Point
    """Its origin, in that arm's object frame; not in the world as the others."""


Marker = (
    PointMarker
    | LineMarker
    | PlaneMarker
    | CircleMarker
    | SphereMarker
    | SolidMarker
    | PoseMarker
    | TrackedMarker
    | PostureMarker
    | RelativeMarker
)


def markers_fault(marks: object) -> str:
    """What of something given as marks is none; empty where all are."""
    *others, last = (kind.__name__ for kind in get_args(Marker))
    if not isinstance(marks, tuple | list):
        return f"{type(marks).__name__}, needs a tuple of marks"
    strange = [mark for mark in marks if not isinstance(mark, Marker)]
    if not strange:
        return ""
    return f"{type(strange[0]).__name__} among its marks, needs {', '.join(others)} or {last}"


def marks_of(
    name: str, marks: Callable[[], Sequence[Marker]], faults: list[str]
) -> tuple[Marker, ...]:
    """The markers of a task or a limit; none, and a sentence in ``faults``, where code fails."""
    try:
        found = marks()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # noqa: BLE001 - code of plug-ins may raise anything
        wrong = raised(error)
    else:
        wrong = markers_fault(found)
    if not wrong:
        return tuple(found)
    faults.append(f"{name}.marks: {wrong}")
    return ()
