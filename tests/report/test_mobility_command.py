"""The command mobility."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from chains import PAPER_SCHEME
from command_line import typed

from coopqp.scenario.loader import shipped


def test_command_prints_json_alone() -> None:
    result = typed("mobility", "point_on_point", "--json", "--actuated", "q1,q2,q3,q7")
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    assert (found["rank"], found["freedom"], found["object_freedom"]) == (6, 4, 4)
    assert (found["inadmissible"], found["inadmissible_start"]) == (71, 91)
    assert found["schemes_total"] == len(found["schemes"]) == 210
    assert found["asked"]["joints"] == list(PAPER_SCHEME)
    assert found["asked"]["admissible"]
    assert not found["asked"]["admissible_start"]
    assert len(found["lost_at_start"]) == 20
    assert [(t["name"], t["rows"], t["rank"]) for t in found["tasks"]] == [("reach", 3, 3)]
    assert len(found["impossible"]) == 2
    assert all(np.isfinite(found["manipulability"]["value"]))
    assert "4 degrees of freedom" in found["verdict"]


def test_command_prints_tables_and_a_verdict() -> None:
    result = typed("mobility", "point_on_point")
    assert result.exit_code == 0
    text = " ".join(result.output.split())
    assert "71 of 210" in text
    assert "91 of 210" in text
    assert "can all be met" in text


@pytest.mark.parametrize(
    ("actuated", "message"),
    [
        ("q1,q2,q3", "found 3 joints, needs 4"),
        ("q1,q2,q3,q7,q8", "found 5 joints, needs 4"),
        ("q1,q2,q3,q3", "RElbowYaw given more than once"),
        ("q1,q2,q3,RElbowYaw", "RElbowYaw given more than once"),
        ("q1,q2,q3,q11", "unknown joint 'q11'"),
        ("RShoulderPich,q2,q3,q7", "did you mean 'RShoulderPitch'"),
        ("", "actuated"),
    ],
)
def test_wrong_schemes_end_with_one_message_and_exit_code_2(actuated: str, message: str) -> None:
    result = typed("mobility", "point_on_point", "--actuated", actuated)
    assert result.exit_code == 2
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith("error: ")
    assert message in line
    assert result.stdout == ""


def test_a_scenario_that_no_run_is_made_of_is_told_of_all_the_same(tmp_path: Path) -> None:
    """Torques on a plant that takes none: the table, and then the refusal."""
    lines = shipped()["planar_pair"].read_text(encoding="utf-8").splitlines()
    kept = [line for line in lines if not line.startswith("controllers:")]
    path = tmp_path / "refused.yaml"
    path.write_text("\n".join([*kept, "controllers: [torque_qp]"]), encoding="utf-8")
    result = typed("mobility", str(path))
    assert result.exit_code == 2
    assert "degrees of freedom" in result.output
    assert "commands torques, which this plant does not take" in result.output
