"""The form of a scenario file: which keys it has, made from the catalogue at run time.

Every plug-in slot is "one name with its fields": ``rigid``, or ``rigid: {}``, or
``point_on_plane: {normal: [0, 0, 1], ...}``. pydantic checks it and writes its JSON Schema.
"""

from __future__ import annotations

import functools
import json
import types
import typing
from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    create_model,
)

from coopqp import wording
from coopqp.checked import NonNegative, Positive
from coopqp.controller import OnInfeasible
from coopqp.disturbance import Disturbance
from coopqp.errors import CoopqpError, Fault, ScenarioError, unknown_name
from coopqp.held_object import HeldObject
from coopqp.input import InputSettings
from coopqp.robot import Robot
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.literal import mistaken
from coopqp.scenario.yaml import YamlFile
from coopqp.signal import Signal
from coopqp.solver import Budget
from coopqp.solvers import qpsolvers as qpsolvers_backends

STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


#: What a file says instead of joint values to have the start solved for.
SOLVE = "solve"


class _Start:
    """Lets the start be the word solve, also in the JSON Schema."""

    @staticmethod
    def read(value: Any) -> Any:
        """Joint values; none yet where they shall be solved for."""
        if value == SOLVE:
            return {}
        if value is not None and not isinstance(value, dict):
            raise ValueError(f"needs joint values by arm or joint, or the word {SOLVE}")
        return value

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Any:
        return {"anyOf": [{"const": SOLVE}, handler(core)]}


class _Spelling:
    """Reads the spellings of a plug-in slot and shows them in the JSON Schema."""

    def __init__(self, kind: str, names: Iterable[str], aliases: Iterable[str] = ()) -> None:
        self.kind, self.names, self.aliases = kind, sorted(names), sorted(aliases)

    def read(self, value: Any) -> Any:
        """Any spelling as {name: fields}."""
        given = {value: {}} if isinstance(value, str) else value
        if not isinstance(given, dict) or len(given) != 1:
            raise ValueError(f"needs one {self.kind} by name, such as '{self.names[0]}'")
        ((name, options),) = given.items()
        if name in self.aliases and not options:
            return {"qpsolvers": {"backend": name}}
        if name not in self.names:
            words = unknown_name(self.kind, str(name), [*self.names, *self.aliases])
            raise ValueError(f"{words}; those of your own need --plugins FOLDER")
        return {name: {} if options is None else options}

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Any:
        """A bare name, or one name with its fields."""
        return {"anyOf": [{"enum": [*self.names, *self.aliases]}, handler(core)]}


def one_of(catalog: Catalog, kind: str) -> Any:
    """Type of a slot that takes one plug-in of a collection."""
    entries = catalog.entries(kind)
    word = kind.removesuffix("s")
    options: dict[str, Any] = {
        name: (entry.cls | None, Field(default=None, description=entry.help))
        for name, entry in entries.items()
    }
    extra: Any = {"minProperties": 1, "maxProperties": 1}
    model = create_model(
        f"One{word.capitalize()}",
        __config__=ConfigDict(**STRICT, json_schema_extra=extra),
        **options,
    )
    aliases = set(qpsolvers_backends.installed()) - set(entries) if kind == "solvers" else ()
    spelling = _Spelling(word, entries, aliases)
    return Annotated[model, BeforeValidator(spelling.read), spelling]


def _list_of(catalog: Catalog, kind: str) -> Any:
    return types.GenericAlias(list, (one_of(catalog, kind),))


def chosen(slot: BaseModel) -> tuple[str, Any]:
    """Name and instance of the plug-in in a slot."""
    ((name, instance),) = ((k, v) for k, v in slot if v is not None)
    return name, instance


