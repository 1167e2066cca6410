"""From a name to its class: what can be written in a scenario, and where it comes from.

Nothing is registered: a file is found because it is there, in coopqp, in an installed package or in
a folder of the user's, which has the collections' names as subfolders. The YAML name of a plug-in
is the name of its file, which holds one ``@spec`` class that inherits from its idea, or from an
abstract class of it, and from nothing else, with all methods written. Names that begin with ``_``
are helpers; files of one subfolder import them by ``from ._helper import x``.

A package brings plug-ins along when an entry point of the group ``coopqp.plugins`` names a package
of the same shape:

    [project.entry-points."coopqp.plugins"]
    my_lab = "my_lab.plugins"           # with my_lab/plugins/tasks/hold_height.py

A user's folder is a package, so that its modules can be imported, relatively too, and pickled. It
is named after its whole path: two folders never share a name, and a process that has never heard of
the folder, such as a worker, finds its modules by name alone.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import inspect
import keyword
import os
import sys
import typing
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from itertools import chain
from pathlib import Path
from types import ModuleType

from pydantic import BaseModel, PydanticUserError
from pydantic.dataclasses import is_pydantic_dataclass

from coopqp.base.errors import CoopqpError, Fault, unknown_name
from coopqp.base.reading import absolute, version
from coopqp.base.wording import message_of, place_of
from coopqp.controller import Controller, Law
from coopqp.grasp import Grasp
from coopqp.limit import Limit
from coopqp.metric import OF_STUDIES, Metric
from coopqp.plant import Plant, PlantModel
from coopqp.robot import Robot
from coopqp.signal import Signal
from coopqp.solver import Solver
from coopqp.task import Task

GROUP = "coopqp.plugins"
#: Makes this module the parent of the users' folders, whose names begin so.
__path__: list[str] = []
FOLDER = f"{__name__}.at_"

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
    if missing := sorted(getattr(cls, "__abstractmethods__", ())):
        methods = " and ".join(f"'{name}'" for name in missing)
        return f"{cls.__name__} is half-written; it needs {methods}"
    if issubclass(cls, BUILT):
        return ""
    abstract = (b for b in cls.__bases__ if issubclass(b, base) and inspect.isabstract(b))
    if strangers := [b.__name__ for b in cls.__bases__ if b not in {*abstract}]:
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
    for field in dataclasses.fields(cls) if base is Metric else ():
        if field.default is field.default_factory is dataclasses.MISSING:
            return f"'{field.name}' needs a default, because scenarios have no keys for metrics"
    return ""


def _line(cls: type) -> int:
    return inspect.getsourcelines(cls)[1]


class _Finder(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        name = fullname.removeprefix(FOLDER)
        if name == fullname or "." in name:
            return None
        spec = ModuleSpec(fullname, None, is_package=True)
        spec.submodule_search_locations = [os.fsdecode(bytes.fromhex(name))]
        return spec


sys.meta_path.append(_Finder())


def _package_of(folder: Path) -> str:
    return f"{FOLDER}{os.fsencode(folder).hex()}"


@dataclass(frozen=True)
class Shelf:
    """One collection's folder."""

    kind: str
    folder: Path
    package: str

    def entries(self) -> Iterator[Entry | Fault]:
        """The plug-ins here; a fault for each file that is none."""
        importlib.invalidate_caches()  # files may be younger than Python's list of them
        files = sorted(p for p in self.folder.glob("*.py") if not p.name.startswith("_"))
        if not files:
            word = self.kind.removesuffix("s")
            words = f"no {word} files (*.py) here; each {word} needs a file of its own"
            yield Fault(str(self.folder), words)
        for file in files:
            yield self._entry(file)

    def _entry(self, file: Path) -> Entry | Fault:
        name = file.stem
        if wrong := _wrong_name(name, self.kind):
            return Fault(str(file), f"{wrong}; rename the file")
        module = f"{self.package}.{name}"
        try:
            found = entry_of(name, importlib.import_module(module), self.kind)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 - a user's file may raise anything
            place = place_of(error, lambda name: Path(name).parent == file.parent) or str(file)
            found = Fault(place, f"cannot be imported: {_message(error)}")
        if isinstance(found, Fault):
            sys.modules.pop(module, None)  # so that the mended file is read
        return found


