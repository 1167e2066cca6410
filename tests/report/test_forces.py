"""Arrows of forces in the playback and in play, and the squeeze as a number."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenario_files import cut

import coopqp
from coopqp.closed_loop.admittance import Admittance
from coopqp.controllers import QPController
from coopqp.execution.comparison import Comparison, compare
from coopqp.plant import Disturbance
from coopqp.plants import RigidBody
from coopqp.report.figures.groups import groups
from coopqp.report.scene.playback import LONGEST, scene
from coopqp.scenario.scenario import Scenario
from coopqp.tasks import InternalWrench
from coopqp.viewer import picture
from coopqp.viewer.messages import Action
from coopqp.viewer.player import Player

G = 9.81  # [m/s2]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """NAO lifts a box with firm hands; it is heavier than modelled."""
    given = cut(coopqp.load("point_on_point"), 30)
    return replace(
        given,
        plant=RigidBody(),
        controllers={"qp": given.controllers["qp"]},
        disturbance=Disturbance(object_mass=1.5),
    )


@pytest.fixture(scope="module")
def compared(scenario: Scenario) -> Comparison:
    return compare(scenario)


def test_arrows_add_up_to_what_moves_the_object(compared: Comparison) -> None:
    """At the same scale hands and weight sum to mass times acceleration, small at the end."""
    trace = compared.traces["qp"]
    (drawn,) = scene(compared)["controllers"]
    hands = np.array(drawn["forces"]["hands"][-1])
    falls = np.array(drawn["forces"]["weight"][-1])
    told = trace.signals["hand_wrench"][-1].reshape(-1, 6)[:, :3]
    weight = 1.5 * G * compared.scenario.held.mass
    scale = -falls[5] / weight
    assert falls[:3] == pytest.approx(trace.position[-1], abs=1e-4)
    assert hands[:, 3:] == pytest.approx(scale * told, abs=2e-4)
    points = trace.signals["hand_point"][-1].reshape(-1, 3)
    assert hands[:, :3] + hands[:, 3:] == pytest.approx(points, abs=2e-4)  # they end there
    ways = np.array([np.array(k)[:, 3:] for k in drawn["forces"]["hands"]])
    longest = LONGEST * max(compared.scenario.held.size)
    assert max(np.linalg.norm(ways, axis=2).max(), -falls[5]) == pytest.approx(longest, rel=0.01)
    assert not ways[0].any()  # nobody knows before the first tick


def test_the_squeeze_stands_below_the_picture_and_as_a_figure(compared: Comparison) -> None:
    trace = compared.traces["qp"]
    p, h = trace.signals["hand_point"][-1], trace.signals["hand_wrench"][-1]
    way = p[3:] - p[:3]
    squeeze = 0.5 * (h[:3] - h[6:9]) @ way / np.linalg.norm(way)
    (drawn,) = scene(compared)["controllers"]
    assert drawn["readout"][-1][-1] == f"squeeze {squeeze:.3g} N"
    titles = [figure.title for group in groups(compared) for figure in group.figures]
    assert titles.count("Squeeze between the hands") == 1


def test_without_forces_nothing_is_drawn(scenario: Scenario) -> None:
    bare = compare(replace(scenario, plant=coopqp.load("point_on_point").plant,
                           disturbance=Disturbance()))  # fmt: skip
    (drawn,) = scene(bare)["controllers"]
    assert drawn["forces"] is None
    assert not any("squeeze" in line for lines in drawn["readout"] for line in lines)


def test_play_draws_them_beside_hands_and_object(scenario: Scenario) -> None:
    player = Player(scenario)
    for _ in range(3):
        player.tick()
    (drawn,) = player.frame().laws
    told = player.controllers[0].plant.signals["hand_wrench"].reshape(-1, 6)[:, :3]
    ways = drawn.arrows[:, 1] - drawn.arrows[:, 0]
    longest = max(np.linalg.norm(told, axis=1).max(), 1.5 * G * scenario.held.mass)
    scale = picture.ARROW * max(scenario.held.size) / longest
    assert ways == pytest.approx(scale * told)
    ((start, end),) = drawn.weight
    assert end - start == pytest.approx([0.0, 0.0, -scale * 1.5 * G * scenario.held.mass])
    assert start[2] < drawn.held[2] - 0.5 * scenario.held.size[2]
    assert "squeeze" in drawn.errors


def test_a_squeeze_is_a_slider_and_not_dragged(scenario: Scenario) -> None:
    press = InternalWrench(squeeze=4.0)
    law = QPController(admittance=Admittance(stiffness=4e3))
    tasks, laws = (*scenario.tasks, press), {"qp": law}
    player = Player(replace(scenario, tasks=tasks, controllers=laws))
    assert len(player.show().gizmos) == len(scenario.tasks)
    (dial,) = (dial for dial in player.show().dials if dial.label == "squeeze [N]")
    player.do(Action("dial", dial.key, (7.0,)))
    for _ in range(150):
        player.tick()
    (drawn,) = player.frame().laws
    newtons = float(drawn.errors.rpartition("squeeze ")[2].removesuffix(" N"))
    assert newtons == pytest.approx(7.0, rel=0.03)
