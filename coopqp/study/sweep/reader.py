"""From a study file to a study, or to all that is wrong with it, before anything runs.

The form of the file is the model ``StudyFile``, which gives its JSON Schema too.
"""

import copy
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from coopqp.base import wording
from coopqp.base.errors import CoopqpError, Fault, InvalidValueError, ScenarioError, unknown_name
from coopqp.base.reading import absolute
from coopqp.base.spec import taken_names
from coopqp.base.wording import dotted
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.checks import refuse
from coopqp.scenario.form import STRICT, check, file_model
from coopqp.scenario.loader import find
from coopqp.scenario.yaml import MisplacedError, Wrong, YamlFile, parsed, read_yaml
from coopqp.study.sweep import space
from coopqp.study.sweep.space import GRID, MAX_POINTS, SAMPLES, Points, Variation, needs
from coopqp.study.sweep.study import CONTROLLERS, SEED, Study, Varied, located, put

NAMED = "needs the path of a scenario, or the name of a shipped one"
EMPTY = "is empty; needs a path of the scenario: what to vary it over"


def _variation(value: Any) -> Any:
    if not isinstance(value, dict) or len(value) != 1:
        given = f"found {len(value)} keys" if isinstance(value, dict) else "found no mapping"
        raise ValueError(
            f"{given}; needs exactly one of {', '.join(space.KINDS)}, such as range: [0, 1]"
        )
    (kind,) = value
    if kind not in space.KINDS:
        raise ValueError(unknown_name("variation", kind, space.KINDS))
    return value


def _samples(value: Any) -> Any:
    """One way to sample with its count, and a seed."""
    if not isinstance(value, str | dict):
        raise ValueError("needs a way to sample, such as sobol: 1024, or grid")
    named = value if isinstance(value, dict) else {value: None}
    chosen = [key for key in named if key != SEED]
    for key in chosen:
        if key not in SAMPLES:
            raise ValueError(unknown_name("way to sample", key, SAMPLES))
    if len(chosen) != 1:
        ways = ", ".join((GRID, *(way for way in SAMPLES if way != GRID)))
        raise ValueError(f"found {len(chosen)}; needs exactly one of {ways}, such as sobol: 1024")
    return named


def _metric(name: str, info: pydantic.ValidationInfo) -> str:
    known = (info.context or {}).get("metrics")
    if known is not None and name not in known:
        raise ValueError(unknown_name("metric", name, known))
    return name


_MANY = f"needs a whole number of 1 to {MAX_POINTS:,}"
_COUNTS = needs(lambda x: type(x) is int and 1 <= x <= MAX_POINTS, _MANY)
Count = Annotated[int, Field(ge=1, le=MAX_POINTS), _COUNTS]


def _one_of(name: str, about: str, max_keys: int, fields: dict[str, Any]) -> Any:
    """A model with at least one of its fields and at most so many."""
    counts = ConfigDict(**STRICT, json_schema_extra={"minProperties": 1, "maxProperties": max_keys})
    return pydantic.create_model(name, __config__=counts, __doc__=about, **fields)


_KINDS: dict[str, Any] = {
    kind: (Annotated[form, AfterValidator(build)], Field(default=None, description=about))
    for kind, (form, build, about) in space.KINDS.items()
}
Over: Any = _one_of("Over", "What a key is varied over.", 1, _KINDS)
_WAYS: dict[str, Any] = {
    way: (Count | None if way == GRID else Count, Field(default=None, description=about))
    for way, about in SAMPLES.items()
}
_WAYS[SEED] = (Annotated[int, Field(ge=0)], Field(default=0, description="Of all that is random."))
Samples: Any = _one_of("Samples", "How many variants, and how they are chosen.", 2, _WAYS)


class StudyFile(BaseModel):
    """What a study file says."""

    model_config = STRICT

    description: str = Field(default="", description="What the study asks, in a line.")
    scenario: Annotated[
        str, Field(min_length=1), needs(lambda x: isinstance(x, str) and x != "", NAMED)
    ] = Field(description="A file beside the study, or the name of a shipped scenario.")
    vary: Annotated[
        dict[str, Annotated[Over, BeforeValidator(_variation)]],
        Field(min_length=1),
        needs(lambda x: isinstance(x, dict) and x != {}, EMPTY),
    ] = Field(description="Paths of the scenario, such as tasks.reach.goal, and over what.")
    samples: Annotated[
        Samples, BeforeValidator(_samples, json_schema_input_type=Literal["grid"] | Samples)
    ] = Field(description="A way to sample and how many variants, and a seed (0).")
    metrics: list[Annotated[str, AfterValidator(_metric)]] = Field(
        default=[], description="Columns beside those that every study has."
    )

    @property
    def sampled(self) -> tuple[str, int]:
        """The way to sample, and how many; 0 where levels say it."""
        (way,) = self.samples.model_fields_set - {SEED}
        return way, getattr(self.samples, way) or 0


