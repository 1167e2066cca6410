"""The form of a study file as a JSON Schema, for editors.

Reading (:mod:`coopqp.study.sweep.reader`) does not use it: that answers with lines and likely
fixes, and looks into the scenario besides.
"""

from __future__ import annotations

import types
from functools import reduce
from operator import or_
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, create_model

from coopqp.scenario.catalog import Catalog
from coopqp.scenario.form import STRICT, file_model
from coopqp.study.sweep.points import METHODS, MOST
from coopqp.study.sweep.study import CONTROLLERS, SEED

Numbers = Annotated[list[float], Field(min_length=1)]
Level = Annotated[int, Field(ge=1)]
Ends = Annotated[list[float], Field(min_length=2, max_length=3)]

#: What stands behind each variation, and what it means.
VARIATIONS: dict[str, tuple[Any, str]] = {
    "range": (Ends, "Even between two numbers; a third is the number of levels."),
    "log": (Ends, "Even in the logarithm between two numbers above 0; a third: levels."),
    "box": (
        Annotated[list[Numbers | list[Level] | Level], Field(min_length=2, max_length=3)],
        "Lists of numbers between two corners; a third list, or one number: levels.",
    ),
    "normal": (
        Annotated[list[float], Field(min_length=2, max_length=2)],
        "Mean and standard deviation.",
    ),
    "values": (
        Annotated[list[float | Numbers], Field(min_length=1)],
        "These numbers, or these lists of numbers.",
    ),
    "choice": (Annotated[list[Any], Field(min_length=1)], "These, whatever they are."),
}
SAMPLES = {
    "sobol": "Points of Sobol's sequence, even from the first on; best a power of two.",
    "random": "Points, each by itself.",
    "latin_hypercube": "Points, in each dimension in as many even parts.",
}


def schema(catalog: Catalog) -> dict[str, Any]:
    """The JSON Schema.

    Args:
        catalog: what the study's scenario can name.
    """
    found: dict[str, Any] = study_model(catalog).model_json_schema()
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


def study_model(catalog: Catalog) -> Any:
    """The pydantic model that the schema is made from.

    Args:
        catalog: what the study's scenario can name.
    """
    metric: Any = Literal[tuple(catalog.entries("metrics"))]
    over = [_one("Over", {kind: (form, ...)}, about) for kind, (form, about) in VARIATIONS.items()]
    count = Annotated[int, Field(ge=1, le=MOST)]
    seed = (Annotated[int, Field(ge=0)], Field(default=0, description="Of all that is random."))
    drawn = [_one("By", {k: (count, ...), SEED: seed}, SAMPLES[k]) for k in METHODS]
    about = "Every level with every other; N levels where none are said."
    grid = _one("By", {"grid": (count | None, ...), SEED: seed}, about)
    keys: dict[str, Any] = {
        "scenario": (
            Annotated[str, Field(min_length=1)],
            Field(description="A file beside the study, or the name of a shipped scenario."),
        ),
        "vary": (
            Annotated[dict[str, reduce(or_, over)], Field(min_length=1)],  # type: ignore[misc]
            Field(description="Paths of the scenario, such as tasks.reach.goal, and over what."),
        ),
        "samples": (
            reduce(or_, [*drawn, grid]) | Literal["grid"],
            Field(description="How many variants, and how they are chosen."),
        ),
        "metrics": (
            types.GenericAlias(list, (metric,)),
            Field(default=[], description="Columns beside those that every study has."),
        ),
    }
    return create_model("Study", __config__=STRICT, **keys)


def _one(word: str, keys: dict[str, Any], about: str) -> Any:
    """A mapping with these keys, the first of which names it."""
    name = word + next(iter(keys)).title().replace("_", "")
    return create_model(name, __config__=ConfigDict(**STRICT), __doc__=about, **keys)
