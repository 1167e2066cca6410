"""The form of a study file: it is read by this model, which gives its JSON Schema too."""

from __future__ import annotations

import json
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    create_model,
)

from coopqp.base import wording
from coopqp.base.errors import unknown_name
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.form import STRICT, Words, file_model
from coopqp.scenario.yaml import Wrong, YamlFile
from coopqp.study.sweep import space
from coopqp.study.sweep.space import GRID, MOST, SAMPLES
from coopqp.study.sweep.study import CONTROLLERS, SEED

NAMED = "needs the path of a scenario, or the name of a shipped one"


def _variation(value: Any) -> Any:
    if not isinstance(value, dict) or len(value) != 1:
        found = f"found {len(value)} keys" if isinstance(value, dict) else "found no mapping"
        raise ValueError(
            f"{found}; needs exactly one of {', '.join(space.KINDS)}, such as range: [0, 1]"
        )
    (kind,) = value
    if kind not in space.KINDS:
        raise ValueError(unknown_name("variation", kind, space.KINDS))
    return value


def _filled(kind: type, words: str) -> BeforeValidator:
    def check(value: Any) -> Any:
        if not isinstance(value, kind) or not value:
            raise ValueError(words)
        return value

    return BeforeValidator(check)


def _samples(value: Any) -> Any:
    """One way to sample with its count, and a seed."""
    if not isinstance(value, str | dict):
        raise ValueError("needs a way to sample, such as sobol: 1024, or grid")
    named = value if isinstance(value, dict) else {value: None}
    asked = [key for key in named if key != SEED]
    for key in asked:
        if key not in SAMPLES:
            raise ValueError(unknown_name("way to sample", key, SAMPLES))
    if len(asked) != 1:
        ways = ", ".join((GRID, *(way for way in SAMPLES if way != GRID)))
        raise ValueError(f"found {len(asked)}; needs exactly one of {ways}, such as sobol: 1024")
    return named


def _count(value: Any) -> Any:
    if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= MOST:
        raise ValueError(f"needs a whole number of 1 to {MOST:,}")
    return value


def _metric(name: str, info: ValidationInfo) -> str:
    known = (info.context or {}).get("metrics")
    if known is not None and name not in known:
        raise ValueError(unknown_name("metric", name, known))
    return name


Count = Annotated[int, Field(ge=1, le=MOST), BeforeValidator(_count)]
_KINDS: dict[str, Any] = {
    kind: (Annotated[form, AfterValidator(build)], Field(default=None, description=about))
    for kind, (form, build, about) in space.KINDS.items()
}
Over: Any = create_model(
    "Over",
    __config__=ConfigDict(**STRICT, json_schema_extra={"minProperties": 1, "maxProperties": 1}),
    __doc__="What a key is varied over.",
    **_KINDS,
)
_WAYS: dict[str, Any] = {
    way: (Count | None if way == GRID else Count, Field(default=None, description=about))
    for way, about in SAMPLES.items()
}
_SEED: Any = (Annotated[int, Field(ge=0)], Field(default=0, description="Of all that is random."))
Samples: Any = create_model(
    "Samples",
    __config__=ConfigDict(**STRICT, json_schema_extra={"minProperties": 1, "maxProperties": 2}),
    __doc__="How many variants, and how they are chosen.",
    **_WAYS,
    **{SEED: _SEED},
)


class StudyFile(BaseModel):
    """What a study file says."""

    model_config = STRICT

    description: str = Field(default="", description="What the study asks, in a line.")
    scenario: Annotated[str, Field(min_length=1), _filled(str, NAMED)] = Field(
        description="A file beside the study, or the name of a shipped scenario."
    )
    vary: Annotated[
        dict[str, Annotated[Over, BeforeValidator(_variation)]],
        Field(min_length=1),
        _filled(dict, "is empty; needs a path of the scenario: what to vary it over"),
    ] = Field(description="Paths of the scenario, such as tasks.reach.goal, and over what.")
    samples: Annotated[Samples, BeforeValidator(_samples), Words((GRID,))] = Field(
        description="A way to sample and how many variants, and a seed (0)."
    )
    metrics: list[Annotated[str, AfterValidator(_metric)]] = Field(
        default=[], description="Columns beside those that every study has."
    )

    @property
    def variations(self) -> dict[str, space.Variation]:
        """What each path is varied over."""
        given = ((path, dict(over), over.model_fields_set) for path, over in self.vary.items())
        return {path: over[kind] for path, over, (kind,) in given}

    @property
    def sampled(self) -> tuple[str, int]:
        """The way to sample, and how many; 0 where levels say it."""
        (way,) = self.samples.model_fields_set - {SEED}
        return way, getattr(self.samples, way) or 0


def read_form(file: YamlFile, catalog: Catalog | None) -> tuple[StudyFile | None, list[Wrong]]:
    """What a file says, and what is wrong with that."""
    context = {"metrics": catalog.entries("metrics")} if catalog else None
    try:
        return StudyFile.model_validate_json(json.dumps(file.data), context=context), []
    except ValidationError as error:
        return None, [Wrong(*wrong) for wrong in wording.faults(error, file.data, StudyFile)]


def schema(catalog: Catalog) -> dict[str, Any]:
    """The JSON Schema, for editors."""
    found = StudyFile.model_json_schema()
    found["properties"]["metrics"]["items"] = {"enum": list(catalog.entries("metrics"))}
    vary = found["properties"]["vary"]
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
    return found
