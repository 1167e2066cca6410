"""What is said of forces before a run: notes and refusals with their place."""

from __future__ import annotations

from dataclasses import replace

import coopqp
from coopqp.input import InputSettings
from coopqp.scenario.notes import notes
from coopqp.scenario.scenario import Scenario
from coopqp.signals import Input
from coopqp.tasks import InternalWrench


def squeezing(**squeeze: object) -> Scenario:
    """``position_pair`` with another squeeze."""
    scenario = coopqp.load("position_pair")
    others = tuple(task for task in scenario.tasks if not task.of_forces)
    return replace(scenario, tasks=(*others, InternalWrench(name="press", **squeeze)))  # type: ignore[arg-type]


def test_a_squeeze_beyond_the_motors_is_noted_where_no_law_knows_them() -> None:
    said = [line for line in notes(squeezing(squeeze=3000.0)) if "wants 3e+03 N" in line]
    assert len(said) == 1
    assert "motor " in said[0]
    assert not any("wants" in line for line in notes(squeezing(squeeze=60.0)))


def test_an_input_that_a_squeeze_follows_is_followed() -> None:
    scenario = squeezing(squeeze=Input(name="f", start=[60.0]))
    scenario = replace(scenario, inputs={"f": InputSettings(velocity=50.0, acceleration=100.0)})
    assert list(scenario.followed()) == ["f"]
    assert not any("no task follows" in line for line in notes(scenario))
