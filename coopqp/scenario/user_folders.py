"""Folders anywhere as packages: the modules in them can be imported, relatively too, and pickled.

A folder's package is named after its whole path, so that two folders never share a name and a
process that has never heard of the folder, such as a worker, finds its modules by name alone.
"""

import os
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

#: Makes this module the parent of the folders' packages.
__path__: list[str] = []


def package_of(folder: Path) -> str:
    """Name under which a resolved folder can be imported."""
    return f"{__name__}.at_{os.fsencode(folder).hex()}"


class _Finder(MetaPathFinder):
    """Turns names that :func:`package_of` made into packages."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        parent, _, name = fullname.rpartition(".")
        if parent != __name__ or not name.startswith("at_"):
            return None
        spec = ModuleSpec(fullname, None, is_package=True)
        spec.submodule_search_locations = [os.fsdecode(bytes.fromhex(name[3:]))]
        return spec


sys.meta_path.append(_Finder())
