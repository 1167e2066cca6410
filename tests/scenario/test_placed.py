"""A scenario with the object and the arms elsewhere, without another file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scenario_files import needs_robots, phased

import coopqp
from coopqp.base.errors import CoopqpError, GraspError, InvalidValueError, ScenarioError
from coopqp.base.spec import Pose
from coopqp.grasp import pose_matrix
from coopqp.report.planning import write_plan
from coopqp.scenario.loader import load_text
from coopqp.scenario.scenario import Scenario
from coopqp.scenario.yaml import parsed

ELSEWHERE = Pose(position=(0.62, 0.05, 0.47), rpy_deg=(0.0, 0.0, 5.0))


@pytest.fixture(scope="module")
def nao() -> Scenario:
    return coopqp.load("point_on_point")


def _like_a_file(scenario: Scenario, **keys: Any) -> Scenario:
    path = Path("other.yaml")
    data = {**parsed(path, scenario.source).data, **keys}
    return load_text(path, json.dumps(data), scenario.catalog)


def test_other_joints_give_the_chain_that_a_file_with_them_gives(nao: Scenario) -> None:
    start = {"right": [0.6, -0.2, 1.2, 0.9, 0.1], "left": [0.6, 0.2, -1.2, -0.9, -0.1]}
    placed, read = nao.placed(start=start), _like_a_file(nao, start=start)
    assert placed.robot_model is nao.robot_model
    assert (placed.chain.q_start == read.chain.q_start).all()
    for arm, X in read.chain.hold.X_EO.items():
        assert placed.chain.hold.X_EO[arm] == X
    assert not placed.source  # no file says this


def test_an_object_elsewhere_is_held_there_by_both_ways_to_say_so(nao: Scenario) -> None:
    X = pose_matrix(ELSEWHERE)
    for where in (pin.SE3ToXYZQUAT(X), ELSEWHERE):
        chain = nao.placed(object_pose=where).chain
        assert chain.object_pose(chain.q_start).isApprox(X, 1e-12)
        assert chain.start_position == pytest.approx(ELSEWHERE.position)


def test_what_a_file_would_be_refused_for_is_refused(nao: Scenario) -> None:
    with pytest.raises(ScenarioError, match=r"^start\.left\[1\]: LShoulderRoll starts at 1\.6 rad"):
        nao.placed(start={**nao.start, "left": [0.7, 1.6, -1.2, -0.9, -0.1]})
    with pytest.raises(ScenarioError, match=r"did you mean start_deg\?"):
        nao.placed(start={name: np.degrees(x).tolist() for name, x in nao.start.items()})
    with pytest.raises(CoopqpError, match="unknown arm or joint 'lef'; did you mean 'left'"):
        nao.placed(start={"lef": [0.0] * 5})
    with pytest.raises(InvalidValueError, match=r"left: found \[True, .*\], needs numbers"):
        nao.placed(start={**nao.start, "left": [True] * 5})
    with pytest.raises(InvalidValueError, match="start: found 'solved', needs joints or solve"):
        nao.placed(start="solved")  # type: ignore[arg-type]
    with pytest.raises(InvalidValueError, match="start: found a ndarray, needs joints or solve"):
        nao.placed(start=nao.chain.q_start)
    with pytest.raises(GraspError, match=r"to solve for a start, give .*object_in_hand"):
        nao.placed(object_pose=ELSEWHERE, start="solve")
    with pytest.raises(InvalidValueError, match="a quaternion of length 2, needs one of length 1"):
        nao.placed(object_pose=[0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0])
    with pytest.raises(InvalidValueError, match="object_pose"):
        nao.placed(object_pose=[0.1, 0.0, 0.0])


def test_a_plan_is_refused_from_elsewhere(nao: Scenario, tmp_path: Path) -> None:
    write_plan(coopqp.plan(nao), nao, tmp_path)
    planned = coopqp.load(tmp_path / "point_on_point.yaml")
    planned.placed(start=planned.start)
    left, turned = np.array(planned.start["left"]), np.array([0.0, 0.0, 0.0, 0.0, 0.2])
    words = r"plan.csv: begins 0\.2 from the start of LWristYaw; plan the way anew from here"
    with pytest.raises(ScenarioError, match=words):
        planned.placed(start={**planned.start, "left": (left + turned).tolist()})


@needs_robots
def test_a_start_is_solved_where_the_object_is() -> None:
    scenario = coopqp.load("two_pandas")
    given = scenario.chain
    X = given.object_pose(given.q_start)
    X.translation += [0.03, 0.02, -0.04]
    placed = scenario.placed(object_pose=pin.SE3ToXYZQUAT(X), start="solve")
    assert placed.chain.object_pose(placed.chain.q_start).isApprox(X, 1e-7)
    assert np.abs(placed.chain.q_start - given.q_start).max() < 0.3


@needs_robots
def test_hands_that_do_not_reach_the_object_are_refused() -> None:
    with pytest.raises(GraspError, match="grasp does not close at the start"):
        coopqp.load("regrasp").placed(object_pose=ELSEWHERE)


def test_phases_begin_at_the_new_start(tmp_path: Path) -> None:
    scenario = phased(tmp_path)
    placed = scenario.placed(start={**scenario.start, "right": [0.71, -0.2, 1.2, 0.9, 0.1]})
    trace = coopqp.run(placed, controller="qp")
    assert trace.q[0] == pytest.approx(placed.chain.q_start)
    assert np.abs(trace.loop_position).max() < 1e-3


def test_no_numbers_and_places_that_no_arm_reaches_are_refused() -> None:
    stands = coopqp.load("pick_and_place")
    here = [0.6, 0.14, 0.2, 0.0, 0.0, 0.0, 1.0]
    far = [600.0, 140.0, *here[2:]]
    masked = np.ma.masked_array(here, mask=[1, 0, 0, 0, 0, 0, 0])
    bad: dict[str, Any] = {
        "are these millimetres": far,
        r"found \[False.*needs 7 numbers: x, y, z, qx": [False] * 6 + [True],
        r"found \['0.6'.*needs 7 numbers": [str(x) for x in here],
        "masked": masked,
        "has NaN or infinite values": [1e300] * 7,
    }
    for words, where in bad.items():
        with pytest.raises(InvalidValueError, match=f"object_pose: .*{words}"):
            stands.placed(object_pose=where)
    with pytest.raises(InvalidValueError, match="are these millimetres"):
        stands.placed(object_pose=Pose(position=(600.0, 140.0, 0.2)))
    numbered: Any = {1: 2.0}
    with pytest.raises(CoopqpError, match="unknown arm or joint"):
        stands.placed(start=numbered)
    loop = coopqp.OnlineLoop(stands, clock=None)
    for sent, words in ((1e9, "is from the future"), (np.nan, "when it was sent"), (-1.0, "s old")):
        loop.tick(stands.chain.q_start, inputs={"object_pose": (here, sent)})
        assert loop.status.name == "INPUT_REFUSED"
        assert words in loop.note
    loop.tick(stands.chain.q_start, inputs={"object_pose": (here, loop.now)})
    assert loop.status.name == "OPTIMAL"
