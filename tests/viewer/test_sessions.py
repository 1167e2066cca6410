"""What is done on the page, without a page: goals dragged, dials turned, sessions replayed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario_files import HEAD, PHASES

from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.execution.controller_run import run
from coopqp.model.state import State
from coopqp.scenario.loader import load
from coopqp.viewer.messages import Action, Explanation
from coopqp.viewer.page import _head, _verdict
from coopqp.viewer.play import _Clock
from coopqp.viewer.player import Player

PLANE = """\
dt: 0.01
duration: 0.4
controllers: [qp]
tasks:
  - point_on_plane:
      normal: [0, 0, 1]
      through: [0.15, 0, 0.05]
      gain: 5
      profile: {duration: 0.2}
"""
FED = """\
dt: 0.01
duration: 0.6
controllers: [qp]
inputs:
  hand: {feed: {line: {start: [0.186, 0, 0.047], end: [0.18, 0.01, 0.05], period: 0.5}}}
tasks:
  - point_on_point: {goal: {input: hand}, gain: 5, profile: {kind: step}}
"""


def playing(name: str | Path, *laws: str, folder: Path | None = None) -> Player:
    return Player(load(name), laws, folder)


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.yaml"
    path.write_text(HEAD + text, encoding="utf-8")
    return path


def played(player: Player, ticks: int) -> list[list[Array]]:
    """So many ticks; the joints of each law from which each of them was decided."""
    found = []
    for _ in range(ticks):
        player.tick()
        found.append([lane.state.q.copy() for lane in player.controllers])
    return found


def pulled(player: Player, *by: float) -> None:
    """Every gizmo that is there is moved by so much, and turned a little where it can be."""
    for i, pose in enumerate(player.frame().gizmos):
        if pose is not None:
            turn = np.array([0.02, 0.0, 0.0, 1.0]) if player.show().gizmos[i].turns else pose[3:]
            player.do(Action("drag", i, (*(pose[:3] + by).tolist(), *turn.tolist())))


def session(player: Player) -> list[list[Array]]:
    """Some seconds of dragging, jumps among them."""
    joints = [[lane.state.q.copy() for lane in player.controllers]]
    for _ in range(8):
        pulled(player, 0.004, -0.003, 0.002)
        joints += played(player, 7)
    pulled(player, -0.05, 0.02, 0.0)
    return joints + played(player, 140)


@pytest.mark.parametrize("kind", ["point", "plane", "phases"])
def test_a_session_is_replayed_by_compare_bit_for_bit(tmp_path: Path, kind: str) -> None:
    texts = {"plane": PLANE, "phases": f"dt: 0.01\ncontrollers: [qp]\n{PHASES}"}
    name = written(tmp_path, texts[kind]) if kind in texts else "point_on_point"
    laws = ("qp", "pseudoinverse") if kind == "point" else ("qp",)
    player = playing(name, *laws, folder=tmp_path / "out")
    joints = session(player)
    path = player.save()
    assert path, player.note
    again = load(path)
    for i, law in enumerate(laws):
        trace = run(again, controller=law)
        own = np.array([row[i] for row in joints])
        np.testing.assert_array_equal(trace.q[: len(own)], own)
        assert trace.ticks >= len(own) > 190
    lines = next((tmp_path / "out" / "inputs").glob("*.csv")).read_text().splitlines()
    assert lines[0].startswith("t,sent,x,y,z")


def test_until_somebody_drags_the_motion_is_that_of_the_scenario() -> None:
    player = playing("point_on_point", "qp")
    joints = np.array(played(player, 250))[:, 0]
    trace = run(load("point_on_point"), controller="qp")
    np.testing.assert_allclose(joints, trace.q[1:251], rtol=0.0, atol=1e-12)


def test_the_object_follows_what_is_dragged_within_the_pace() -> None:
    player = playing("point_on_point", "qp")
    played(player, 250)
    pulled(player, 0.02, -0.02, 0.0)
    before = player.controllers[0].state.p_WO.copy()
    places = []
    for _ in range(250):
        player.tick()
        places.append(player.controllers[0].state.p_WO.copy())
    np.testing.assert_allclose(places[-1] - before, (0.02, -0.02, 0.0), atol=1e-5)
    assert player.frame().tone == "reached"
    # The limiter's default pace, which is shared by three axes; the arms lag behind by little.
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() / 0.01 < 0.25


def test_pulling_the_object_moves_the_goal_of_the_first_task(tmp_path: Path) -> None:
    player = playing(written(tmp_path, PLANE), "qp")
    goal = player.controllers[0].state.p_WO - np.array([0.0, 0.0, 0.02])
    player.do(Action("carry", 0, tuple(goal.tolist())))
    played(player, 200)
    assert player.controllers[0].state.p_WO[2] == pytest.approx(goal[2], abs=1e-5)


def test_who_feeds_is_heard_until_somebody_drags(tmp_path: Path) -> None:
    player = playing(written(tmp_path, FED), "qp", folder=tmp_path / "out")
    fed = played(player, 40)
    own = run(load(tmp_path / "mine.yaml"), controller="qp")
    np.testing.assert_array_equal(np.array(fed)[:, 0], own.q[1:41])
    pulled(player, 0.0, 0.0, 0.01)
    goal = player.frame().gizmos[0]
    assert goal is not None
    later = played(player, 150)
    np.testing.assert_allclose(player.controllers[0].state.p_WO, goal[:3], atol=1e-4)
    path = player.save()
    assert path
    trace = run(load(path), controller="qp")
    np.testing.assert_array_equal(trace.q[1:191], np.array([*fed, *later])[:, 0])


JOYSTICK = """\
dt: 0.01
duration: 0.6
controllers: [qp]
inputs: {stick: {velocity: 0.05}}
tasks:
  - twist: {velocity: {input: stick}, components: [x, y, z]}
