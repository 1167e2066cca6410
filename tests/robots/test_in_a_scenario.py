"""Robots in a scenario file: paths, tables, faults with their place, the manual's examples."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nao_in_files import in_urdf
from scenario_files import GOOD, write

from coopqp.base.errors import ScenarioError
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.form import check, chosen
from coopqp.scenario.loader import load
from coopqp.scenario.yaml import read_yaml


def scenario_with(folder: Path, robot: str) -> Path:
    """A scenario whose robot is spelled in one line."""
    return write(folder, GOOD.replace("robot: nao_t14", f"robot: {robot}"))


def test_a_path_counts_from_the_scenario_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "models").mkdir()
    in_urdf(tmp_path / "models")
    path = scenario_with(
        tmp_path, "{urdf: {path: models/nao.urdf, arms: {right: RHand, left: LHand}}}"
    )
    monkeypatch.chdir("/")
    assert load(path).robot_model.joint_names[0] == "LShoulderPitch"
    monkeypatch.chdir(tmp_path)
    assert load("scenario.yaml").robot_model.name == "nao"


TABLE = """
  mdh_table:
    rows:                       # a(j), sigma, gamma, b, alpha, d, theta, r
      - {name: 1, antecedent: 0, sigma: 0, b: 0.1, lower_deg: -90, upper_deg: 90}
      - {name: slide, antecedent: 1, sigma: prismatic, alpha_deg: 90, lower: 0, upper: 0.5}
      - {name: wrist, antecedent: slide, sigma: fixed, d: 0.1}
      - {name: 3, antecedent: wrist, theta_deg: 90, velocity_deg: 180, mass: 1, com: [0, 0, 0.1]}
      - {name: b1, gamma_deg: 90}
    arms: {left: 3, right: hand}
    tips: {hand: {parent: b1, offset: [0.1, 0, 0]}}
"""


def test_a_table_is_read_as_it_is_printed(tmp_path: Path) -> None:
    path = tmp_path / "table.yaml"
    rest = "tasks: [point_on_point: {goal: [0, 0, 1]}]\nduration: 1\n"
    path.write_text(f"robot:{TABLE}{rest}", encoding="utf-8")
    read: Any = check(read_yaml(path), Catalog())
    robot = chosen(read.robot)[1].build()
    assert robot.joint_names == ("1", "slide", "3", "b1")
    model = robot.model
    np.testing.assert_allclose(model.upperPositionLimit, [math.pi / 2, 0.5, np.inf, np.inf])
    np.testing.assert_allclose(model.velocityLimit, [np.inf, np.inf, math.pi, np.inf])
    assert model.effortLimit[0] == np.inf
    assert [arm.name for arm in robot.arms] == ["left", "right"]


TWO_PAIRS = (
    "{several: {robots: {a: {robot: {planar_pair: {distance: 0.5}}},"
    " b: {robot: planar_pair, position: [1, 0, 0], rpy_deg: [0, 0, 180]}}}}"
)


def test_faults_inside_one_of_several_robots_have_their_place(tmp_path: Path) -> None:
    for old, new, message in (
        ("distance: 0.5", "distanc: 0.5", "planar_pair.distanc: unknown key 'distanc'; did you"),
        ("distance: 0.5", "distance: -1", "distance: found -1; needs greater than 0"),
        ("planar_pair, pos", "planar_pear, pos", "2: robot.several.robots.b.robot: unknown robot"),
        ("position: [1, 0, 0]", "position: [1, 0]", "b.position: found [1, 0]; needs 3 numbers"),
        ("position", "positoin", "unknown key 'positoin'; did you mean 'position'"),
        ("rpy_deg", "rpy: [0, 0, 1], rpy_deg", "not both"),
        ("{robot: planar_pair, position", "{position", "b.robot: is missing"),
    ):  # fmt: skip
        assert old in TWO_PAIRS
        with pytest.raises(ScenarioError) as caught:
            load(scenario_with(tmp_path, TWO_PAIRS.replace(old, new, 1)))
        assert message in str(caught.value)
        assert len(caught.value.faults) == 1


def test_a_robot_that_cannot_be_read_is_a_fault_of_the_scenario(tmp_path: Path) -> None:
    path = scenario_with(tmp_path, "{urdf: {path: none.urdf, arms: {right: a, left: b}}}")
    with pytest.raises(ScenarioError, match=r"scenario.yaml:2: robot: .*none.urdf: cannot be read"):
        load(path)