def schema(catalog: Catalog) -> dict[str, Any]:
    """The JSON Schema, for editors."""
    form = StudyFile.model_json_schema()
    form["properties"]["metrics"]["items"] = {"enum": list(catalog.entries("metrics"))}
    vary = form["properties"]["vary"]
    fields = file_model(catalog).model_fields
    # Any path is a key; editors propose those that lead to a key of the scenario itself.
    vary["properties"] = {
        key: {"description": field.description or "", **vary["additionalProperties"]}
        for key, field in fields.items()
        if key not in ("description", "folder", CONTROLLERS)
    }
    laws = {"enum": list(catalog.entries(CONTROLLERS))}
    choice = {"type": "array", "minItems": 1, "items": {"anyOf": [laws, {"type": "object"}]}}
    vary["properties"][CONTROLLERS] = {
        "description": "Each variant is run under all of them.",
        "type": "object",
        "properties": {"choice": choice},
        "required": ["choice"],
        "additionalProperties": False,
    }
    return form


#: Measured in every study, because its page shows them.
ALWAYS = ("reached", "task_error", "limit_margin_min", "limit_violation_max")
MAX_TRIED = 1000  # values of a key that are checked before anything runs


def read_study(path: Path, catalog: Catalog | None = None) -> Study:
    """Read and check a study, by its path or a shipped one's name; ScenarioError has all faults."""
    file = read_yaml(find(path, "studies"))
    with file.lines():
        return _study(file, catalog or Catalog(), None)


def study_text(path: Path, text: str, scenario: tuple[Path, str], catalog: Catalog) -> Study:
    """The same from texts that were kept of a study that has been read before.

    What its scenario names is not looked up, so that the plug-ins need not be there.
    """
    file = parsed(path, text)
    with file.lines():
        return _study(file, catalog, parsed(*scenario))


def _study(file: YamlFile, catalog: Catalog, scenario: YamlFile | None) -> Study:
    """A study; one that was kept with its scenario has been read before, with all that it names."""
    kept, form, wrong = scenario is not None, None, list[Wrong]()
    context = None if kept else {"metrics": catalog.entries("metrics")}
    try:
        form = StudyFile.model_validate_json(json.dumps(file.data), context=context)
    except ValidationError as error:
        wrong = [Wrong(*each) for each in wording.faults(error, file.data, StudyFile)]
    scenario = scenario or _scenario(file, wrong)
    if not form or not scenario or wrong:
        raise MisplacedError(wrong)
    given = ((path, dict(over), over.model_fields_set) for path, over in form.vary.items())
    defaults, vary = _defaults(file_model(catalog)), {path: x[kind] for path, x, (kind,) in given}
    base = scenario.changed(copy.deepcopy(scenario.data))
    chosen = vary.pop(CONTROLLERS, None)
    wrong += [] if chosen is None else _controllers(chosen, base, catalog, kept=kept)
    varied = list(_located(vary, base, defaults, wrong))
    wrong += _contradictions(varied)
    if not kept and not wrong:
        wrong += _tried(file, varied, scenario, base, catalog)
    refuse(wrong)
    points, levelled = _points(form, varied)
    (method, count), notes = form.sampled, list[str]()
    if method == "sobol" and count & (count - 1):
        even = 1 << round(math.log2(count))
        words = f"{count} is not a power of two; {even} points would fill the space more evenly"
        notes.append(f"{file.place(['samples', 'sobol'])}: {words}")
    listed = base.data.get(CONTROLLERS) or defaults[CONTROLLERS]
    return Study(
        file=file,
        scenario=base,
        scenario_text=(absolute(scenario.path), scenario.text),
        catalog=catalog,
        varied=tuple(levelled),
        controllers=tuple(map(_name, listed)),
        points=points,
        metrics=tuple(dict.fromkeys((*ALWAYS, *form.metrics))),
        seed=form.samples.seed,
        notes=tuple(notes),
    )


def _scenario(file: YamlFile, wrong: list[Wrong]) -> YamlFile | None:
    """The file of the study's scenario; beside the study, or shipped."""
    given = file.data.get("scenario")
    if not isinstance(given, str) or not given:
        return None  # its form is faulted
    beside = file.path.parent / given
    try:
        scenario = read_yaml(beside if beside.exists() else find(given))
    except ScenarioError as error:
        wrong += [Wrong(["scenario"], str(fault)) for fault in error.faults]
        return None
    if "vary" in scenario.data and "robot" not in scenario.data:
        wrong.append(Wrong(["scenario"], f"'{given}' is a study; needs a scenario"))
    return scenario


def _located(
    vary: Mapping[str, Variation], base: YamlFile, defaults: Mapping[str, Any], wrong: list[Wrong]
) -> Iterator[Varied]:
    for path, over in vary.items():
        if not path:
            words = "'' is not a path; needs one such as tasks.reach.goal"
            wrong.append(Wrong(["vary"], words, [path]))
            continue
        try:
            yield Varied(path, located(base.data, path, defaults), over)
        except InvalidValueError as error:
            wrong.append(Wrong(["vary", path], str(error)))