"""


def test_an_input_without_a_place_has_a_slider_for_each_number(tmp_path: Path) -> None:
    player = playing(written(tmp_path, JOYSTICK), "qp")
    player.playing = True
    played(player, 30)
    assert [knob.label for knob in player.show().knobs] == ["x", "y", "z"]
    assert player.show().gizmos == ()
    frame = player.frame()
    assert frame.tone == "waiting"
    assert "Nothing arrives at stick; move its sliders" in frame.sentence
    assert "move the sliders below Inputs" in _head(player.show())
    before = player.controllers[0].state.p_WO.copy()
    player.do(Action("knob", ("stick", 2), (-0.02,)))
    played(player, 100)
    moved = player.controllers[0].state.p_WO - before
    assert moved[2] == pytest.approx(-0.02, abs=0.004)
    assert np.abs(moved[:2]).max() < 1e-4


def test_a_dial_rebuilds_the_law_from_where_it_is(tmp_path: Path) -> None:
    player = playing("point_on_point", "qp", folder=tmp_path)
    played(player, 60)
    before, v = player.controllers[0].state.q.copy(), player.controllers[0].state.v.copy()
    player.do(Action("dial", ("tasks", 0, 0, "gain"), (2.0,)))
    player.tick()
    assert player.controllers[0].run.problem.tasks[0].gain == 2.0
    step = player.controllers[0].state.q - before
    assert 0.0 < np.abs(step).max() < 0.02
    assert np.abs(step / 0.01 - v).max() < 0.2  # [rad/s], no jump
    assert "dial" in player.frame().note
    ended = player.recording.seconds
    played(player, 10)
    assert player.recording.seconds == ended
    player.do(Action("reset"))
    joints = played(player, 220)
    path = player.save()
    assert path
    again = load(path)
    assert again.tasks[0].gain == 2.0
    trace = run(again, controller="qp")
    np.testing.assert_array_equal(trace.q[1:221], np.array(joints)[:, 0])


def test_what_makes_no_sense_is_left_alone() -> None:
    player = playing("point_on_point", "qp")
    before = player.frame()
    for asked in (
        Action("drag", 0, (np.nan,) * 7),
        Action("drag", 7, (0.0,) * 6 + (1.0,)),
        Action("drag", 0, (0.1, 0.2)),
        Action("drag", 0, (0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 0.0)),
        Action("carry", 0, (np.inf, 0.0, 0.0)),
        Action("carry", 0, (1.0,)),
        Action("dial", ("tasks", 9, 9, "gain"), (1.0,)),
        Action("dial", ("tasks", 0, 0, "gain"), (-5.0, 1.0)),
        Action("knob", ("nothing", 7), (1.0,)),
        Action("speed", 0, ()),
        Action("save"),
        Action("dance"),
    ):
        player.do(asked)
    after = player.frame()
    np.testing.assert_array_equal(before.gizmos[0], after.gizmos[0])
    assert player.controllers[0].run.problem.tasks[0].gain == 0.1  # as low as its dial goes
    assert player.speed == 1.0


def test_a_session_that_has_written_nothing_says_why(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    player = playing("point_on_point", "qp", folder=tmp_path / "file")
    played(player, 3)
    assert player.save() is None
    assert "cannot write the recording" in player.note


def test_every_dial_of_an_impedance_can_be_turned() -> None:
    player = playing("impedance")
    for dial in player.show().dials:
        player.do(Action("dial", dial.key, (0.5 * (dial.low + dial.high),)))
        player.tick()
    assert not player.note


@pytest.mark.parametrize("name", ["point_on_point", "rigid_vs_passive"])
def test_links_are_drawn_where_the_joints_are(name: str) -> None:
    player = playing(name)
    played(player, 30)
    frame, show = player.frame(), player.show()
    for controller, drawn in zip(player.controllers, frame.laws, strict=True):
        chain = controller.run.problem.chain
        state = State(chain, controller.state.q)
        model, names = chain.model, chain.robot.model.names
        for body, pose in zip(show.bodies, drawn.bodies, strict=True):
            X = state.joint_pose(model.getJointId(names[body.joint]))
            np.testing.assert_allclose(pose[:3], X.translation, atol=1e-12)
        np.testing.assert_allclose(drawn.held[:3], state.p_WO, atol=1e-12)
        own = [chain.joint_names.index(name) for name in chain.robot.joint_names]
        q, lower, upper = (values[own] for values in (state.q, chain.lower, chain.upper))
        left = 2.0 * np.minimum(q - lower, upper - q) / (upper - lower)
        np.testing.assert_allclose(drawn.left, left, atol=1e-12)


def test_a_law_that_breaks_a_limit_is_said_to() -> None:
    player = playing("point_on_point", "qp", "pseudoinverse")
    played(player, 300)
    own, other = player.frame().laws
    assert own.broken == ""
    assert "LElbowRoll is 0.163 rad past its limit" in other.broken


def test_where_nothing_was_played_nothing_is_written(tmp_path: Path) -> None:
    player = playing("point_on_point", "qp", folder=tmp_path / "out")
    assert player.save() is None
    assert "nothing has been played yet" in player.note
    assert not (tmp_path / "out").exists()
    played(player, 20)
    path = player.save()
    assert path
    before = path.read_text()
    player.do(Action("reset"))
    assert player.save() is None
    assert path.read_text() == before, "what was saved is not lost for a reset"


class Gone:
    """A process beside that has been killed."""

    ready, killed_by = False, "SIGKILL"

    def received(self, timeout: float = 0.0) -> Iterator[Any]:
        raise EOFError


def test_without_the_explainer_nothing_is_said_in_its_place() -> None:
    player = playing("point_on_point", "qp")
    player.playing = True
    played(player, 50)
    player.explanation = Explanation(
        True, "LElbowRoll (lower) stops it", ("LElbowRoll (lower)",), ""
    )
    gone: Any = Gone()
    clock = _Clock(player, gone, gone)
    clock._explain(0.0)
    for _ in range(2):
        frame = player.frame()
        assert frame.tone == "waiting"
        assert "explanations have ended" in frame.sentence
        assert not frame.explanation.active
        assert "Limits at their bound: unknown" in _verdict(frame)
        player.do(Action("reset"))
    with pytest.raises(CoopqpError, match="ended from outside by SIGKILL"):
        clock._receive()


def test_a_crawling_object_is_dragged_at_the_limiters_slowest(tmp_path: Path) -> None:
    limits = "limits: [{object_speed: {linear: 0.0001, angular: 0.0001}}]\n"
    player = playing(written(tmp_path, PLANE + limits), "qp", folder=tmp_path / "out")
    played(player, 5)
    path = player.save()
    assert path
    made = next(iter(load(path).inputs.values()))
    assert (made.velocity, made.angular_velocity) == (0.001, 0.004)


LEADER = """\
dt: 0.01
duration: 2.0
controllers: [qp]
inputs: {leader: {LOWER}}
tasks:
  - posture: {goal: {input: leader}}
"""


def test_sliders_of_joints_go_as_far_as_joints_do(tmp_path: Path) -> None:
    player = playing(written(tmp_path, LEADER.replace("{LOWER}", "{}")), "qp")
    chain = player.controllers[0].run.problem.chain
    seen = {knob.label: (knob.low, knob.high) for knob in player.show().knobs}
    limits = zip(chain.lower.tolist(), chain.upper.tolist(), strict=True)
    assert seen == dict(zip(chain.joint_names, limits, strict=True))
    lower = [float(x) for x in chain.q_start - 0.1]
    bounded = playing(written(tmp_path, LEADER.replace("{LOWER}", f"{{lower: {lower}}}")), "qp")
    assert [k.low for k in bounded.show().knobs] == np.maximum(lower, chain.lower).tolist()
