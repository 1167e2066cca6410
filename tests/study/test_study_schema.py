"""The JSON Schema of study files agrees with what reads them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import typed
from plate_study import STUDY, written
from pydantic import ValidationError

from coopqp.base.errors import ScenarioError
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.yaml import parsed
from coopqp.study.sweep import read_study
from coopqp.study.sweep.reader import StudyFile
from coopqp.study.sweep.space import KINDS, SAMPLES


def seen(text: str) -> None:
    """Check the text as an editor does."""
    context = {"metrics": Catalog().entries("metrics")}
    data = json.dumps(parsed(Path("study.yaml"), text).data)
    StudyFile.model_validate_json(data, context=context)


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


@pytest.mark.parametrize("method", SAMPLES)
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
    assert list(schema["properties"]) == list(StudyFile.model_fields)
    vary = schema["properties"]["vary"]
    assert vary["properties"]["dt"]["description"] == "Control period [s]."
    assert vary["additionalProperties"] == {"$ref": "#/$defs/Over"}
    assert list(schema["$defs"]["Over"]["properties"]) == list(KINDS)
    assert "qp" in json.dumps(vary["properties"]["controllers"])
    assert "task_error" in json.dumps(schema["properties"]["metrics"])