def _contradictions(varied: Sequence[Varied]) -> Iterator[Wrong]:
    """Keys that are varied twice."""
    for i, one in enumerate(varied):
        for other in varied[:i]:
            shorter = min(len(one.location), len(other.location))
            if one.location[:shorter] == other.location[:shorter]:
                words = f"is the same as '{other.path}', or in it; vary one of them"
                yield Wrong(["vary", one.path], words)


def _controllers(
    over: Variation, base: YamlFile, catalog: Catalog, *, kept: bool
) -> Iterator[Wrong]:
    """Write them into the scenario; each variant is run under all of them."""
    place = ["vary", CONTROLLERS]
    if over.values is None or over.numbers:
        yield Wrong(place, "needs choice: [...], names of controllers")
        return
    base.data[CONTROLLERS] = chosen = list(over.values)
    if kept:
        return
    refused = [
        Wrong(place, fault.message, ["choice", i])
        for i, one in enumerate(chosen)
        for fault in _faults(base.changed({**base.data, CONTROLLERS: [one]}), catalog)
        if f": {CONTROLLERS}" in fault.place
    ]
    yield from refused
    names = [] if refused else list(map(_name, chosen))
    for i, taken in taken_names(names):
        words = f"{taken}; give this one another, such as {{{names[i]}: {{name: other}}}}"
        yield Wrong(place, words, ["choice", i])


def _tried(
    file: YamlFile, varied: Sequence[Varied], scenario: YamlFile, base: YamlFile, catalog: Catalog
) -> Iterator[Wrong]:
    """What keys do not take of some of their values, each alone, and the scenario of all keys."""
    known = {fault.message for fault in _faults(scenario, catalog)}
    plain = {key: base.data[key] for key in (CONTROLLERS,) if key in base.data}
    data, refused = base.data, False
    for one in varied:
        alone = {**copy.deepcopy(scenario.data), **plain}
        located(alone, one.path, _defaults(file_model(catalog)))
        taken, messages, own = [], [], list[Wrong]()
        for i, value in enumerate(one.over.tried()[:MAX_TRIED]):
            tried = scenario.changed(put(alone, one.location, value))
            new = [fault for fault in _faults(tried, catalog) if fault.message not in known]
            messages += [fault.message for fault in new]
            taken += [] if new else [value]
            if one.over.values is not None:
                own += _own_faults(file, one, i, new)
        if taken:
            data = put(data, one.location, taken[0])
        elif not own:
            own = [Wrong(["vary", one.path], messages[0])]
        refused = refused or bool(own)
        yield from own
    if not refused and (found := _faults(base.changed(data), catalog)):
        raise ScenarioError(found)  # of the scenario's own file


def _own_faults(
    file: YamlFile, one: Varied, index: int, faults: Sequence[Fault]
) -> Iterator[Wrong]:
    """Those of a listed value itself; what contradicts other keys may go with others."""
    kind = next(iter(file.data["vary"][one.path]))
    for fault in faults:
        _, found, inside = fault.place.partition(f": {dotted(one.location)}")
        if found and inside[:1] in ("", ".", "["):
            words = f"{inside.lstrip('.')}: {fault.message}" if inside else fault.message
            yield Wrong(["vary", one.path], words, [kind, index])


def _faults(file: YamlFile, catalog: Catalog) -> Sequence[Fault]:
    try:
        check(file, catalog)
    except ScenarioError as error:
        return error.faults
    except CoopqpError as error:
        return [Fault(file.place([]), str(error))]
    return []


def _points(form: StudyFile, varied: Sequence[Varied]) -> tuple[Points, Sequence[Varied]]:
    """The points, and what is varied over them: on a grid everything has levels."""
    method, count = form.sampled
    if method != GRID:
        dimensions = sum(len(one.over.sides) for one in varied)
        return space.drawn(method, count, dimensions, form.samples.seed), varied
    wrong, levels, gridded = list[Wrong](), list[int](), list[Varied]()
    for one in varied:
        own = one.over.levels(count)
        if not all(own):
            some = all(one.over.levels(1))
            advice = "levels, or say samples: {grid: LEVELS}" if some else "values: [...]"
            wrong.append(Wrong(["vary", one.path], f"has no levels for a grid; give it {advice}"))
        levels += own
        gridded.append(replace(one, over=one.over.gridded(own)))
    if (size := math.prod(levels)) > MAX_POINTS:
        words = f"the grid has {size:,} points; needs at most {MAX_POINTS:,}"
        wrong.append(Wrong(["samples"], words))
    refuse(wrong)
    return Points(size, tuple(levels)), gridded


def _defaults(model: type[BaseModel]) -> dict[str, Any]:
    """What the keys are that a scenario leaves out, as far as a file could say it."""
    fields = model.model_fields.items()
    return {key: f.default for key, f in fields if isinstance(f.default, str | list | dict)}


def _name(slot: Any) -> str:
    """Name of a controller as a file has it."""
    kind, fields = next(iter(slot.items())) if isinstance(slot, dict) else (slot, None)
    return str((fields or {}).get("name") or kind)
