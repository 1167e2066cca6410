"""The pages of the reference: everything a scenario can name, from the classes themselves."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from pydantic.dataclasses import is_pydantic_dataclass

from coopqp.base.spec import field_docs
from coopqp.report.table import help_lines
from coopqp.scenario.catalog import COLLECTIONS, Catalog, Entry
from coopqp.scenario.form import file_model
from coopqp.scenario.loader import shipped
from coopqp.scenario.yaml import read_yaml
from coopqp.solver import Status
from coopqp.study.sweep import reader, space
from coopqp.study.sweep.reader import StudyFile
from coopqp_site.fields import SLOTS, common_keys, keys, own_keys, schema_of
from coopqp_site.writing import ROOT, plain, table


def pages() -> Iterator[tuple[str, str]]:
    """Name and text of each page of what can be written in files."""
    catalog = Catalog()
    for kind in COLLECTIONS:
        yield f"{kind}.md", collection(kind, catalog)
    yield "scenarios.md", scenarios(catalog)
    yield "scenario_keys.md", scenario_keys(catalog)
    yield "values.md", values(catalog)
    yield "study_keys.md", study_keys()
    yield "statuses.md", statuses()


def collection(kind: str, catalog: Catalog) -> str:
    """Every plug-in of a kind."""
    idea, word, used = COLLECTIONS[kind], kind.removesuffix("s"), _uses()
    text = f"# {kind.capitalize()}\n\n{plain(idea.__doc__)}\n"
    text += f"\nHow to write one of your own: [a {word}](../plugins/{word}.md).\n"
    if common := common_keys(idea):
        text += f"\nKeys of every {word}:\n\n{common}"
    entries = catalog.entries(kind)
    return text + "".join(_entry(entries[name], idea, used) for name in sorted(entries))


def _entry(entry: Entry, idea: type, used: Mapping[str, list[str]]) -> str:
    module = sys.modules[entry.cls.__module__]
    file = Path(inspect.getfile(entry.cls)).resolve().relative_to(ROOT).as_posix()
    text = f"\n## {entry.name}\n\n{plain(entry.cls.__doc__)}\n"
    if unit := getattr(entry.cls, "unit", ""):
        text += f"\nUnit: {unit}.\n"
    text += f"\n{own_keys(entry.cls, idea)}"
    about = f"\n{plain(module.__doc__)}\n" if module.__doc__ else ""
    text += f"{about}\nSource: [{file}](../../{file})."
    if scenarios := used.get(entry.name):
        links = ", ".join(f"[{name}](../../scenarios/{name}.yaml)" for name in scenarios)
        text += f" Used in: {links}."
    return text + "\n"


@cache
def _uses() -> dict[str, list[str]]:
    """Names of the shipped scenarios that write a name, by that name."""
    found: dict[str, list[str]] = {}
    for name, path in shipped().items():
        for word in dict.fromkeys(_words(read_yaml(path).data)):
            found.setdefault(word, []).append(name)
    return found


def _words(data: Any) -> Iterator[str]:
    """Every key and text in a file."""
    if isinstance(data, Mapping):
        yield from map(str, data)
        data = list(data.values())
    if isinstance(data, list):
        for value in data:
            yield from _words(value)
    elif isinstance(data, str):
        yield data


def scenarios(catalog: Catalog) -> str:
    """Every shipped scenario."""
    lines = help_lines("scenarios", catalog).items()
    rows = ((f"[{name}](../../scenarios/{name}.yaml)", text) for name, text in lines)
    return f"# Shipped scenarios\n\n{table(('name', 'what it shows'), rows)}"


def scenario_keys(catalog: Catalog) -> str:
    """The keys of a scenario file, and of a phase."""
    schema = file_model(catalog).model_json_schema()
    text = "# Keys of a scenario\n\n`coopqp schema` prints the same for editors.\n\n"
    return text + keys(schema) + "\n## Phase\n\n" + keys(schema["$defs"]["Phase"])


def values(catalog: Catalog) -> str:
    """What is a mapping of its own inside of scenarios, such as a profile."""
    known = dict(file_model(catalog).model_json_schema()["$defs"])
    for kind in COLLECTIONS:
        for entry in catalog.entries(kind).values():
            known |= schema_of(entry.cls).get("$defs", {})
    classes = {e.cls for kind in COLLECTIONS for e in catalog.entries(kind).values()}
    plugins = {name for cls in classes for name in (cls.__name__, _long(cls))}
    text = "# Values with keys of their own\n"
    done: set[str] = set()
    for name in sorted(known, key=lambda name: name.rpartition("__")[2]):
        title = name.rpartition("__")[2]
        if name in plugins or name in SLOTS or title in {"Phase", *done}:
            continue
        done.add(title)
        text += f"\n## {title}\n\n{plain(known[name].get('description'))}\n\n"
        text += keys(known[name], field_docs(_class_of(name)))
    return text


def _class_of(name: str) -> type:
    """The class that a schema calls so: by its own name, or by its module's and its own."""
    modules = (module for key, module in sys.modules.items() if key.startswith("coopqp."))
    classes = (value for module in modules for value in vars(module).values())
    return next(c for c in classes if is_pydantic_dataclass(c) and name in (c.__name__, _long(c)))


def _long(cls: type) -> str:
    """Name of a class in a schema where another has its short one."""
    return f"{cls.__module__}.{cls.__qualname__}".replace(".", "__")


def study_keys() -> str:
    """The keys of a study file."""
    text = "# Keys of a study\n\nSee [studies](../studies.md).\n\n"
    schema = StudyFile.model_json_schema()
    text += keys(schema)
    for part in ("Over", "Samples"):
        text += f"\n## {part}\n\n{keys(schema['$defs'][part])}"
    always = ", ".join(f"[`{name}`](metrics.md#{name})" for name in reader.ALWAYS)
    text += f"\nMeasured always: {always}.\n"
    return f"{text}\n## Under `vary` and `samples`\n\n{plain(space.__doc__)}\n"


def statuses() -> str:
    """What can become of a tick."""
    rows = (
        (f"`{s.name}`", s.value, "yes" if s.usable else "no", "yes" if s.relaxed else "no")
        for s in Status
    )
    head = ("status", "meaning", "usable", "relaxed")
    return f"# Statuses of a tick\n\n{plain(Status.__doc__)}\n\n{table(head, rows)}"
