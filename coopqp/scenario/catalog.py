"""From a name to its class: what can be written in a scenario, and where it comes from.

Nothing is registered: a file is found because it is there, in coopqp, in an installed package
(:mod:`coopqp.scenario.plugin_files`) or in a folder of the user's.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from functools import cached_property
from itertools import chain
from pathlib import Path

from coopqp.errors import CoopqpError, Fault
from coopqp.reading import absolute
from coopqp.scenario.plugin import COLLECTIONS, Entry
from coopqp.scenario.plugin_files import Shelf, in_folder, installed, of_tasks, shipped


class Catalog:
    """Everything that scenarios can name: shipped, from installed packages, and the user's own.

    Args:
        task_folders: folders with the user's own task files.
        plugin_folders: folders with the user's own plug-ins, in subfolders named as collections.

    Attributes:
        folders: both, from the root on, so that another process can make the same catalogue.

    Raises:
        CoopqpError: with a line for every file that is no plug-in, or takes a name that exists.
    """

    def __init__(
        self, task_folders: tuple[Path, ...] = (), plugin_folders: tuple[Path, ...] = ()
    ) -> None:
        self.folders = tuple(tuple(map(absolute, kind)) for kind in (task_folders, plugin_folders))
        self._collections: dict[str, dict[str, Entry]] = {kind: {} for kind in COLLECTIONS}
        faults: list[Fault] = []
        for shelf in dict.fromkeys(_shelves(task_folders, plugin_folders)):
            if isinstance(shelf, Fault):
                faults.append(shelf)
            else:
                faults += self._add(shelf)
        if faults:
            raise CoopqpError("\n".join(str(fault) for fault in faults))

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

    @cached_property
    def _hash(self) -> int:
        return hash(tuple(frozenset(known.values()) for known in self._collections.values()))

    def entries(self, kind: str) -> dict[str, Entry]:
        """The plug-ins of one collection by name."""
        return self._collections[kind]


def _shelves(
    task_folders: tuple[Path, ...], plugin_folders: tuple[Path, ...]
) -> Iterator[Shelf | Fault]:
    return chain(
        shipped(), installed(), *map(in_folder, plugin_folders), map(of_tasks, task_folders)
    )