@functools.lru_cache(maxsize=8)
def file_model(catalog: Catalog) -> type[BaseModel]:
    """The model of a scenario file; kept, because pydantic takes longer over it than over a file.

    Args:
        catalog: what the file can name; equal ones share a model.
    """
    keys: dict[str, Any] = {
        "description": (str, Field(default="", description="One sentence for the report.")),
        "folder": (
            str,
            Field(
                default="",
                description="Where relative paths begin; the file's own folder if omitted.",
            ),
        ),
        "robot": (one_of(catalog, "robots"), Field(description="Which robot.")),
        "grasp": (
            one_of(catalog, "grasps") | None,
            Field(default=None, description="How every arm holds the object; rigid if omitted."),
        ),
        "grasps": (
            types.GenericAlias(dict, (str, one_of(catalog, "grasps"))) | None,
            Field(default=None, description="How each arm holds it, by arm; instead of grasp."),
        ),
        "grasp_of": (
            types.GenericAlias(dict, (str, one_of(catalog, "grasps"))),
            Field(default={}, description="Grasp of controllers that hold it otherwise, by name."),
        ),
        "object": (HeldObject, Field(default=HeldObject(), description="What is held.")),
        "weights": (
            dict[str, NonNegative] | None,
            Field(
                default=None,
                description="Weight of each arm in the object's pose, sum 1; the same if omitted.",
            ),
        ),
        "start": (
            Annotated[
                dict[str, float | list[float]] | None, BeforeValidator(_Start.read), _Start()
            ],
            Field(
                default=None,
                description="Joint values by arm (base first), joint or passive joint [rad, m]; "
                "or solve, to find them from object.pose and the grasps' object_in_hand.",
            ),
        ),
        "start_near": (
            dict[str, float | list[float]] | None,
            Field(
                default=None,
                description="Posture that a solved start is to be near, by arm or joint [rad, m]; "
                "far from all limits if omitted.",
            ),
        ),
        "start_deg": (
            dict[str, float | list[float]] | None,
            Field(
                default=None,
                description="The same with degrees for radians; joints that slide keep metres.",
            ),
        ),
        "tasks": (
            Annotated[_list_of(catalog, "tasks"), Field(min_length=1)] | None,
            Field(default=None, description="What the object shall do."),
        ),
        "phases": (
            Annotated[types.GenericAlias(list, (_phase(catalog),)), Field(min_length=1)] | None,
            Field(
                default=None,
                description="One after the other, instead of tasks and duration, when arms let go "
                "of the object or take hold of it.",
            ),
        ),
        "secondary": (
            _list_of(catalog, "tasks"),
            Field(default=[], description="Objectives for what the tasks leave free."),
        ),
        "limits": (
            _list_of(catalog, "limits"),
            Field(
                default=[{"joint_position": {}}, {"joint_velocity": {}}],
                validate_default=True,
                description="Hard bounds; joint position and velocity if omitted.",
            ),
        ),
        "controllers": (
            Annotated[_list_of(catalog, "controllers"), Field(min_length=1)],
            Field(
                default=["qp", "pseudoinverse", "pseudoinverse_null_space"],
                validate_default=True,
                description="What is compared.",
            ),
        ),
        "plant": (
            one_of(catalog, "plants"),
            Field(default="kinematic", validate_default=True, description="What is controlled."),
        ),
        "inputs": (
            dict[str, InputSettings],
            Field(
                default={},
                description="Values that arrive from outside while it runs, by name; tasks follow "
                "them by input: NAME.",
            ),
        ),
        "disturbance": (
            Disturbance,
            Field(default=Disturbance(), description="What the controllers are not told."),
        ),
        "solver": (
            one_of(catalog, "solvers"),
            Field(default="daqp", validate_default=True, description="For the QP controllers."),
        ),
        "budget": (Budget, Field(default=Budget(), description="What a solution may be off by.")),
        "dt": (Positive, Field(default=0.01, description="Control period [s].")),
        "duration": (
            Positive | None,
            Field(default=None, description="Length of the run [s]."),
        ),
        "kappa": (
            NonNegative | None,
            Field(
                default=None,
                description="Drift gain in J_c v = -kappa e [1/s]; at most 1/dt, which it is if "
                "omitted; 0 is the paper's law.",
            ),
        ),
        "on_infeasible": (
            OnInfeasible,
            Field(default="scale", description="scale, hold or stop when not all can hold."),
        ),
        "start_outside": (
            bool,
            Field(default=False, description="Whether joints may start outside their limits."),
        ),
        "seed": (
            Annotated[int, Field(ge=0)],
            Field(default=0, description="Of everything random."),
        ),
    }  # fmt: skip
    needed: Any = {"anyOf": [{"required": list(WITHOUT_PHASES)}, {"required": ["phases"]}]}
    config = ConfigDict(**STRICT, json_schema_extra=needed)
    return create_model("Scenario", __config__=config, **keys)


