"""What a signal is: a value that changes with time, and its rate; what tasks follow.

A signal is a pure function of an instant: the time and the inputs that have arrived by then. It
gives its rate too, so that what follows it does not lag behind. What it is asked for is a kind:

    numbers      x,              x_dot
    rotation     quaternion of R, omega with R_dot = omega x R, in the axes in which R is given
    direction    the same; the third axis of R is the direction
    pose         both, numbers first

A constant value with a profile, as most tasks have, is the signal that stays where it is.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Annotated, Any, Protocol

import numpy as np
import pinocchio as pin
from pydantic import BeforeValidator, GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationInfo
from pydantic_core import core_schema

from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.spec import (
    FARTHEST,
    Array,
    Direction,
    Pose,
    Vector3,
    cross,
    read_only,
    real,
    spec,
    unit,
)
from coopqp.grasp import pose_matrix

#: How far from one the length of a quaternion may be, and how far from orthonormal a matrix.
SLOPPY = 1e-3
#: Numbers from here on are as good as infinite: their products could be.
ENDLESS = 1e100
#: Nothing that arms hold, and none of their joints, is faster [m/s, rad/s].
FASTEST = 1e3


@dataclass(frozen=True)
class Kind:
    """What a signal is asked for."""

    name: str  #: For messages.
    numbers: int  #: How many beside the rotation.
    turns: bool = False  #: Whether there is a rotation.
    columns: tuple[str, ...] = ()  #: Names of the values, as files have them.
    velocity: bool = False  #: Whether it is one, which is not to go on where nobody steers.
    axis: bool = False  #: Whether only the third axis of the rotation counts.
    each: bool = False  #: Whether bounds hold for each number, and not for the length of all.

    @property
    def values(self) -> int:
        """How many numbers a value has."""
        return self.numbers + 4 * self.turns

    @property
    def rates(self) -> int:
        """How many numbers a rate has."""
        return self.numbers + 3 * self.turns

    @property
    def value_columns(self) -> tuple[str, ...]:
        """Names of a value's numbers as it is kept, in traces."""
        return (*self.columns[: self.numbers], *(TURN_COLUMNS if self.turns else ()))

    @property
    def rate_columns(self) -> tuple[str, ...]:
        return (*self.columns[: self.numbers], *(TURN_RATES if self.turns else ()))

    @property
    def zero(self) -> Array:
        """A value that stands for none: zeros, not turned, shape (values,)."""
        return np.array([0.0] * self.numbers + [0.0, 0.0, 0.0, 1.0] * self.turns)

    def read(self, given: Any) -> Array:
        """A value as it is kept; InvalidValueError says why it is none.

        A direction is three numbers; a rotation four or a matrix, a pose also a matrix, a
        :class:`pinocchio.SE3` or a :class:`coopqp.base.spec.Pose`.
        """
        if isinstance(given, Pose):
            given = pose_matrix(given)
        found = self._array(given.homogeneous if isinstance(given, pin.SE3) else given)
        if self.axis and found.shape == (3,):
            return _kept_along(*found.tolist()).copy()
        if self.turns and found.ndim == 2:
            found = self._from_matrix(found)
        if found.shape != (self.values,):
            raise InvalidValueError(f"found shape {found.shape}, needs {self._needs()}")
        if self.turns:
            length = float(np.linalg.norm(found[self.numbers :]))
            if abs(length - 1.0) > SLOPPY:
                raise InvalidValueError(
                    f"found a quaternion of length {length:.4g}, needs one of length 1 (x, y, z, w)"
                )
            found[self.numbers :] /= length
        return found

    def _array(self, given: Any) -> Array:
        try:
            found = real(given)
        except ValueError as error:
            words = str(error).removesuffix(", needs numbers")
            with suppress(Exception):  # it may be an object that cannot say what it is
                words = f"found {given!r:.60}"
            raise InvalidValueError(f"{words}, needs {self._needs()}") from None
        if not (np.abs(found) < ENDLESS).all():
            raise InvalidValueError("has NaN or infinite values")
        return found

    def _from_matrix(self, found: Array) -> Array:
        """The numbers behind a matrix of a pose or of a rotation; others are left as they are."""
        if found.shape == (4, 4) and self.numbers:
            return np.concatenate([found[:3, 3], _quaternion(found[:3, :3])])
        return _quaternion(found) if found.shape == (3, 3) and not self.numbers else found

    def _needs(self) -> str:
        if self.axis:
            return "3 numbers"
        what = f"{self.values} numbers"
        return f"{what}: {', '.join(self.columns)}" if self.columns else what


TURN_COLUMNS = ("qx", "qy", "qz", "qw")
TURN_RATES = ("rot_x", "rot_y", "rot_z")
POINT = Kind("point", 3, columns=("x", "y", "z"))
ROTATION = Kind("rotation", 0, turns=True, columns=TURN_COLUMNS)
DIRECTION = Kind("direction", 0, turns=True, columns=POINT.columns, axis=True)
POSE = Kind("pose", 3, turns=True, columns=(*POINT.columns, *TURN_COLUMNS))
CLOCK = Kind("time along a way", 1, columns=("t",))


