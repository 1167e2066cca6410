"""Joints side by side, the names of arms, the criterion, and which figures come first."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenario_files import HEAD, PHASES, TAIL, cut, needs_robots, phased

import coopqp
from coopqp.execution.comparison import Comparison
from coopqp.metrics.limit_criterion import limit_criterion
from coopqp.model.state import State
from coopqp.report.curves import Chart
from coopqp.report.figures.groups import groups
from coopqp.report.figures.joints import joint_figures, joint_rows, limit_figures
from coopqp.report.scene.playback import scene
from coopqp.scenario.loader import load
from coopqp.task import TaskStack
from coopqp.tasks import JointCentering


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return coopqp.compare(load("point_on_point"), controllers=["qp", "pseudoinverse"])


def test_equal_arms_stand_side_by_side() -> None:
    chain = load("point_on_point").chain
    rows = joint_rows(chain)
    names = [[chain.joint_names[j] for j in row] for row in rows]
    assert all(right == f"R{left[1:]}" for right, left in names)
    captions = [next(iter(row.values())) for row in rows]
    assert captions == [f"q{k} of the right arm" for k in range(1, 6)]


@needs_robots
def test_a_shared_torso_stands_alone_and_shifts_no_arm() -> None:
    chain = load("tiago_torso").chain
    torso, *rows = joint_rows(chain)
    assert {chain.joint_names[j]: caption for j, caption in torso.items()} == {
        "torso_lift_joint": "carries right and left"
    }
    for k, row in enumerate(rows, start=1):
        names = [chain.joint_names[j] for j in row]
        assert names == [f"arm_right_{k}_joint", f"arm_left_{k}_joint"]
        assert [*row.values()] == [f"q{k} of the right arm", f"q{k} of the left arm"]


@needs_robots
def test_the_names_stand_at_the_right_arms_although_they_share_a_torso() -> None:
    """TIAGo looks along x: its right arm is at negative y; the torso is in both arms' way."""
    drawn = scene(coopqp.compare(cut(load("tiago_torso"), 5), controllers=["qp"]))
    (run,) = drawn["controllers"]
    sides = {arm["name"]: np.array(arm["points"])[0] for arm in run["arms"]}
    np.testing.assert_allclose(sides["right"][0], sides["left"][0])  # where names stood before
    for arm in run["arms"]:
        place, y = sides[arm["name"]][arm["label"]], 1.0 if arm["name"] == "left" else -1.0
        assert y * place[1] > 0.2
        others = np.concatenate([p for name, p in sides.items() if name != arm["name"]])
        assert np.linalg.norm(others - place, axis=1).min() > 0.2


def test_arms_keep_their_colours_when_the_first_one_lets_go(tmp_path: Path) -> None:
    """Bodies count arms as the robot does, whoever holds the object."""
    text = HEAD + PHASES.split("  - name: alone")[0] + "    released: [right]\n" + TAIL
    scenario = phased(tmp_path, text)
    assert [arm.name for arm in scenario.chain.arms] == ["left", "right"]
    (run,) = scene(coopqp.compare(scenario))["controllers"]
    assert [arm["name"] for arm in run["arms"]] == ["right", "left"]


def test_joints_at_their_limits_come_first_and_each_joint_once(comparison: Comparison) -> None:
    decisive, near, others = joint_figures(Chart(comparison))
    assert [figure.title for figure in decisive] == ["LElbowRoll", "RElbowRoll"]
    first = [*decisive, *near]
    trace = comparison.traces["pseudoinverse"]
    beyond = ((trace.q < trace.lower) | (trace.q > trace.upper)).any(axis=0)
    shown = [figure.title for figure in first]
    assert {name for name, out in zip(trace.joints, beyond, strict=True) if out} <= set(shown)
    assert sorted(shown + [figure.title for figure in others]) == sorted(trace.joints)
    about = {figure.title: figure.about for figure in (*first, *others)}
    assert about["RElbowRoll"] == "q4 of the right arm, Fig. 7 of the paper"
    assert about["LElbowRoll"] == "q4 of the left arm"


def test_criterion_is_zero_in_the_middle_and_a_quarter_for_each_joint_at_a_limit(
    comparison: Comparison,
) -> None:
    trace = comparison.traces["qp"]
    middle = np.tile(0.5 * (trace.lower + trace.upper), (3, 1))
    at = middle.copy()
    at[1], at[2, :4] = trace.upper, trace.lower[:4]
    found = limit_criterion(replace(trace, q=at))["quadratic"]
    np.testing.assert_allclose(found, [0.0, 0.25 * len(trace.joints), 1.0], atol=1e-15)
    free = replace(trace, q=at, upper=np.where(np.arange(10) < 4, np.inf, trace.upper))
    np.testing.assert_allclose(limit_criterion(free)["quadratic"], [0.0, 1.5, 0.0], atol=1e-15)


def test_the_task_that_centres_joints_descends_the_criterion(
    comparison: Comparison, rng: np.random.Generator
) -> None:
    trace, chain, h = comparison.traces["qp"], comparison.scenario.chain, 1e-4
    q = chain.sample(rng, 1)[0]
    steps = np.concatenate([q + h * np.eye(chain.n), q - h * np.eye(chain.n)])
    phi = limit_criterion(replace(trace, q=steps))["quadratic"]
    gradient = (phi[: chain.n] - phi[chain.n :]) / (2 * h)
    state = State(chain, q)
    tasks = TaskStack([JointCentering(gain=0.5)], state)
    tasks.update(state)
    np.testing.assert_allclose(tasks.wanted, -0.5 * gradient, atol=1e-9)


def test_the_figure_of_the_criterion_shows_it_for_every_law(comparison: Comparison) -> None:
    (figure,) = (f for f in limit_figures(Chart(comparison)) if "criterion" in f.title)
    assert {line["legendgroup"] for line in figure.data} == set(comparison.traces)
    for line in figure.data:
        expected = limit_criterion(comparison.traces[line["legendgroup"]])["quadratic"]
        np.testing.assert_allclose(line["y"], expected, rtol=1e-6)


def test_only_the_times_of_ticks_have_no_time_axis(comparison: Comparison) -> None:
    drawn = [f for group in groups(comparison) for f in (*group.figures, *group.folded)]
    without = [f.title for f in drawn if not f.over_time]
    assert without
    assert set(without) <= {"Time of a tick in C++", "Time of a tick in Python"}
    for figure in drawn:
        if figure.over_time:
            assert figure.layout["xaxis"]["range"] == pytest.approx([0.0, 3.0])
    titles = [f.title for group in groups(comparison) for f in group.figures]
    assert titles[:2] == ["LElbowRoll", "RElbowRoll"]  # directly below the result
    assert titles[2:6] == [*(f"{axis} of the object" for axis in "xyz"), "Tilt of the object"]