def _phase(catalog: Catalog) -> type[BaseModel]:
    """Form of a phase."""
    keys: dict[str, Any] = {
        "name": (Annotated[str, Field(min_length=1)], Field(description="Yours.")),
        "duration": (Positive, Field(description="Length [s]; time begins anew in each phase.")),
        "released": (
            list[str],
            Field(default=[], description="Arms that do not hold the object; all others do."),
        ),
        "tasks": (
            Annotated[_list_of(catalog, "tasks"), Field(min_length=1)],
            Field(description="What shall happen."),
        ),
    }
    return create_model("Phase", __config__=STRICT, **keys)


#: Keys that each phase has for itself, where there are phases.
WITHOUT_PHASES = ("tasks", "duration")


def _phases_or_not(file: YamlFile) -> list[Fault]:
    """What is missing or too much, with phases or without."""
    if "phases" in file.data and not file.data["phases"]:
        return [Fault(file.place(["phases"]), "needs at least one phase")]
    if "phases" not in file.data:
        missing = [key for key in WITHOUT_PHASES if key not in file.data]
        return [Fault(file.place([]), f"needs the key '{key}'") for key in missing]
    return [
        Fault(file.place([key]), "belongs into each phase, where there are phases; move it there")
        for key in WITHOUT_PHASES
        if key in file.data
    ]


def check(file: YamlFile, catalog: Catalog) -> BaseModel:
    """Check a file against the form that a catalogue gives it.

    Raises:
        ScenarioError: with every fault and its line.
    """
    model = file_model(catalog)
    robot, signal_slot = _adapters(catalog)

    def read_robot(value: Any) -> Any:
        """A robot inside a robot, such as one of several."""
        return _inner(robot, value, context)

    own = file.data.get("folder")
    folder = file.path.parent / own if isinstance(own, str) else file.path.parent

    def read_signal(value: dict[str, Any], needed: bool) -> Signal | None:
        """A signal where a task may have one."""
        if not needed and not (len(value) == 1 and set(value) <= set(catalog.entries("signals"))):
            return None
        signal: Signal = _inner(signal_slot, value, context)
        return signal

    context = {"folder": folder, "robot": read_robot, "signal": read_signal}
    faults = _phases_or_not(file)
    try:
        read = model.model_validate_json(json.dumps(file.data), context=context)
    except ValidationError as error:
        found = wording.faults(
            error,
            file.data,
            model,
            {Robot: _slot(model, "robot"), Signal: one_of(catalog, "signals")},
        )
        faults += [Fault(file.place(location), message) for location, message in found]
    except (CoopqpError, KeyboardInterrupt):
        raise
    except BaseException as error:  # from the __post_init__ of a plug-in
        raise ScenarioError([*faults, Fault(file.place([]), wording.raised(error))]) from error
    else:
        faults += [Fault(file.place(place), words) for place, words in mistaken(file.data, read)]
    if faults:
        raise ScenarioError(faults)
    return read


def _inner(slot: TypeAdapter[Any], value: Any, context: dict[str, Any]) -> Any:
    """The plug-in in a slot inside another plug-in."""
    read = slot.validate_json(json.dumps(value), context=context)
    for place, words in mistaken(value, read):
        raise ValueError(f"{wording.dotted(place)}: {words}")
    return chosen(read)[1]


@functools.lru_cache(maxsize=8)
def _adapters(catalog: Catalog) -> tuple[TypeAdapter[Any], TypeAdapter[Any]]:
    """Of a robot and of a signal; kept as the model is."""
    return TypeAdapter(_slot(file_model(catalog), "robot")), TypeAdapter(one_of(catalog, "signals"))


def _slot(model: type[BaseModel], key: str) -> Any:
    """Type of a key of the file."""
    return typing.get_type_hints(model, include_extras=True)[key]