def of_joints(names: tuple[str, ...]) -> Kind:
    """Values of joints [rad, m]."""
    return Kind("joint values", len(names), columns=names, each=True)


def of_twist(axes: tuple[str, ...]) -> Kind:
    """Components of a velocity [m/s, rad/s]."""
    return Kind("velocity", len(axes), columns=axes, velocity=True)


class Trajectory:
    """Where something is and how it moves, in arrays that it reuses; at rest by itself.

    Attributes:
        value: shape (values,); a rotation as the quaternion x, y, z, w.
        rate: shape (rates,) [1/s]; of a rotation the angular velocity.
        moves: whether anything changes with time.
        arrives: name of the input that it is a copy of; empty where it is none.
    """

    moves = False
    arrives = ""

    def __init__(self, kind: Kind, value: Array) -> None:
        self.kind = kind
        self.value, self.rate = np.array(value, float), np.zeros(kind.rates)

    def update(self, at: Instant) -> None:
        """Go to where it is then."""
        return

    @property
    def R(self) -> Array:
        """The rotation, shape (3, 3)."""
        return matrix(self.value[self.kind.numbers :])

    def after(self, time: float) -> Array:
        """The value that much later at this rate [s], shape (values,)."""
        k, way = self.kind.numbers, time * self.rate
        if not self.kind.turns:
            return np.asarray(self.value + way)
        return np.concatenate([self.value[:k] + way[:k], quaternion_of(pin.exp3(way[k:]) @ self.R)])


class InputValues(dict[str, Trajectory]):
    """Filtered values of the inputs at an instant, by name.

    Attributes:
        wanted: what signals have asked for: kind, and value with which nothing would have to move.
        stale: of which nothing new has arrived in time.
        refused: of which what arrived could not be used, and why.
        arrived: by name, what has arrived for this tick and is used: when sent [s], and the value,
            shape (values,).
        ways: by the name of their clock, and of those of joints, for which it waits, the joints'.
    """

    def __init__(self) -> None:
        super().__init__()
        self.wanted: dict[str, tuple[Kind, Array | None]] = {}
        self.stale: tuple[str, ...] = ()
        self.refused: tuple[str, ...] = ()
        self.arrived: dict[str, tuple[float, Array]] = {}
        self.ways: dict[tuple[str, tuple[str, ...]], Trajectory] = {}

    def want(self, name: str, kind: Kind, here: Array | None) -> Trajectory | None:
        """The input of a name, if there is one yet; InvalidValueError where kinds differ."""
        other, place = self.wanted.setdefault(name, (kind, here))
        if (other.values, other.axis) != (kind.values, kind.axis):
            words = f"is wanted as a {other.name} and as a {kind.name}; use two inputs"
            raise InvalidValueError(f"input '{name}' {words}")
        if place is None:
            self.wanted[name] = kind, here
        return self.get(name)

    def shown(self) -> InputValues:
        """The same as it changes, for those who must not write to it."""
        if not self:
            return self
        seen = InputValues()
        seen.__dict__ = self.__dict__
        for name, followed in self.items():
            seen[name] = other = Trajectory(followed.kind, followed.value)
            other.value, other.rate = read_only(followed.value), read_only(followed.rate)
        return seen

    def now(self) -> InputValues:
        """The same, no more to be moved by whoever moves this."""
        kept = InputValues()
        kept.stale, kept.refused = self.stale, self.refused
        for name, followed in self.items():
            kept[name] = Trajectory(followed.kind, followed.value)
            kept[name].rate[:] = followed.rate
        return kept


class Instant(Protocol):
    """When a signal is asked: the time and what has arrived by then. A ``State`` is one."""

    @property
    def t(self) -> float: ...
    @property
    def inputs(self) -> InputValues: ...


@dataclass(frozen=True)
class Moment:
    """An instant t [s] since the references set out, without a state, for pictures."""

    t: float = 0.0
    inputs: InputValues = field(default_factory=InputValues)


@spec
class Signal(ABC):
    """A plug-in in ``signals/``: where a reference is at each time."""

    @abstractmethod
    def bind(self, kind: Kind, start: Instant, here: Array | None) -> Trajectory:
        """Prepare what does not change; InvalidValueError, with the key: it cannot be of this kind.

        The reference sets out at ``start``, where with the value ``here``, if there is one, nothing
        would have to move.
        """

    @property
    def rest(self) -> float:
        """From when on it stays where it is [s]; infinite where that is not known."""
        return np.inf


def trajectory_of(
    given: Signal | Pose | Array | tuple[float, ...] | list[float],
    kind: Kind,
    start: Instant,
    here: Array | None = None,
) -> Trajectory:
    """A signal, or a constant as :meth:`Kind.read` takes it, to follow; as :meth:`Signal.bind`."""
    if isinstance(given, Signal):
        return given.bind(kind, start, here)
    return Trajectory(kind, kind.read(given))


def check_places(key: str, numbers: Array) -> None:
    """InvalidValueError: a number (none of a quaternion) is beyond what any place can be."""
    size = float(np.abs(numbers).max(initial=0.0))
    if size > FARTHEST:
        needs = f"needs at most {FARTHEST:g} (metres, radians; of forces N)"
        raise InvalidValueError(f"{key}: found {size:g}, {needs}")


