"""Limits of bodies that watch nothing or too much, stand twice in a file, or are broken at once."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import typed
from scenario_files import HEAD, TAIL, write

import coopqp
from coopqp.base.errors import InvalidValueError, ScenarioError
from coopqp.base.qp import names_of
from coopqp.execution.comparison import summarize
from coopqp.limits import (
    JointPosition,
    JointVelocity,
    Obstacle,
    Obstacles,
    SelfCollision,
    _keep_apart,
)
from coopqp.limits._keep_apart import distances_along
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.report.cells import cells
from coopqp.scenario.loader import load
from coopqp.scenario.notes import notes
from coopqp.scenario.scenario import Scenario
from coopqp.tasks import PointOnPoint

REACH = """\
duration: 0.3
tasks:
  - point_on_point: {name: reach, goal: [0.17, 0.01, 0.06], profile: {duration: 0.2}}
"""
BALL = "{ball: {sphere: 0.05, position: [0.3, 0, 0.3]}}"


def with_limits(folder: Path, limits: str) -> Path:
    return write(folder, f"{HEAD}{REACH}{TAIL}limits:\n{limits}")


def test_two_limits_of_one_kind_are_told_apart_by_their_names(tmp_path: Path) -> None:
    twice = f"  - obstacles: {{shapes: {BALL}}}\n  - obstacles: {{MORE}}\n"
    far = f"distance: 0.03, shapes: {BALL.replace('ball', 'far')}"
    with pytest.raises(ScenarioError, match=r"a row 'limit.obstacles.*add 'name:' to tell them"):
        load(with_limits(tmp_path, twice.replace("MORE", far)))
    scenario = load(with_limits(tmp_path, twice.replace("MORE", f"name: soft, {far}")))
    rows = [row for limit in scenario.limits for row in limit.rows(scenario.chain)]
    assert len(set(names_of(rows))) == len(rows)
    assert "limit.soft[object|far]" in names_of(rows)
    arms = "  - self_collision: {pairs: [[RForearm, torso]]}\n"
    hands = "  - self_collision: {name: hands, distance: 0.04, pairs: [[RHand, torso]]}\n"
    both = load(with_limits(tmp_path, arms + hands))
    trace = coopqp.run(both, controller="qp")
    kept = {row.name: row.kept for row in trace.margins if row.bodies}
    assert kept["limit.self_collision[RForearm|torso]"] == 0.01
    assert kept["limit.hands[RHand|torso]"] == 0.04


def test_what_has_no_name_is_not_told_to_get_one(tmp_path: Path) -> None:
    speed = "  - object_speed: {linear: 0.2}\n"
    with pytest.raises(ScenarioError, match="leave one of them out"):
        load(with_limits(tmp_path, 2 * speed))


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        (f"obstacles: {{bodies: [], shapes: {BALL}}}", "obstacles.bodies: no body that moves"),
        (f"obstacles: {{bodies: [torso], shapes: {BALL}}}", "no body that moves"),
        ('self_collision: {ignore: [["*", "*"]]}', "self_collision.ignore: leaves no pair"),
        (
            "obstacles: {shapes: {b: {box: [1, 1, 1], position: [9, 0, 0], scale: [2, 1, 1]}}}",
            "scale: is of a mesh; give the box the size it shall have",
        ),
        (f"obstacles: {{name: '', shapes: {BALL}}}", "needs at least 1 character"),
    ],
)
def test_a_limit_that_watches_nothing_is_refused(tmp_path: Path, limit: str, words: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        load(with_limits(tmp_path, f"  - {limit}\n"))
    assert words in str(caught.value)


def test_more_pairs_than_can_be_watched_are_refused(
    held_box: ClosedChain, monkeypatch: pytest.MonkeyPatch
) -> None:
    things = {f"t{i}": Obstacle(sphere=0.01, position=(1.0, 0.0, 0.1 * i)) for i in range(400)}
    with pytest.raises(InvalidValueError, match=r"obstacles: watches 2800 pairs, at most 2500"):
        Obstacles(shapes=things).rows(held_box)
    monkeypatch.setattr(_keep_apart, "MAX_PAIRS", 5)
    with pytest.raises(InvalidValueError, match=r"self_collision: watches 15 pairs, at most 5"):
        SelfCollision().rows(held_box)


def beside_the_object(chain: ClosedChain, gap: float) -> Obstacle:
    """A ball so far from the object's top [m]."""
    up = np.array([0.0, 0.0, chain.held.size[2] / 2 + 0.05 + gap])
    x, y, z = (State(chain).p_WO + up).tolist()
    return Obstacle(sphere=0.05, position=(x, y, z))


@pytest.mark.parametrize(
    ("gap", "words"),
    [
        (0.0089, r"object starts 1\.1 mm nearer to ball than distance \(8\.9 of 10 mm\)"),
        (-0.0005, r"object starts 0\.5 mm in ball"),
        (0.0101, ""),
    ],
)
def test_a_start_nearer_than_asked_is_a_note(held_box: ClosedChain, gap: float, words: str) -> None:
    limit = Obstacles(shapes={"ball": beside_the_object(held_box, gap)}, bodies=("object",))
    said = " ".join(limit.notes(held_box))
    assert bool(said) == bool(words)
    assert re.search(words, said)
    assert not limit.start_faults(held_box)


