"""Keys of a class in words, from the JSON Schema of the form that reads scenario files."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import TypeAdapter

from coopqp.base.spec import field_docs
from coopqp.scenario.catalog import COLLECTIONS
from coopqp_site.writing import table

HEAD = ("key", "takes", "default", "meaning")
#: Titles of slots for a plug-in, and the collections that they take it from.
SLOTS = {f"One{kind.removesuffix('s').capitalize()}": kind for kind in COLLECTIONS}
#: Where what is no value of a scenario's has its section.
PAGES = {"Phase": "scenario_keys.md", "Over": "study_keys.md", "Samples": "study_keys.md"}
#: Of whole collections, so that their classes need no section of their own.
BOUNDS = {"exclusiveMinimum": "above", "minimum": "at least", "maximum": "at most"}
PLAIN = {"number": "number", "integer": "whole number", "boolean": "true or false",
         "string": "text", "object": "mapping", "array": "list", "null": "nothing"}  # fmt: skip

Schema = Mapping[str, Any]


def schema_of(cls: type) -> Schema:
    """JSON Schema of a class that ``@spec`` made."""
    found: Schema = TypeAdapter(cls).json_schema()
    return found


def own_keys(cls: type, idea: type) -> str:
    """The keys that a plug-in has beyond those of every one of its kind."""
    schema = schema_of(cls)
    inherited = set(vars(idea).get("__pydantic_fields__", ())) - set(inspect.get_annotations(cls))
    own = {key: v for key, v in schema.get("properties", {}).items() if key not in inherited}
    return keys({**schema, "properties": own}, field_docs(cls))


def common_keys(idea: type) -> str:
    """The keys that every plug-in of a kind has."""
    fields = vars(idea).get("__pydantic_fields__", {})
    properties = {
        key: {**TypeAdapter(field.annotation).json_schema(), "default": field.get_default()}
        for key, field in fields.items()
    }
    rows = {}
    for key, shown in properties.items():
        bounds = {name: value for m in fields[key].metadata for name, value in _bound(m)}
        rows[key] = {**shown, **bounds}
    return keys({"properties": rows}, field_docs(idea))


def _bound(metadata: Any) -> Iterator[tuple[str, Any]]:
    names = {"gt": "exclusiveMinimum", "ge": "minimum", "le": "maximum"}
    for short, name in names.items():
        if hasattr(metadata, short):
            yield name, getattr(metadata, short)


def keys(schema: Schema, meanings: Mapping[str, str] | None = None) -> str:
    """A table of the keys of a mapping, those that are needed first.

    Args:
        schema: of the mapping.
        meanings: of keys whose schema says none.
    """
    meanings = meanings or {}
    known = schema.get("$defs", {})
    needed = set(schema.get("required", ()))
    properties = sorted(
        schema.get("properties", {}).items(), key=lambda item: item[0] not in needed
    )
    rows = table(
        HEAD,
        (
            (
                f"**`{key}`**" if key in needed else f"`{key}`",
                takes(value),
                "needed" if key in needed else _default(value, known),
                value.get("description") or meanings.get(key, ""),
            )
            for key, value in properties
        ),
    )
    return f"````{{container}} keys\n\n{rows}\n````\n" if rows else ""


def _default(schema: Schema, known: Mapping[str, Schema]) -> str:
    """The default; not each of its keys, where those have the same defaults where they are told."""
    value = schema.get("default")
    there = known.get(schema.get("$ref", "").rpartition("/")[2], {}).get("properties", {})
    same = there and all(there[k].get("default") == v for k, v in (value or {}).items())
    return "its own" if value and same else f"`{flow(value)}`"


def flow(value: Any) -> str:
    """A default as YAML has it."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{k}: {flow(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(flow, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    if value is None:
        return "none"
    return f"{value:g}" if isinstance(value, float) else str(value) or '""'


def takes(schema: Schema) -> str:
    """What a key takes, in words."""
    if "$ref" in schema:
        return _linked(schema["$ref"].rpartition("/")[2])
    if "anyOf" in schema:
        return _one_of(schema["anyOf"])
    if "const" in schema:
        return f"`{schema['const']}`"
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    kind = schema.get("type")
    if kind == "array":
        return _listed(schema)
    if kind == "object":
        return _mapped(schema)
    bounds = [f"{word} {schema[key]:g}" for key, word in BOUNDS.items() if key in schema]
    return " ".join([PLAIN.get(str(kind), "anything"), ", ".join(bounds)]).strip()


def _one_of(options: list[Schema]) -> str:
    slot = any(option.get("$ref", "").rpartition("/")[2] in SLOTS for option in options)
    kept = (o for o in options if o.get("type") != "null" and not (slot and "enum" in o))
    return " or ".join(dict.fromkeys(map(takes, kept)))


def _listed(schema: Schema) -> str:
    if "prefixItems" in schema:
        items = list(dict.fromkeys(map(takes, schema["prefixItems"])))
        count = len(schema["prefixItems"])
        many = items[0].replace("number", "numbers").replace("text", "texts")
        return f"{count} {many}" if len(items) == 1 else f"[{', '.join(items)}]"
    return f"list: {takes(schema['items'])}" if schema.get("items") else "list"


def _mapped(schema: Schema) -> str:
    if "signal" in schema.get("description", ""):
        return "[signal](signals.md)"
    inside = schema.get("additionalProperties")
    return f"mapping to {takes(inside)}" if isinstance(inside, Mapping) else "mapping"


def _linked(name: str) -> str:
    """A link to where a schema's definition is told of."""
    if name in SLOTS:
        return f"[{SLOTS[name].removesuffix('s')}]({SLOTS[name]}.md)"
    title = name.rpartition("__")[2]
    return f"[{title}]({PAGES.get(title, 'values.md')}#{title.lower()})"
