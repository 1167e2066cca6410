"""The frozen, checked dataclass that every plug-in and every part of a scenario is, and its types.

``@spec`` is pydantic's dataclass with the same three settings everywhere: frozen, keyword-only,
and no unknown keys, NaN or infinity. The same class therefore reads a YAML mapping and serves as
Python API, with one set of checks and one JSON Schema.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field
from pydantic.dataclasses import dataclass
from typing_extensions import dataclass_transform

T = TypeVar("T")

Array = NDArray[np.float64]
"""An array of numbers, as all signatures have it."""

CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(Field,))
def spec(cls: type[T]) -> type[T]:
    """Make a class a frozen, keyword-only, validated dataclass.

    Building one with a wrong value raises ``pydantic.ValidationError``, a ``ValueError`` that
    names the field, what was found and what is allowed.
    """
    checked: Any = dataclass(frozen=True, kw_only=True, config=CONFIG)(cls)
    return cast(type[T], checked)


def type_name(plugin: object) -> str:
    """The name of a plug-in's type in YAML, which is that of its file."""
    return type(plugin).__module__.rpartition(".")[2]


def _three(value: Any) -> Any:
    """Let numpy arrays be given, and say how many numbers are needed."""
    return numbers(value, 3)


def numbers(value: Any, count: int) -> Any:
    """A list, tuple or array of ``count`` numbers as a list; other values are left to pydantic.

    Raises:
        ValueError: it has another length.
    """
    listed = value.tolist() if isinstance(value, np.ndarray) else value
    if not isinstance(listed, list | tuple) or len(listed) != count:
        raise ValueError(f"needs {count} numbers")
    return listed


def _not_zero(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if math.hypot(*value) < 1e-9:
        raise ValueError("needs a direction, but all three numbers are zero")
    return value


Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]
Vector3 = Annotated[tuple[float, float, float], BeforeValidator(_three)]
Lengths3 = Annotated[tuple[Positive, Positive, Positive], BeforeValidator(_three)]
Direction = Annotated[Vector3, AfterValidator(_not_zero)]
"""A vector of any length but zero; only its direction counts."""


@spec
class Pose:
    """A position [m] and an orientation as roll, pitch, yaw about fixed x, y, z [rad]."""

    position: Vector3 = (0.0, 0.0, 0.0)
    """[m]"""
    rpy: Vector3 | None = None
    """Roll, pitch, yaw [rad]."""
    rpy_deg: Vector3 | None = None
    """Roll, pitch, yaw [degrees]; instead of rpy."""

    def __post_init__(self) -> None:
        one_angle("rpy", self.rpy, self.rpy_deg)

    @property
    def angles(self) -> tuple[float, ...]:
        """Roll, pitch, yaw [rad], zero when neither key was given."""
        if self.rpy_deg is not None:
            return tuple(math.radians(angle) for angle in self.rpy_deg)
        return self.rpy or (0.0, 0.0, 0.0)


def one_angle(name: str, radians: object, degrees: object, *, needed: bool = False) -> None:
    """Refuse an angle that is given twice, or not at all when it is needed.

    Raises:
        ValueError: both or, if needed, neither of the two keys was given.
    """
    if radians is not None and degrees is not None:
        raise ValueError(f"give {name} (radians) or {name}_deg (degrees), not both")
    if needed and radians is None and degrees is None:
        raise ValueError(f"needs {name} (radians) or {name}_deg (degrees)")


def unit(direction: tuple[float, float, float]) -> Array:
    """The direction as a unit vector, shape (3,)."""
    vector = np.array(direction, float)
    vector /= np.linalg.norm(vector)
    return vector