# Verdicts.


def pulled_into_a_ball(gap: float, **keys: float) -> Scenario:
    """NAO's box goes to the middle of a ball over it; only the QP supports the limit."""
    like = coopqp.load("point_on_point")
    ball = beside_the_object(like.chain, gap)
    limits = (JointPosition(), JointVelocity(), Obstacles(shapes={"ball": ball}, **keys))  # type: ignore[arg-type]
    reach = PointOnPoint(name="reach", goal=ball.position, gain=5.0)
    return replace(like, tasks=(reach,), secondary=(), limits=limits, duration=1.0, source="")


def test_bodies_that_came_too_near_are_told_by_their_distance_left() -> None:
    scenario = pulled_into_a_ball(0.03, distance=0.02)
    found = coopqp.compare(scenario, controllers=["pseudoinverse"])
    trace, said = found.traces["pseudoinverse"], found.verdicts["pseudoinverse"]
    obstacles = scenario.limits[-1]
    assert isinstance(obstacles, Obstacles)
    pairs = obstacles.watched(scenario.chain)
    least = distances_along(scenario.chain, pairs, trace.q).min()
    far, deep = re.findall(
        r"brings object (\d+) mm closer to ball than allowed, (\d+) mm inside", said
    )[0]
    assert float(far) == pytest.approx(1e3 * (0.02 - least), abs=0.5)
    assert float(deep) == pytest.approx(-1e3 * least, abs=0.5)
    row = cells(trace, found.metrics["pseudoinverse"])["limit"]
    assert row.bad
    assert row.lines[0].startswith("obstacles: ")  # no '✗ 0' of the joints before it


def test_a_run_that_starts_far_away_is_not_said_to_start_too_near() -> None:
    """Margins begin after the first tick; in one of 0.1 s the arms came from 40 mm to the ball."""
    scenario = replace(pulled_into_a_ball(0.04), dt=0.1, kappa=5.0)
    (reach,) = scenario.tasks
    scenario = replace(scenario, tasks=(replace(reach, profile=Profile(kind="step")),))
    trace = coopqp.run(scenario, controller="pseudoinverse")
    row = next(row for row in trace.margins if row.bodies == ("object", "ball"))
    assert trace.margins[row][0] < 0.0 < 0.03 < trace.starts[row] + 1e-6
    said = summarize(scenario, {"pseudoinverse": trace}).verdicts["pseudoinverse"]
    assert "brings object" in said
    assert "starts" not in said


def test_a_run_that_starts_too_near_and_parts_is_told_so() -> None:
    near = pulled_into_a_ball(0.004, distance=0.02)
    start = near.chain.start_position
    down = PointOnPoint(name="down", goal=(start[0], start[1], start[2] - 0.03))
    found = coopqp.compare(replace(near, tasks=(down,)), controllers=["qp"])
    said = found.verdicts["qp"]
    near = "object 16 mm closer to ball than allowed (4 of 20 mm left)"
    assert f"starts with {near} and separates" in said
    assert cells(found.traces["qp"], found.metrics["qp"])["limit"].bad is None


def test_phases_keep_the_first_start_of_every_limit(tmp_path: Path) -> None:
    """A limit's start is that of the first phase that has it."""
    text = f"{HEAD}{REACH}{TAIL}limits:\n  - obstacles: {{shapes: {BALL}}}\n"
    trace = coopqp.run(load(write(tmp_path, text)), controller="qp")
    assert trace.starts.keys() == trace.margins.keys()
    joined = coopqp.trace.join(
        [(coopqp.trace.PhaseInfo("a", 0, ()), trace), (coopqp.trace.PhaseInfo("b", 30, ()), trace)]
    )
    assert joined.starts == trace.starts


def test_a_tick_too_long_for_the_distance_is_a_note(tmp_path: Path) -> None:
    shapes = "  - joint_velocity\n  - obstacles: {shapes: " + BALL + "}\n"
    scenario = load(with_limits(tmp_path, shapes))
    assert not any("in a tick" in line for line in notes(scenario))
    coarse = replace(scenario, dt=0.1, kappa=5.0)
    (line,) = (line for line in notes(coarse) if "in a tick" in line)
    angle = 0.1 * float(scenario.chain.velocity.max())
    off = 1e3 * 0.5 * scenario.chain.reach * angle**2
    assert f"turn by up to {angle:.2g} rad, which can bring bodies about {off:.2g} mm" in line


def test_validate_prints_what_starts_too_near(tmp_path: Path) -> None:
    chain = load(write(tmp_path, f"{HEAD}{REACH}{TAIL}")).chain
    ball = beside_the_object(chain, 0.005)
    shape = f"{{ball: {{sphere: 0.05, position: {list(ball.position)}}}}}"
    file = with_limits(tmp_path, f"  - obstacles: {{bodies: [object], shapes: {shape}}}\n")
    result = typed("validate", file)
    assert result.exit_code == 0
    assert "note: obstacles: object starts 5.0 mm nearer to ball than distance" in result.stderr