def check_speed(key: str, speed: float) -> None:
    """InvalidValueError: a speed [m/s, rad/s, N/s] is beyond that of any arm."""
    if speed > FASTEST:
        words = f"goes at {speed:.3g} m/s (rad/s; of forces N/s), needs at most {FASTEST:g}"
        raise InvalidValueError(f"{key}: {words}; times are seconds")


def matrix(quaternion: Array) -> Array:
    """The rotation of a quaternion x, y, z, w, shape (3, 3)."""
    x, y, z, w = quaternion.tolist()
    R: Array = pin.Quaternion(w, x, y, z).toRotationMatrix()
    return R


def quaternion_of(R: Array) -> Array:
    """The quaternion x, y, z, w of a rotation, shape (4,)."""
    found: Array = np.array(pin.Quaternion(R).coeffs())
    return found


def axes_along(direction: Vector3 | Array) -> Array:
    """Right-handed unit axes as rows, the third along the direction, shape (3, 3).

    The first is the world axis that is farthest from the direction, made normal to it.
    """
    x, y, z = direction
    d = unit((x, y, z))
    farthest = int(np.argmin(np.abs(d)))
    first = np.eye(3)[farthest] - d[farthest] * d
    first /= np.linalg.norm(first)
    return np.array([first, cross(d, first), d])


def shortest_way(a: Array, b: Array) -> Array:
    """Rotation vector of the shortest way from one unit vector to another, shape (3,)."""
    across, cosine = np.cross(a, b), float(a @ b)
    sine = float(np.linalg.norm(across))
    if sine > 1e-9:
        return np.asarray(across * (math.atan2(sine, cosine) / sine))
    if cosine > 0.0:
        return np.zeros(3)
    aside = np.eye(3)[int(np.argmin(np.abs(a)))]  # opposite: any way is as short
    across = np.cross(a, aside)
    return np.asarray(math.pi * across / np.linalg.norm(across))


@lru_cache(maxsize=1024)
def _kept_along(x: float, y: float, z: float) -> Array:
    """Every reference asks for some direction, mostly straight up."""
    direction = np.array([x, y, z])
    if np.linalg.norm(direction) < 1e-9:
        raise InvalidValueError("needs a direction, but all three numbers are zero")
    return quaternion_of(axes_along(direction).T)


def _quaternion(R: Array) -> Array:
    if np.abs(R.T @ R - np.eye(3)).max() > SLOPPY or np.linalg.det(R) < 0.0:
        raise InvalidValueError("is no rotation: its matrix is not orthonormal and right-handed")
    u, _, vt = np.linalg.svd(R)
    return quaternion_of(u @ vt)


class Reads:
    """Lets a field of a task be a constant, or a signal spelled as in a scenario file.

    ``constant`` is the constant's type, None where only a signal will do; ``kind`` is None where it
    depends on the robot. With ``mapping`` a mapping may be a constant, too.
    """

    def __init__(self, constant: Any, kind: Kind | None = None, *, mapping: bool = False) -> None:
        self.constant = _Nothing if constant is None else constant
        self.kind, self.mapping = kind, mapping

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """A constant checked as ever, unless it is a signal."""

        def read(value: Any, constant: Callable[[Any], Any], info: ValidationInfo) -> Any:
            found = self._signal(value, info)
            return constant(value) if found is None else found

        inner = handler.generate_schema(self.constant)
        return core_schema.with_info_wrap_validator_function(read, inner)

    def __get_pydantic_json_schema__(
        self, core: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """The constant, or one signal by name."""
        return {"anyOf": [handler(core), SPELLING]}

    def _signal(self, value: Any, info: ValidationInfo) -> Signal | None:
        if not isinstance(value, Signal):
            read: ReadSignal | None = (info.context or {}).get("signal")
            if read is None or not isinstance(value, dict):
                return None
            value = read(value, not self.mapping)
        if value is not None and self.kind is not None:
            try:
                value.bind(self.kind, Moment(0.0), None)
            except CoopqpError as error:
                raise ValueError(str(error)) from None
        found: Signal | None = value
        return found


ReadSignal = Callable[[dict[str, Any], bool], Signal | None]
"""A mapping from a scenario file as a signal; None, or refused, where it names none."""

SPELLING = {
    "type": "object",
    "minProperties": 1,
    "maxProperties": 1,
    "description": "A signal by name, with its fields, such as {input: target}.",
}


def _no_constant(value: Any) -> None:
    if value is not None:
        raise ValueError("needs a signal, such as {input: target}")


_Nothing = Annotated[None, BeforeValidator(_no_constant)]

#: Fields of tasks: a constant, or a signal.
MovingPoint = Annotated[Vector3 | Signal, Reads(Vector3, POINT)]
MovingDirection = Annotated[Direction | Signal, Reads(Direction, DIRECTION)]
MovingPose = Annotated[Pose | Signal, Reads(Pose, POSE, mapping=True)]
MovingRotation = Annotated[Signal | None, Reads(None, ROTATION)]
