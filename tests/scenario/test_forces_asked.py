"""What is said of forces before a run: notes and refusals with their place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from command_line import typed
from scenario_files import needs_robots

import coopqp
from coopqp.base.errors import InvalidValueError, ScenarioError
from coopqp.controllers import TorqueQp
from coopqp.plant import Disturbance
from coopqp.scenario.input import InputSettings
from coopqp.scenario.loader import shipped
from coopqp.scenario.notes import notes
from coopqp.scenario.scenario import Scenario
from coopqp.signals import Input
from coopqp.tasks import Impedance, InternalWrench


def squeezing(**squeeze: object) -> Scenario:
    """``position_pair`` with another squeeze."""
    scenario = coopqp.load("position_pair")
    others = tuple(task for task in scenario.tasks if not task.of_forces)
    return replace(scenario, tasks=(*others, InternalWrench(name="press", **squeeze)))  # type: ignore[arg-type]


@needs_robots
def test_a_squeeze_beyond_the_motors_is_noted_where_no_law_knows_them() -> None:
    said = [line for line in notes(squeezing(squeeze=3000.0)) if "wants 3e+03 N" in line]
    assert len(said) == 1
    assert "motor " in said[0]
    assert not any("wants" in line for line in notes(squeezing(squeeze=60.0)))


@needs_robots
def test_an_input_that_a_squeeze_follows_is_followed() -> None:
    scenario = squeezing(squeeze=Input(name="f", start=[60.0]))
    scenario = replace(scenario, inputs={"f": InputSettings(velocity=50.0, acceleration=100.0)})
    assert list(scenario.followed()) == ["f"]
    assert not any("no task follows" in line for line in notes(scenario))


def springs(**settings: object) -> Impedance:
    return Impedance(goal={"position": (0.6, 0.0, 0.45)}, **settings)  # type: ignore[arg-type]


def test_what_has_no_effect_on_an_impedance_is_refused() -> None:
    with pytest.raises(InvalidValueError, match="gain: found 20, which has no effect"):
        springs(stiffness={"y": 400.0}, gain=20.0)
    with pytest.raises(InvalidValueError, match="y: found true, needs a number"):
        springs(stiffness={"y": True})
    with pytest.raises(InvalidValueError, match="observer_gain: found 10, but nothing is observed"):
        TorqueQp(observer_gain=10.0)


@needs_robots
def test_friction_of_firm_hands_is_noted_as_none() -> None:
    scenario = replace(coopqp.load("impedance"), disturbance=Disturbance(friction=0.5))
    assert "disturbance.friction has no effect: no hand holds by pressing" in notes(scenario)
    pads = replace(coopqp.load("press_and_lift"), disturbance=Disturbance(friction=0.5))
    assert not any("disturbance.friction" in line for line in notes(pads))


@needs_robots
def test_axes_without_a_spring_are_noted_where_nobody_knows_the_push() -> None:
    scenario = coopqp.load("impedance")
    some = replace(scenario, tasks=(springs(stiffness={"x": 1500.0, "y": 250.0}),))
    assert not any("nobody knows the push" in line for line in notes(scenario))
    said = [line for line in notes(some) if "nobody knows the push" in line]
    assert len(said) == 1
    assert said[0].startswith("torque_qp: ")  # and not the one that observes
    knows = replace(some, controllers={"torque_qp": TorqueQp(external_wrench="observed")})
    assert not any("nobody knows the push" in line for line in notes(knows))


@needs_robots
def test_validate_refuses_what_every_run_would_be_refused_for(tmp_path: Path) -> None:
    lines = shipped()["impedance"].read_text(encoding="utf-8").splitlines()
    stiff = [line.replace("{x: 3000, y: 400", "{x: 3.0e9, y: 400") for line in lines]
    path = tmp_path / "stiff.yaml"
    path.write_text("\n".join(stiff), encoding="utf-8")
    result = typed("validate", str(path))
    assert result.exit_code == 2
    assert "oscillates at dt 1 ms" in result.output
    path.write_text("\n".join(lines), encoding="utf-8")
    assert typed("validate", str(path)).exit_code == 0


def test_springs_are_of_joints_that_there_are_and_the_rest_is_rigid(tmp_path: Path) -> None:
    path, text = tmp_path / "s.yaml", coopqp.load("point_on_point").source.rstrip("\n")
    more = "\nobserver:\n  stiffness: {RElbowYaw: 300, LElbowYaw: 300}\n"
    path.write_text(text + more, encoding="utf-8")
    (line,) = (line for line in notes(coopqp.load(path)) if "observer" in line)
    words = "RShoulderPitch and 7 other joints without one count as rigid"
    assert line == f"observer.stiffness: {words}"
    path.write_text(text + more.replace("LElbowYaw", "LElbowYwa"), encoding="utf-8")
    at = rf":{len(text.splitlines()) + 2}: observer.stiffness.LElbowYwa: unknown joint 'LElbowYwa'"
    with pytest.raises(ScenarioError, match=at + "; did you mean 'LElbowYaw'"):
        coopqp.load(path)
    path.write_text(text + "\nobserver: {dead_band: {LElbowYwa: 0.01}}\n", encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"observer.dead_band.LElbowYwa: unknown joint"):
        coopqp.load(path)
