"""The JSON Schema of study files agrees with what reads them."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from command_line import typed
from plate_study import STUDY, written
from pydantic import ValidationError

from coopqp.errors import ScenarioError
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.yaml import parsed
from coopqp.study.sweep import read_study
from coopqp.study.sweep.form import study_model
from coopqp.study.sweep.points import METHODS
from coopqp.study.sweep.reader import GRID, KEYS
from coopqp.study.sweep.space import KINDS


@cache
def model() -> Any:
    return study_model(Catalog())


def seen(text: str) -> None:
    """Check the text as an editor does."""
    model().model_validate_json(json.dumps(parsed(Path("study.yaml"), text).data))


MASS = "object.mass: {log: [0.1, 2.0]}"
ALLOWED = [
    "log: [0.1, 2.0, 5]",
    "range: [1, 2]",
    "normal: [1.0, 0.2]",
    "values: [1, 2]",
    "choice: [0.5, 1.5]",
]


@pytest.mark.parametrize("over", ALLOWED)
def test_what_is_read_is_in_the_schema(plate: Path, over: str) -> None:
    text = STUDY.replace(MASS, f"object.mass: {{{over}}}")
    read_study(written(plate, text))
    seen(text)


@pytest.mark.parametrize("method", [*METHODS, GRID])
def test_every_way_to_sample_is_in_the_schema(plate: Path, method: str) -> None:
    text = STUDY.replace("sobol: 8", f"{method}: 8")
    read_study(written(plate, text))
    seen(text)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("log: [0.1", "lgo: [0.1"),
        ("log: [0.1, 2.0]", "values: []"),
        ("log: [0.1, 2.0]", "range: [0, 1], log: [1, 2]"),
        ("log: [0.1, 2.0]", "normal: [1]"),
        ("box: [[0.30, -0.05, 0.0], ", "box: ["),
        ("sobol: 8", "sobl: 8"),
        ("sobol: 8", "sobol: 0"),
        ("sobol: 8", "sobol: 8, random: 8"),
        ("seed: 1", "seed: -1"),
        ("[loop_error_max]", "[loop_eror_max]"),
        ("metrics:", "metric:"),
        ("scenario: plate.yaml", ""),
    ],
)
def test_what_is_refused_is_not(plate: Path, before: str, after: str) -> None:
    assert before in STUDY
    text = STUDY.replace(before, after)
    with pytest.raises(ScenarioError):
        read_study(written(plate, text))
    with pytest.raises(ValidationError):
        seen(text)


def test_the_command_prints_it() -> None:
    schema = json.loads(typed("schema", "--study").stdout)
    assert list(schema["properties"]) == list(KEYS)
    vary = schema["properties"]["vary"]
    assert vary["properties"]["dt"]["description"] == "Control period [s]."
    kinds = [schema["$defs"][one["$ref"].split("/")[-1]]["required"]
             for one in vary["additionalProperties"]["anyOf"]]  # fmt: skip
    assert sorted(kinds) == [[kind] for kind in sorted(KINDS)]
    assert "qp" in json.dumps(vary["properties"]["controllers"])
    assert "task_error" in json.dumps(schema["properties"]["metrics"])
