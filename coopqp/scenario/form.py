"""The form of a scenario file: which keys it has, made from the catalogue at run time.

Every plug-in slot is "one name with its fields": ``rigid``, or ``rigid: {}``, or
``point_on_plane: {normal: [0, 0, 1], ...}``. pydantic checks it and writes its JSON Schema.
"""

import functools
import json
import operator
import types
import typing
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    create_model,
)

from coopqp.base import wording
from coopqp.base.errors import CoopqpError, unknown_name
from coopqp.base.spec import field_docs, type_name
from coopqp.base.wording import Location, shown
from coopqp.grasp import Grasp
from coopqp.scenario.catalog import COLLECTIONS, Catalog
from coopqp.scenario.planned import PlanReference
from coopqp.scenario.scenario import NO_KEY, UNIONS, Key, Phase, Scenario
from coopqp.scenario.yaml import Wrong, YamlFile
from coopqp.signal import Signal
from coopqp.solvers import qpsolvers as qpsolvers_backends

STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
#: What a file says instead of joint values to have the start solved for.
SOLVE = "solve"
Joints = dict[str, float | list[float]]


def _start(value: Any) -> Any:
    if value == SOLVE:
        return {}
    if value is not None and not isinstance(value, dict):
        raise ValueError(f"needs joint values by arm or joint, or the word {SOLVE}")
    return value


def _spelt(kind: str, model: Any, names: Iterable[str], aliases: Iterable[str]) -> Any:
    """Reads any spelling of a plug-in slot as {name: fields}."""
    known, others = sorted(names), sorted(aliases)

    def read(value: Any) -> Any:
        given = {value: {}} if isinstance(value, str) else value
        if not isinstance(given, dict) or len(given) != 1:
            raise ValueError(f"needs one {kind} by name, such as '{known[0]}'")
        ((name, options),) = given.items()
        if name in others and not options:
            return {"qpsolvers": {"backend": name}}
        if name not in known:
            words = unknown_name(kind, str(name), [*known, *others])
            raise ValueError(f"{words}; those of your own need --plugins FOLDER")
        return {name: {} if options is None else options}

    return BeforeValidator(read, json_schema_input_type=Literal[(*known, *others)] | model)


class Slot(BaseModel):
    """Where a file has one plug-in; a field for each that it can be."""

    model_config = ConfigDict(**STRICT, json_schema_extra={"minProperties": 1, "maxProperties": 1})


@functools.lru_cache(maxsize=64)
def one_of(catalog: Catalog, kind: str) -> Any:
    """Type of a slot that takes one plug-in of a collection."""
    entries = catalog.entries(kind)
    word = kind.removesuffix("s")
    options: dict[str, Any] = {
        name: (entry.cls | None, Field(default=None, description=entry.help))
        for name, entry in entries.items()
    }
    model = create_model(f"One{word.capitalize()}", __base__=Slot, **options)
    aliases = set(qpsolvers_backends.installed()) - set(entries) if kind == "solvers" else ()
    return Annotated[model, _spelt(word, model, entries, aliases)]


def chosen(slot: BaseModel) -> tuple[str, Any]:
    """Name and instance of the plug-in in a slot."""
    ((name, instance),) = ((k, v) for k, v in slot if v is not None)
    return name, instance


@dataclass(kw_only=True)
class FileKeys:
    """The keys from which a file makes the fields of a scenario that have none of their own."""

    folder: str = ""
    """Where relative paths begin; the file's own folder if omitted."""
    grasp: Grasp | None = None
    """How every arm holds the object; rigid if omitted."""
    grasps: Mapping[str, Grasp] | None = None
    """How each arm holds it, by arm; instead of grasp."""
    start: Annotated[
        Joints | None,
        BeforeValidator(_start, json_schema_input_type=Literal["solve"] | Joints | None),
    ] = None
    """Joint values by arm (base first), joint or passive joint [rad, m]; or solve, to find them
    from object.pose and the grasps' object_in_hand."""
    reference: PlanReference | None = None
    """A plan that is followed before the tasks are, {plan: FILE} or {plan: true}."""
    start_near: Joints | None = None
    """Posture that a solved start is to be near, by arm or joint [rad, m]; far from all limits if
    omitted."""
    start_deg: Joints | None = None
    """The same with degrees for radians; joints that slide keep metres."""


@functools.lru_cache(maxsize=8)
def file_model(catalog: Catalog) -> type[BaseModel]:
    """The model of a scenario file; kept, because making it takes longer than reading a file."""
    needed: Any = {"anyOf": [{"required": list(WITHOUT_PHASES)}, {"required": ["phases"]}]}
    keys = {**dict(_keys(Scenario, catalog)), **dict(_keys(FileKeys, catalog))}
    config = ConfigDict(**STRICT, json_schema_extra=needed)
    return create_model("Scenario", __config__=config, **keys)


def _keys(cls: Any, catalog: Catalog) -> Iterator[tuple[str, Any]]:
    """Keys of a file, with the types and defaults that the fields of a class give them."""
    words = field_docs(cls)
    for found, hint, key in _fields(cls):
        default = found.default if found.default_factory is MISSING else found.default_factory()
        default = _named(default) if key.default is MISSING else key.default
        more = {} if default in (MISSING, ...) else {"default": default, "validate_default": True}
        about = Field(**more, description=" ".join(words.get(found.name, "").split()))
        yield key.name or found.name, (_type(key.form or hint, catalog), about)


@functools.cache
def _fields(cls: Any) -> list[tuple[Any, Any, Key]]:
    """The fields of a class for which a file has a key, with their types and how it says them."""
    hints = typing.get_type_hints(cls, include_extras=True)
    marks = {name: getattr(hint, "__metadata__", ()) for name, hint in hints.items()}
    keys = {name: next((x for x in marks[name] if isinstance(x, Key)), Key()) for name in hints}
    found = [(field, hints[field.name], keys[field.name]) for field in fields(cls)]
    return [one for one in found if one[2] is not NO_KEY]


