"""From a name to its file to its class: what can be written in a scenario, and where it comes from.

The YAML name of a plug-in is the name of its file in the collection's folder. Nothing is
registered: a new file is found because it is there. A file holds one class of its kind; a file
whose name begins with ``_`` holds helpers of its collection.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import pkgutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from coopqp.controller import Controller
from coopqp.errors import CoopqpError, UnknownNameError
from coopqp.grasp import Grasp
from coopqp.limit import Limit
from coopqp.metric import Metric
from coopqp.plant import Plant
from coopqp.robot import Robot
from coopqp.solver import Solver
from coopqp.task import Task

#: Collections in the order they are listed: folder and what its classes are.
COLLECTIONS: dict[str, type] = {
    "robots": Robot,
    "grasps": Grasp,
    "tasks": Task,
    "limits": Limit,
    "controllers": Controller,
    "solvers": Solver,
    "plants": Plant,
    "metrics": Metric,
}


@dataclass(frozen=True)
class Entry:
    """One plug-in.

    Attributes:
        name: in YAML, and of its file.
        cls: its class.
        help: one line.
    """

    name: str
    cls: type
    help: str


class Catalog:
    """Everything that scenarios can name.

    Args:
        task_folders: folders with the user's own task files.

    Raises:
        CoopqpError: a user's task file cannot be read, or takes a name that exists.
    """

    def __init__(self, task_folders: tuple[Path, ...] = ()) -> None:
        self._collections: dict[str, dict[str, Entry]] = {
            kind: {entry.name: entry for entry in _shipped(kind)} for kind in COLLECTIONS
        }
        for folder in task_folders:
            for entry in _users_tasks(folder):
                if entry.name in self._collections["tasks"]:
                    raise CoopqpError(
                        f"{folder}: a task '{entry.name}' exists already; rename the file"
                    )
                self._collections["tasks"][entry.name] = entry

    def entries(self, kind: str) -> dict[str, Entry]:
        """The plug-ins of one collection by name.

        Args:
            kind: a collection, such as "tasks".
        """
        return self._collections[kind]

    def find(self, kind: str, name: str) -> type:
        """The class behind a name.

        Raises:
            UnknownNameError: with the nearest names.
        """
        known = self.entries(kind)
        if name not in known:
            raise UnknownNameError(kind.removesuffix("s"), name, known)
        return known[name].cls


def _shipped(kind: str) -> Iterator[Entry]:
    package = importlib.import_module(f"coopqp.{kind}")
    names = sorted(module.name for module in pkgutil.iter_modules(package.__path__))
    for name in (name for name in names if not name.startswith("_")):
        loaded = importlib.import_module(f"coopqp.{kind}.{name}")
        yield _entry(name, loaded, kind)


def _users_tasks(folder: Path) -> Iterator[Entry]:
    files = sorted(p for p in folder.glob("*.py") if not p.name.startswith("_"))
    if not files:
        raise CoopqpError(f"{folder}: no task files (*.py) here")
    for file in files:
        spec = importlib.util.spec_from_file_location(f"coopqp_user_tasks.{file.stem}", file)
        assert spec is not None  # it ends in .py
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except Exception as error:
            raise CoopqpError(f"{file}: cannot be imported: {error}") from error
        yield _entry(file.stem, module, "tasks")


def _entry(name: str, module: ModuleType, kind: str) -> Entry:
    base = COLLECTIONS[kind]
    classes = [
        cls
        for _, cls in inspect.getmembers(module, inspect.isclass)
        if issubclass(cls, base) and cls is not base and cls.__module__ == module.__name__
    ]
    if len(classes) != 1:
        raise CoopqpError(
            f"{module.__file__}: needs exactly one {base.__name__} class, found {len(classes)}"
        )
    doc = inspect.getdoc(classes[0]) or ""
    return Entry(name, classes[0], doc.split("\n", 1)[0])
