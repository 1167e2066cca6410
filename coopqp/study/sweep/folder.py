"""The folder of a study: whether it is the study's own, and the study from the folder alone.

What makes two folders the same study is a hash of each part that results follow from.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from shlex import quote
from typing import Any

import coopqp
from coopqp.base.errors import CoopqpError, ScenarioError
from coopqp.base.reading import absolute
from coopqp.base.wording import dotted
from coopqp.scenario.catalog import COLLECTIONS, Catalog
from coopqp.scenario.yaml import FILE_KEYS, as_yaml, has_files, parsed
from coopqp.study.sweep.journal import PATTERN, head_of, journals
from coopqp.study.sweep.reader import study_text
from coopqp.study.sweep.results import NAME
from coopqp.study.sweep.study import CONTROLLERS, Study

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
    data, folder = study.scenario.data, study.scenario.folder
    named = {absolute(folder / name) for name in _files([data, study.file.data])}
    return {
        "study": _hash(json.dumps(study.file.data, sort_keys=True)),
        "scenario": _hash(study.scenario.path.stem, json.dumps(data, sort_keys=True)),
        "files": _hash(*_of_files(named)),
        "plugins": plugins_hash(study),
        "points": study.points.digest,
        "version": f"{coopqp.__version__} ({_code()})",
    }


def plugins_hash(study: Study) -> str:
    """Of the plug-ins that are not shipped, and of files beside them."""
    classes = [e.cls for kind in COLLECTIONS for e in study.catalog.entries(kind).values()]
    own = (cls for cls in classes if not cls.__module__.startswith(SHIPPED))
    folders = {absolute(Path(inspect.getfile(cls))).parent for cls in own}
    return _hash(*_of_files(file for folder in folders for file in folder.glob("*.py")))


def _hash(*texts: str) -> str:
    found = sha256()
    for text in texts:
        found.update(text.encode())
        found.update(b"\0")
    return found.hexdigest()[:16]


@cache
def _code() -> str:
    """A hash of coopqp's own files, so that two versions in development are two."""
    return _hash(*_of_files(Path(coopqp.__file__).parent.rglob("*.py")))


def _of_files(paths: Iterable[Path]) -> Iterator[str]:
    for path in sorted(paths):
        try:
            yield f"{path.name} {sha256(path.read_bytes()).hexdigest()}"
        except OSError:
            yield f"{path.name} -"


def _files(value: Any) -> Iterator[str]:
    """What of a scenario or a study names a file, such as its robot's."""
    if isinstance(value, dict):
        yield from (x for key, x in value.items() if key in FILE_KEYS and isinstance(x, str))
        value = list(value.values())
    for inside in value if isinstance(value, list) else ():
        yield from _files(inside)


#: Files that only a comparison's folder has.
COMPARISONS = ("metrics.json", "trace.csv")
MOST_KEYS = 4  # that are named
AWAY = "give another --out, or move the folder away"


def head_for(study: Study) -> dict[str, Any]:
    """What a journal says of its study."""
    return {
        "name": study.name,
        "identity": identity(study),
        "study": [str(study.file.path), study.file.text],
        "scenario": list(map(str, study.scenario_text)),
        "folders": [[str(one) for one in kind] for kind in study.catalog.folders],
    }


def check_folder(folder: Path, own: dict[str, Any]) -> None:
    """Refuse what is not the folder of the study with this head.

    Raises:
        CoopqpError: it is a file, or holds a comparison, results without their journal, or another
            study, saying what differs.
    """
    if folder.exists() and not folder.is_dir():
        raise CoopqpError(f"'{folder}' is not a folder")
    found = journals(folder)
    for name in COMPARISONS if not found else ():
        if (folder / name).exists():
            raise CoopqpError(f"'{folder}' holds a comparison ({name}); {AWAY}")
    if not found and (folder / NAME).exists():
        torn = any(folder.glob(PATTERN))
        why = "the head of its journal is damaged" if torn else "its journal is not there"
        raise CoopqpError(f"'{folder}' has {NAME}, but {why}; {AWAY}")
    for path in found:
        head = head_of(path) or {}
        if different := list(_different(head, own)):
            words = f"'{folder}' belongs to another study ('{head.get('name')}'), or an older one"
            raise CoopqpError(
                f"{words}: {', '.join(different)} differ{'' if len(different) > 1 else 's'}; {AWAY}"
            )


