"""What makes a class in a file a plug-in, and what to say of one that is none.

The YAML name of a plug-in is the name of its file. A file holds one class of its collection's kind,
an ``@spec`` class that inherits from its idea and from nothing else, with all methods written.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import typing
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType

from pydantic.dataclasses import is_pydantic_dataclass

from coopqp.base.errors import Fault
from coopqp.controller import Controller, Law
from coopqp.grasp import Grasp
from coopqp.limit import Limit
from coopqp.metric import Metric
from coopqp.plant import Plant, PlantModel
from coopqp.robot import Robot
from coopqp.signal import Signal
from coopqp.solver import Solver
from coopqp.task import Task

#: Collections in the order they are listed: folder and what its classes are.
COLLECTIONS: dict[str, type] = {
    "robots": Robot,
    "grasps": Grasp,
    "tasks": Task,
    "signals": Signal,
    "limits": Limit,
    "controllers": Controller,
    "solvers": Solver,
    "plants": Plant,
    "metrics": Metric,
}

#: What plug-ins build; written in the same files, and as easily left half-written.
BUILT = (Law, PlantModel)


@dataclass(frozen=True)
class Entry:
    """One plug-in; its name in YAML is that of its file."""

    name: str
    cls: type
    help: str


@functools.cache
def entry_of(name: str, module: ModuleType, kind: str) -> Entry | Fault:
    """The plug-in that a module holds, or what is wrong with it."""
    base = COLLECTIONS[kind]
    inside = (value for value in vars(module).values() if inspect.isclass(value))
    written = [cls for cls in dict.fromkeys(inside) if cls.__module__ == module.__name__]
    classes = [cls for cls in written if issubclass(cls, base)]
    if len(classes) != 1:
        return _miscounted(module, base, written, classes)
    (cls,) = classes
    for part in (cls, *(other for other in written if issubclass(other, BUILT))):
        if wrong := _wrong_with(part, base):
            return Fault(f"{module.__file__}:{_line(part)}", wrong)
    return Entry(name, cls, (cls.__doc__ or "").strip().split("\n", 1)[0])


def _miscounted(
    module: ModuleType, base: type, written: Sequence[type], classes: Sequence[type]
) -> Fault:
    found = f"needs exactly one {base.__name__} class, found {len(classes)}"
    if classes:
        names = ", ".join(cls.__name__ for cls in classes)
        place = f"{module.__file__}:{_line(classes[1])}"
        return Fault(place, f"{found}: {names}; give each a file of its own")
    for cls in written:
        for kind, other in COLLECTIONS.items():
            if issubclass(cls, other):
                place = f"{module.__file__}:{_line(cls)}"
                words = f"{cls.__name__} is a {other.__name__}; move the file into {kind}"
                return Fault(place, f"{found}; {words}")
    words = f"write 'class NAME({base.__name__}):', or let the name of a helper's file begin with _"
    return Fault(str(module.__file__), f"{found}; {words}")


def _wrong_with(cls: type, base: type) -> str:
    """What keeps a class from being used; empty when nothing does."""
    if missing := sorted(getattr(cls, "__abstractmethods__", ())):
        methods = " and ".join(f"'{name}'" for name in missing)
        return f"{cls.__name__} is half-written; it needs {methods}"
    if issubclass(cls, BUILT):
        return ""
    if strangers := [b.__name__ for b in cls.__bases__ if b is not base]:
        return (
            f"{cls.__name__} inherits from {' and '.join(strangers)}; a plug-in inherits from "
            f"{base.__name__} and from nothing else"
        )
    if not (is_pydantic_dataclass(cls) and cls.__dataclass_params__.frozen):  # type: ignore[attr-defined]
        return f"{cls.__name__} needs '@spec' above it: from coopqp import spec"
    try:
        typing.get_type_hints(cls)
    except NameError as error:  # deferred annotations are only looked up now
        return f"{cls.__name__} has a field whose type is not known: {error}"
    if base is Metric and (needed := [f.name for f in dataclasses.fields(cls) if _needed(f)]):
        return f"'{needed[0]}' needs a default, because scenarios have no keys for metrics"
    return ""


def _needed(field: dataclasses.Field[object]) -> bool:
    return field.default is field.default_factory is dataclasses.MISSING


def _line(cls: type) -> int:
    """Where a class begins in its file."""
    return inspect.getsourcelines(cls)[1]
