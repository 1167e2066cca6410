"""What makes two folders the same study: a hash of each part that results follow from."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import coopqp
from coopqp.reading import absolute
from coopqp.scenario.loader import FILE_KEYS
from coopqp.scenario.plugin import COLLECTIONS
from coopqp.study.sweep.study import Study

#: Modules of shipped plug-ins; their files count as the version.
SHIPPED = tuple(f"coopqp.{kind}." for kind in COLLECTIONS)
#: What each part is called where it differs.
PARTS = {
    "study": "the study file",
    "scenario": "the scenario",
    "files": "a file that the scenario names",
    "plugins": "the plug-ins",
    "points": "the points drawn, by another version of scipy or numpy",
    "version": "coopqp itself",
}


def identity(study: Study) -> dict[str, str]:
    """A hash of each part, by name."""
    return {
        "study": _hash(json.dumps(study.file.data, sort_keys=True)),
        "scenario": _hash(
            study.scenario.path.stem, json.dumps(study.scenario.data, sort_keys=True)
        ),
        "files": _hash(*_of_files(sorted(set(_named(study)), key=str))),
        "plugins": plugins_hash(study),
        "points": study.points.digest,
        "version": f"{coopqp.__version__} ({_code()})",
    }


def plugins_hash(study: Study) -> str:
    """Of the plug-ins that are not shipped."""
    return _hash(*_of_files(sorted(_plugins(study))))


def differences(one: dict[str, str], other: dict[str, str]) -> list[str]:
    """Names of the parts that are not the same."""
    return [part for part in PARTS if one.get(part) != other.get(part)]


def _hash(*texts: str) -> str:
    found = sha256()
    for text in texts:
        found.update(text.encode())
        found.update(b"\0")
    return found.hexdigest()[:16]


@cache
def _code() -> str:
    """A hash of coopqp's own files, so that two versions in development are two."""
    root = Path(coopqp.__file__).parent
    return _hash(*_of_files(sorted(root.rglob("*.py"))))


def _of_files(paths: list[Path]) -> Iterator[str]:
    for path in paths:
        try:
            yield f"{path.name} {sha256(path.read_bytes()).hexdigest()}"
        except OSError:
            yield f"{path.name} -"


def _named(study: Study) -> Iterator[Path]:
    """Files that the scenario names, such as its robot's."""
    own = study.scenario.data.get("folder")
    folder = (
        study.scenario.path.parent / own if isinstance(own, str) else study.scenario.path.parent
    )
    waiting: list[Any] = [study.scenario.data, study.file.data]
    while waiting:
        found = waiting.pop()
        if isinstance(found, dict):
            named = (value for key, value in found.items() if key in FILE_KEYS)
            yield from (absolute(folder / value) for value in named if isinstance(value, str))
            waiting += found.values()
        elif isinstance(found, list):
            waiting += found


def _plugins(study: Study) -> set[Path]:
    """The files of plug-ins that are not shipped, and those beside them."""
    classes = [e.cls for kind in COLLECTIONS for e in study.catalog.entries(kind).values()]
    own = (cls for cls in classes if not cls.__module__.startswith(SHIPPED))
    files = (absolute(Path(inspect.getfile(cls))) for cls in own)
    return {beside for file in files for beside in file.parent.glob("*.py")}