def _different(head: dict[str, Any], own: dict[str, Any]) -> Iterator[str]:
    """What is not the same, with its keys; the points follow from the study."""
    one, other = head["identity"], own["identity"]
    parts = [part for part in PARTS if one.get(part) != other.get(part)]
    for part in parts:
        if part == "points" and "study" in parts:
            continue
        keys: list[str] = []
        if part in ("study", "scenario"):
            before, now = (parsed(Path(x[part][0]), x[part][1]).data for x in (head, own))
            keys = list(_keys(before, now))
        more = f" and {len(keys) - MOST_KEYS} more" if len(keys) > MOST_KEYS else ""
        told = f" ({', '.join(keys[:MOST_KEYS])}{more})" if keys else ""
        yield f"{PARTS[part]}{told}"


def _keys(one: Any, other: Any, place: tuple[str | int, ...] = ()) -> Iterator[str]:
    """Places at which two files say something else."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in {**one, **other}:
            yield from _keys(one.get(key), other.get(key), (*place, key))
    elif one != other:
        yield dotted(place)


def kept_study(folder: Path, catalog: Catalog | None = None) -> Study:
    """The study whose results a folder holds.

    No plug-ins are looked for where it was run: who opens a folder runs none of its code. Who runs
    it gives a catalogue of what its scenario can name; shipped and installed plug-ins when omitted.

    Raises:
        CoopqpError: it holds none; its points cannot be drawn again.
    """
    head = _head(folder)
    path, text = head["scenario"]
    own, words = head["study"]
    study = study_text(Path(own), words, (Path(path), text), catalog or Catalog())
    if head["identity"]["points"] != study.points.digest:
        words = "other points are drawn here than where it was run, by another scipy or numpy"
        raise CoopqpError(f"'{folder}': {words}; use that one's")
    return study


def check_plugins(folder: Path, study: Study) -> list[str]:
    """Refuse to run a row without the plug-ins that the study was run with.

    Raises:
        CoopqpError: it was run with plug-ins of the user's own, and none are given.
    """
    head = _head(folder)
    named = [
        f"{option} {quote(path)}"
        for option, paths in zip(("--tasks", "--plugins"), head["folders"], strict=True)
        for path in paths
    ]
    if named and not any(study.catalog.folders):
        words = "was run with plug-ins, and opening a folder never runs code by itself"
        raise CoopqpError(f"'{folder}' {words}; if you trust them, add {' '.join(named)}")
    if head["identity"]["plugins"] != plugins_hash(study):
        return ["the plug-ins are not those that the study was run with"]
    return []


def _head(folder: Path) -> dict[str, Any]:
    if folder.is_file():
        raise CoopqpError(f"'{folder}' is a file; --table and --show need the folder of a study")
    if not folder.is_dir():
        raise CoopqpError(f"'{folder}' is neither a study file nor the folder of a study")
    found = journals(folder)
    if not found:
        words = "holds no study: needs a journal, as 'coopqp sweep' writes it"
        raise CoopqpError(f"'{folder}' {words}")
    return head_of(found[0]) or {}


def scenario_of_row(study: Study, row: int) -> tuple[str, str]:
    """A scenario file for one row, and the name of its controller.

    Raises:
        CoopqpError: there is no such row.
    """
    if not 0 <= row < study.rows:
        raise CoopqpError(f"--show: found {row}; the study has rows 0 to {study.rows - 1}")
    number, k = divmod(row, len(study.controllers))
    variant = study.variant(number)
    data: dict[str, Any] = study.changed(variant)
    controllers = data.get(CONTROLLERS)
    if controllers:
        data = {**data, CONTROLLERS: [controllers[k]]}
    if has_files(data):
        data = {**data, "folder": str(absolute(study.scenario.changed(data).folder))}
    columns = zip(study.columns, study.parts(variant), strict=True)
    values = ", ".join(f"{name} {value}" for name, value in columns)
    head = f"# Row {row} of the study {study.name}, variant {number}: {values}\n"
    return head + _yaml(study, data), study.controllers[k]


def _yaml(study: Study, data: dict[str, Any]) -> str:
    """As YAML for people; as JSON where that would not be read back as it was."""
    text = as_yaml(data)
    with suppress(ScenarioError):
        if parsed(study.scenario.path, text).data == data:
            return text
    return study.scenario.changed(data).text
