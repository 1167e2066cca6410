"""The frozen, checked dataclass that every plug-in and every part of a scenario is, and its types.

``@spec`` is pydantic's dataclass with the same three settings everywhere: frozen, keyword-only,
and no unknown keys, NaN or infinity. The same class therefore reads a YAML mapping and serves as
Python API, with one set of checks and one JSON Schema.
"""

from __future__ import annotations

import ast
import functools
import inspect
import itertools
import math
import re
import textwrap
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Annotated, Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, ValidationError
from pydantic.dataclasses import dataclass
from typing_extensions import dataclass_transform

from coopqp.base import wording
from coopqp.base.errors import InvalidValueError

T = TypeVar("T")

Array = NDArray[np.float64]
"""An array of numbers, as all signatures have it."""

UNLIMITED = math.pi
"""How far a joint without limits is looked for to either side [rad, m]."""

FARTHEST = 1e4
"""No robot is farther from anything than this [m], and no joint has turned more [rad]; rounding
would be all that is left of a motion."""


def _explain(schema: dict[str, Any], cls: type) -> None:
    """Describe a JSON Schema's keys; pydantic's own way reads all sources at import."""
    words = field_docs(cls)
    for key, value in schema.get("properties", {}).items():
        if key in words:
            value["description"] = words[key]


def field_docs(cls: type) -> dict[str, str]:
    """The docstring under each field of a class or its bases; empty where there is no source."""
    return {key: text for base in reversed(cls.__mro__) for key, text in _own_docs(base).items()}


@functools.cache
def _own_docs(cls: type) -> dict[str, str]:
    """The same of one class without its bases; every source is read once."""
    found: dict[str, str] = {}
    with suppress(OSError, TypeError):
        (node,) = ast.parse(textwrap.dedent(inspect.getsource(cls))).body
        for field, words in itertools.pairwise(getattr(node, "body", [])):
            match field, words:
                case ast.AnnAssign(ast.Name(key)), ast.Expr(ast.Constant(str(text))):
                    found[key] = inspect.cleandoc(text)
    return found


CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False, json_schema_extra=_explain)


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(Field,))
def spec(cls: type[T]) -> type[T]:
    """Make a class a frozen, keyword-only dataclass that checks its values.

    Building one with wrong values raises one ``InvalidValueError`` that names each of them, what
    was found and what is allowed, in the words of a scenario file's faults.
    """
    checked: Any = dataclass(frozen=True, kw_only=True, config=CONFIG)(cls)
    checked.__init__ = _in_our_words(checked.__init__)
    return cast(type[T], checked)


def _in_our_words(build: Callable[..., None]) -> Callable[..., None]:
    """An ``__init__`` without pydantic's errors, which inside of other specs keep their places."""

    @functools.wraps(build)
    def build_or_refuse(self: Any, *args: Any, **values: Any) -> None:
        try:
            build(self, *args, **values)
        except ValidationError as error:
            name, found = type(self).__name__, wording.faults(error, values, type(self))
            lines = (f"{wording.dotted((name, *place))}: {message}" for place, message in found)
            raise InvalidValueError("\n".join(lines)) from None

    return build_or_refuse


def type_name(cls: type) -> str:
    """YAML name of a plug-in's type: that of its file, or of a class in a script, in snake_case."""
    folder, _, file = cls.__module__.rpartition(".")
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", cls.__name__)
    return file if folder else words.lower()


def taken_names(names: Sequence[str]) -> Iterator[tuple[int, str]]:
    """Index of each name that another one before it has, and what is wrong with it."""
    for i, name in enumerate(names):
        if name in names[:i]:
            yield i, f"the name '{name}' is taken"


def overshoot(gain: float, dt: float) -> str:
    """What is wrong with a gain [1/s] that takes back more than all in a tick dt [s]; or empty."""
    if gain * dt <= 1.0 + 1e-9:
        return ""
    return f"gain {gain} 1/s overshoots; needs at most 1/dt = {1.0 / dt:g} 1/s"


def numbers(value: Any, count: int) -> Any:
    """A list, tuple or array of ``count`` numbers as a list, else ValueError."""
    listed = value.tolist() if isinstance(value, np.ndarray) else value
    if not isinstance(listed, list | tuple) or len(listed) != count:
        raise ValueError(f"needs {count} numbers")
    return listed


def array(name: str, values: ArrayLike) -> Array:
    """Real numbers from Python, NaN and infinities too, as a new array, or InvalidValueError."""
    try:
        return real(values)
    except ValueError:
        raise InvalidValueError(f"{name}: found {values!r}, needs numbers") from None


def real(values: Any) -> Array:
    """What arrives while a loop runs, as a new array; ValueError says why it is not real numbers.

    numpy makes numbers of much that is none: of complex ones it drops a part, of masked values the
    mask; True is 1, a text its number, and None is NaN. It warns nobody.
    """
    if type(values) is np.ndarray and values.dtype == np.float64:
        return values.copy()
    try:
        if type(values) in (list, tuple) and all(type(x) in (float, int) for x in values):
            return np.array(values, float)
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            return _real(values)
    except (KeyboardInterrupt, ValueError):
        raise
    except OverflowError:
        raise ValueError("found a whole number beyond 1e308, needs numbers") from None
    except BaseException as error:  # noqa: BLE001 - an object of a user's may raise anything
        words = f"found {type(values).__name__}: it raises {type(error).__name__}"
        raise ValueError(words) from None