def installed() -> Iterator[Shelf | Fault]:
    """What installed packages bring along."""
    for point in _points(tuple(version(Path(place)) for place in sys.path)):
        place = f"entry point {point.name} = {point.value} of {GROUP}"
        try:
            package = importlib.import_module(point.value)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 - a package may raise anything
            words = f"cannot be imported: {_message(error)}; mend or uninstall its package"
            yield Fault(place, words)
            continue
        if not hasattr(package, "__path__"):
            yield Fault(place, "needs a package with the collections' names as folders")
            continue
        for path in package.__path__:
            yield from _in_subfolders(Path(path), package.__name__)


@lru_cache(maxsize=4)
def _points(_places: tuple[tuple[Path, int, int], ...]) -> tuple[metadata.EntryPoint, ...]:
    """The entry points, which take long to read, of the places that Python imports from."""
    return tuple(sorted(metadata.entry_points(group=GROUP)))


def _in_subfolders(folder: Path, package: str | None) -> Iterator[Shelf | Fault]:
    """The collections in a folder; a package of its own for each without one for all."""
    inside = sorted(p for p in folder.iterdir() if p.is_dir() and p.name[0] not in "._")
    if not inside:
        known = ", ".join(COLLECTIONS)
        words = f"no plug-ins here; needs a folder with the name of a collection: {known}"
        yield Fault(str(folder), words)
    for found in inside:
        if found.name not in COLLECTIONS:
            words = unknown_name("collection", found.name, COLLECTIONS)
            yield Fault(str(found), f"{words}; names of other folders begin with _")
            continue
        yield Shelf(found.name, found, f"{package}.{found.name}" if package else _package_of(found))


def _wrong_name(name: str, kind: str) -> str:
    if not name.isidentifier() or keyword.iskeyword(name):
        return f"'{name}' is not a name in Python: letters, digits and _ alone, no keyword"
    if hasattr(BaseModel, name) or name.startswith("model_"):
        return f"'{name}' is a name that pydantic, which reads scenarios, keeps for itself"
    if kind == "metrics" and name in OF_STUDIES:
        return f"every study has a column '{name}' of its own"
    return ""


def _message(error: BaseException) -> str:
    words = message_of(error)
    if isinstance(error, PydanticUserError):
        words = words.partition(". ")[0]  # what follows is about pydantic's settings
    return f"{type(error).__name__}: {words}"


class Catalog:
    """Everything that scenarios can name: shipped, from installed packages, and the user's own.

    Args:
        task_folders: folders with the user's own task files.
        plugin_folders: folders with the user's own plug-ins, in subfolders named as collections.

    Raises:
        CoopqpError: with a line for every file that is no plug-in, or takes a name that exists.
    """

    def __init__(
        self, task_folders: tuple[Path, ...] = (), plugin_folders: tuple[Path, ...] = ()
    ) -> None:
        self.folders = tuple(tuple(map(absolute, kind)) for kind in (task_folders, plugin_folders))
        self._collections: dict[str, dict[str, Entry]] = {kind: {} for kind in COLLECTIONS}
        faults, (tasks, plugins) = list[Fault](), self.folders
        shipped = Path(__file__).parents[1]
        shelves = chain(
            (Shelf(kind, shipped / kind, f"coopqp.{kind}") for kind in COLLECTIONS),
            installed(),
            *(_in_subfolders(folder, None) for folder in plugins),
            (Shelf("tasks", folder, _package_of(folder)) for folder in tasks),
        )
        for shelf in dict.fromkeys(shelves):
            if isinstance(shelf, Fault):
                faults.append(shelf)
            else:
                faults += self._add(shelf)
        if faults:
            raise CoopqpError("\n".join(str(fault) for fault in faults))
        known = self._collections.values()
        self._hash = hash(tuple(frozenset(entries.values()) for entries in known))

    def _add(self, shelf: Shelf) -> Iterator[Fault]:
        """Take in a shelf; what cannot be taken in comes back."""
        known = self._collections[shelf.kind]
        for found in shelf.entries():
            if isinstance(found, Fault):
                yield found
            elif found.name in known:
                word, taken = shelf.kind.removesuffix("s"), inspect.getfile(known[found.name].cls)
                words = f"a {word} '{found.name}' exists already, in {taken}; rename the file"
                yield Fault(inspect.getfile(found.cls), words)
            else:
                known[found.name] = found

    def __eq__(self, other: object) -> bool:
        """Catalogues that can name the same are equal, so that they share one form of a file."""
        return isinstance(other, Catalog) and self._collections == other._collections

    def __hash__(self) -> int:
        return self._hash

    def entries(self, kind: str) -> dict[str, Entry]:
        """The plug-ins of one collection by name."""
        return self._collections[kind]
