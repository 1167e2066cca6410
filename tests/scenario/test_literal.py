"""What a file calls true, or a text, is no number, at whatever depth."""

from __future__ import annotations

from pathlib import Path

import pytest

from coopqp.base.errors import ScenarioError
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.form import check
from coopqp.scenario.loader import shipped
from coopqp.scenario.yaml import parsed


@pytest.mark.parametrize(
    ("scenario", "before", "after", "place"),
    [
        ("planar_pair", "gain: 5.0", "gain: true", "tasks[0].point_on_point.gain"),
        ("planar_pair", "gain: 5.0", 'gain: "5"', "tasks[0].point_on_point.gain"),
        ("planar_pair", "[0.36,", "[true,", "tasks[0].point_on_point.goal[0]"),
        ("planar_pair", "mass: 0.5", "mass: true", "object.mass"),
        ("planar_pair", "{gain: 0.5}", "{gain: true}", "secondary[0].joint_centering.gain"),
        ("planar_pair", "dt: 0.01", "dt: true", "dt"),
        ("planar_pair", "robot: planar_pair", "robot: {planar_pair: {distance: true}}",
         "robot.planar_pair.distance"),
        ("three_ur", "[0.75, 0.0, 0.0]", "[true, 0.0, 0.0]", "robot.several.robots.front.position"),
    ],
)  # fmt: skip
def test_only_numbers_are_numbers(scenario: str, before: str, after: str, place: str) -> None:
    text = shipped()[scenario].read_text(encoding="utf-8")
    assert before in text
    with pytest.raises(ScenarioError) as caught:
        check(parsed(Path("s.yaml"), text.replace(before, after, 1)), Catalog())
    (fault,) = caught.value.faults
    assert f": {place}" in fault.place
    assert "needs a number" in fault.message


def test_true_stays_what_it_is_where_truths_are_asked_for() -> None:
    text = shipped()["planar_pair"].read_text(encoding="utf-8")
    check(parsed(Path("s.yaml"), text + "start_outside: true\n"), Catalog())
    with pytest.raises(ScenarioError, match="needs true or false"):
        check(parsed(Path("s.yaml"), text + "start_outside: 1\n"), Catalog())