def _named(default: Any) -> Any:
    if isinstance(default, tuple):
        return list(map(_named, default))
    return type_name(type(default)) if isinstance(default, tuple(COLLECTIONS.values())) else default


def _type(hint: Any, catalog: Catalog) -> Any:
    """What a file has where Python has a type: a slot for a plug-in, a list for a tuple."""
    for kind, idea in COLLECTIONS.items():
        if hint is idea:
            return one_of(catalog, kind)
    if hint is Phase:
        return create_model("Phase", __config__=STRICT, **dict(_keys(Phase, catalog)))
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        kept = [x for x in parts[1:] if not isinstance(x, Key)]
        return functools.reduce(lambda one, x: Annotated[one, x], kept, _type(parts[0], catalog))
    if origin in UNIONS:
        return functools.reduce(operator.or_, (_type(part, catalog) for part in parts))
    if origin in (tuple, list, Sequence):
        return types.GenericAlias(list, (_type(parts[0], catalog),))
    if origin is Mapping:
        return types.GenericAlias(dict, (str, _type(parts[1], catalog)))
    return hint


#: Settings of the loop for robots that people look for in a file.
OF_LOOP = {"reactions": "is an argument of OnlineLoop; a scenario has none"}
#: Keys that each phase has for itself, where there are phases.
WITHOUT_PHASES = ("tasks", "duration")


def _phases_or_not(data: Mapping[str, Any]) -> Iterator[Wrong]:
    if "phases" not in data:
        missing = [key for key in WITHOUT_PHASES if key not in data]
        yield from (Wrong([], f"needs the key '{key}'") for key in missing)
    elif not data["phases"]:
        yield Wrong(["phases"], "needs at least one phase")
    else:
        words = "belongs into each phase, where there are phases; move it there"
        yield from (Wrong([key], words) for key in WITHOUT_PHASES if key in data)


def check(file: YamlFile, catalog: Catalog) -> BaseModel:
    """Check a file against the form that a catalogue gives it."""
    model = file_model(catalog)

    def inner(kind: str, value: Any) -> Any:
        """A plug-in inside another, such as one of several robots."""
        adapter = TypeAdapter[Any](one_of(catalog, kind))
        read = adapter.validate_json(json.dumps(value), context=context)
        for place, words in _mistaken(value, read):
            raise ValueError(f"{wording.dotted(place)}: {words}")
        return chosen(read)[1]

    def read_signal(value: dict[str, Any], needed: bool) -> Signal | None:
        named = len(value) == 1 and set(value) <= set(catalog.entries("signals"))
        return inner("signals", value) if needed or named else None

    robot = functools.partial(inner, "robots")
    context = {"folder": file.folder, "robot": robot, "signal": read_signal}
    found = list(_phases_or_not(file.data))
    try:
        read = model.model_validate_json(json.dumps(file.data), context=context)
    except ValidationError as error:
        slots = {idea: one_of(catalog, kind) for kind, idea in COLLECTIONS.items()}
        wrong = wording.faults(error, file.data, model, slots)
        found += [Wrong(place, OF_LOOP.get(wording.dotted(place), words)) for place, words in wrong]
    except (CoopqpError, KeyboardInterrupt):
        raise
    except BaseException as error:  # noqa: BLE001 - from the __post_init__ of a plug-in
        found.append(Wrong([], wording.raised(error)))
    else:
        found += [Wrong(*wrong) for wrong in _mistaken(file.data, read)]
    if found:
        raise file.refused(found)
    return read


def _mistaken(given: Any, read: Any) -> Iterator[tuple[Location, str]]:
    """Values that were made numbers or truths and are none, with what is wrong.

    Inside a slot pydantic reads values of Python, either strictly, when no list is a tuple, or so
    that true is 1.0. Slots are therefore not read strictly, and what came of them is checked.
    """
    if isinstance(given, dict):
        for key, value in given.items():
            inside = read.get(key) if isinstance(read, dict) else getattr(read, key, None)
            yield from (((key, *place), words) for place, words in _mistaken(value, inside))
    elif isinstance(given, list):
        if isinstance(read, list | tuple) and len(read) == len(given):
            for i, (value, inside) in enumerate(zip(given, read, strict=True)):
                yield from (((i, *place), words) for place, words in _mistaken(value, inside))
    elif type(read) in (int, float) and isinstance(given, bool | str):
        yield (), f"found {shown(given)}; needs a number"
    elif type(read) is bool and not isinstance(given, bool):
        yield (), f"found {shown(given)}; needs true or false"


def given(read: BaseModel) -> dict[str, Any]:
    """What a file says by key, or its form for it: plug-ins themselves, in tuples and dicts."""
    found = {key: value for key, value in read if value is not None}
    return {
        key: tuple(map(_plain, value)) if isinstance(value, list) else _plain(value)
        for key, value in found.items()
    }


def fields_of(keys: Mapping[str, Any]) -> dict[str, Any]:
    """What of a file are fields of a scenario, by field."""
    names = {found.name: key.name or found.name for found, _, key in _fields(Scenario)}
    return {field: keys[name] for field, name in names.items() if name in keys}


def _plain(value: Any) -> Any:
    """A plug-in for its slot, a phase for its form; other values as they are."""
    if isinstance(value, dict):
        return {key: _plain(inside) for key, inside in value.items()}
    if isinstance(value, Slot):
        return chosen(value)[1]
    return Phase(**given(value)) if isinstance(value, BaseModel) else value