def _real(values: Any) -> Array:
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        raise ValueError("has masked values")
    if isinstance(values, list | tuple):
        for x in np.array(values, object).flat:
            if x is np.ma.masked:
                raise ValueError("has masked values")
            if isinstance(x, bool | np.bool_ | str | bytes):
                raise ValueError(f"{_NO_NUMBERS[np.array(x).dtype.kind]}, needs numbers")
    try:
        found = np.array(values)
    except (TypeError, ValueError):
        raise ValueError("found lists of different lengths, needs numbers") from None
    kind = found.dtype.kind
    if kind == "O" and not any(x is None or isinstance(x, bool | str | bytes) for x in found.flat):
        with suppress(TypeError, ValueError):
            return found.astype(float)
    if kind not in "iuf":
        words = _NO_NUMBERS.get(kind, f"found {type(values).__name__}")
        raise ValueError(f"{words}, needs numbers")
    return found.astype(float)


def read_only(array: Array) -> Array:
    """A view to which nobody can write, nor make it so that they can; of a writeable array."""
    return np.asarray(memoryview(array).toreadonly())  # type: ignore[arg-type]


_NO_NUMBERS = {
    "c": "found complex numbers",
    "b": "found true or false",
    "U": "found a text",
    "S": "found bytes",
}


def vector(name: str, values: ArrayLike, n: int) -> Array:
    """The same for n numbers, shape (n,); InvalidValueError where they are not n."""
    found = array(name, values)
    if found.shape != (n,):
        raise InvalidValueError(f"{name}: found shape {found.shape}, needs ({n},)")
    return found


def finite(name: str, found: Array) -> Array:
    """The array as it is; InvalidValueError where a number is NaN or infinite."""
    if not np.isfinite(found).all():
        raise InvalidValueError(f"{name}: found {found.tolist()}, needs finite numbers")
    return found


def near(key: str, found: Array) -> Array:
    """The array of a key of joint values; InvalidValueError beyond what joints reach [rad, m]."""
    if np.abs(finite(key, found)).max(initial=0.0) > FARTHEST:
        words = f"found {found.tolist()}, needs at most {FARTHEST:g} rad or m"
        raise InvalidValueError(f"{key}: {words}").at(key)
    return found


def seeded(seed: int) -> np.random.Generator:
    """Random numbers that are the same for equal seeds; InvalidValueError for negative ones."""
    if seed < 0:
        raise InvalidValueError(f"seed: found {seed}, needs at least 0")
    return np.random.default_rng(seed)


def _not_zero(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if math.hypot(*value) < 1e-9:
        raise ValueError("needs a direction, but all three numbers are zero")
    return value


Positive = Annotated[float, Field(gt=0.0)]
Name = Annotated[str, Field(min_length=1)]
NonNegative = Annotated[float, Field(ge=0.0)]
_THREE = BeforeValidator(lambda value: numbers(value, 3))
Vector3 = Annotated[tuple[float, float, float], _THREE]
Lengths3 = Annotated[tuple[Positive, Positive, Positive], _THREE]
Vector6 = Annotated[
    tuple[float, float, float, float, float, float],
    BeforeValidator(lambda value: numbers(value, 6)),
]
Direction = Annotated[Vector3, AfterValidator(_not_zero)]
"""A vector of any length but zero; only its direction counts."""


TWO_TURNS = 4.0 * math.pi
"""Nobody writes larger angles [rad]."""


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
        if (away := math.hypot(*self.position)) > FARTHEST:
            raise ValueError(f"position: found {away:g} m, needs at most {FARTHEST:g} m")
        if self.rpy and max(map(abs, self.rpy)) > TWO_TURNS:
            raise ValueError(f"rpy: found {max(self.rpy, key=abs):g} rad; did you mean rpy_deg?")

    @property
    def angles(self) -> tuple[float, ...]:
        """Roll, pitch, yaw [rad], zero when neither key was given."""
        if self.rpy_deg is not None:
            return tuple(math.radians(angle) for angle in self.rpy_deg)
        return self.rpy or (0.0, 0.0, 0.0)


def one_angle(name: str, radians: object, degrees: object, *, needed: bool = False) -> None:
    """Raise ValueError where an angle is given twice, or not at all when it is needed."""
    if radians is not None and degrees is not None:
        raise ValueError(f"give {name} (radians) or {name}_deg (degrees), not both")
    if needed and radians is None and degrees is None:
        raise ValueError(f"needs {name} (radians) or {name}_deg (degrees)")


def unit(direction: tuple[float, float, float]) -> Array:
    """The direction as a unit vector, shape (3,)."""
    vector = np.array(direction, float)
    vector /= np.linalg.norm(vector)
    return vector


def cross(a: Array, b: Array) -> Array:
    """The same as :func:`numpy.cross` of two vectors, shape (3,), in a tenth of its time."""
    x, y, z = a.tolist()
    u, v, w = b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])
