"""The playback: every scenario, its bodies, goals and planes."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scenario_files import LOADABLE, cut, needs_robots
from shipped_runs import beginning

import coopqp
from coopqp.report.page import render
from coopqp.report.scene.bodies import MAX_TRIANGLES, robot_bodies
from coopqp.report.scene.playback import MAX_FRAMES, scene
from coopqp.robot import Robot, RobotModel
from coopqp.robots import NaoT14
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Phase

PAGE = 600_000  # most that a robot may add to a page, for each controller [characters]


@pytest.mark.few(5)
@pytest.mark.parametrize("name", LOADABLE)
def test_every_scenario_can_be_drawn_within_the_budget(name: str) -> None:
    found = beginning(name)
    scenario, drawn = found.scenario, scene(found)
    json.dumps(drawn, allow_nan=False)
    assert len(json.dumps(drawn["bodies"])) < PAGE
    assert drawn["bodies"]
    for arm in range(len(scenario.robot_model.arms)):
        assert any(body["arm"] == arm for body in drawn["bodies"])
    triangles = sum(len(body["triangles"]) for body in drawn["bodies"]) // 3
    assert 100 < triangles <= MAX_TRIANGLES * (len(scenario.chain.arms) + 1)
    moving = sum(body["moves"] for body in drawn["bodies"])
    for body in drawn["bodies"]:
        assert max(body["triangles"]) < len(body["vertices"]) // 3
    for run in drawn["controllers"]:
        assert len(run["poses"]) == len(drawn["t"]) <= MAX_FRAMES
        assert all(len(poses) == 7 * moving for poses in run["poses"])


@pytest.mark.parametrize("name", ["passive_grasp_pose", "rigid_vs_passive", "planar_pair"])
def test_bodies_move_as_in_the_chain_that_the_controller_moves(name: str) -> None:
    """By the closed chain's own model, passive joints and all."""
    comparison = beginning(name)
    scenario = comparison.scenario
    drawn, robot = scene(comparison), scenario.chain.robot
    bodies, _ = robot_bodies(robot)
    names = [robot.model.names[body.joint] for body in bodies if body.joint]
    for run in drawn["controllers"]:
        trace = comparison.traces[run["name"]]
        model = scenario.held_by(run["name"]).chain.model
        data = model.createData()
        for q, poses in zip(trace.q, run["poses"], strict=True):
            pin.forwardKinematics(model, data, q)
            for joint, pose in zip(names, np.reshape(poses, (-1, 7)), strict=True):
                X = data.oMi[model.getJointId(joint)]
                found: Any = pin.XYZQUATToSE3(pose)
                np.testing.assert_allclose(found.translation, X.translation, atol=6e-5)
                np.testing.assert_allclose(found.rotation, X.rotation, atol=4e-4)


@needs_robots
def test_the_whole_of_baxter_is_drawn() -> None:
    """Pedestal and head besides the arms."""
    robot = load("baxter_tray").chain.robot
    bodies, faults = robot_bodies(robot)
    assert not faults
    still = next(body for body in bodies if body.joint == 0).surface.vertices
    assert still[:, 2].min() == pytest.approx(-0.92, abs=0.02)  # the floor
    assert still[:, 2].max() > 0.7  # the head
    assert {body.arm for body in bodies} == {None, 0, 1}


def test_goals_and_planes_are_shown_while_their_phase_lasts() -> None:
    """And a plane's time begins with its phase."""
    scenario = load("point_on_point")
    (reach,) = scenario.tasks
    plane = replace(load("tilting_plane").tasks[0], velocity=(0.0, 0.0, 0.1), turn=None)
    lift = Phase(name="lift", tasks=(plane,), duration=0.3)
    scenario = replace(
        scenario, tasks=(), phases=(Phase(name="reach", tasks=(reach,), duration=0.2), lift)
    )
    found = scene(coopqp.compare(scenario, controllers=["qp"]))
    t = np.array(found["t"])
    (goal,), (surface,) = found["goals"], found["planes"]
    assert (t[goal["first"]], t[goal["last"]]) == (0.0, 0.19)
    assert (t[surface["first"]], t[surface["last"]]) == (0.2, 0.5)
    corners = np.array(surface["corners"])
    normal = np.array(plane.normal) / np.linalg.norm(plane.normal)
    height = (corners - corners[0]) @ normal
    moved = 0.1 * normal[2] * (t[surface["first"] :] - 0.2)
    np.testing.assert_allclose(height, np.tile(moved, (4, 1)).T, atol=2e-4)
    ways = found["controllers"][0]["tracked"]
    assert [(way["first"], len(way["points"])) for way in ways] == [(0, 20), (20, 31)]


@dataclass(frozen=True)
class Warned(Robot):
    """NAO, as if a part of its description had been left out."""

    def build(self) -> RobotModel:
        return replace(NaoT14().build(), warnings=("a part <b>was</b> left out",))


def test_the_page_says_what_was_left_out() -> None:
    comparison = coopqp.compare(cut(replace(load("point_on_point"), robot=Warned()), 5))
    assert scene(comparison)["notes"] == ["a part <b>was</b> left out"]
    page = render(comparison)
    assert 'id="notes"' in page
    assert "<b>was" not in page
