"""Why whole runs missed their goals: the cases of strangers, and one of every kind.

What is true is known by construction, by a run of the law with something changed by hand, or by
scipy's searches over pinocchio's own kinematics.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from command_line import typed
from laws import LIMITS, STEP
from scenario_files import HEAD, PHASES, TAIL, needs_robots, phased
from scipy.optimize import least_squares, minimize

from coopqp.checked import Array
from coopqp.checked import Pose as PoseValue
from coopqp.closed_chain import ClosedChain
from coopqp.controller_run import run
from coopqp.limits import (
    JointAcceleration,
    JointPosition,
    JointVelocity,
    SelfCollision,
    Workspace,
)
from coopqp.robot import Robot, RobotModel
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.study.explanation import RunExplanation, explain_run, recording_of
from coopqp.task import Task
from coopqp.tasks import Orientation, PointOnPlane, PointOnPoint, Pose, Twist

ADVICE = Path(__file__).parent / "advice"
LOW = PointOnPlane(name="low", normal=(0, 0, 1), through=(0, 0, 0.03))
HIGH = PointOnPlane(name="high", normal=(0, 0, 1), through=(0, 0, 0.06))
REACH = PointOnPoint(name="reach", goal=(0.18, 0.01, 0.05))


def explained(scenario: Scenario, controller: str = "qp") -> RunExplanation:
    return explain_run(scenario, recording_of(run(scenario, controller=controller)))


def advice(name: str) -> Scenario:
    return load(ADVICE / f"{name}.yaml")


@cache
def of_case(name: str) -> RunExplanation:
    return explained(advice(name))


def nao(*tasks: Task, **settings: Any) -> Scenario:
    """NAO with a firm grasp, nothing but the tasks given."""
    given = {"duration": 2.0, **settings}
    return replace(load("point_on_point"), tasks=tasks, secondary=(), source="", **given)


def gap(chain: ClosedChain, q: Array) -> Array:
    """Loop error from pinocchio's frames."""
    data = chain.model.createData()
    pin.framesForwardKinematics(chain.model, data, q)
    X_0, X_1 = (data.oMf[frame] for frame in chain.frames)
    return np.concatenate(
        [X_1.translation - X_0.translation, pin.log3(X_1.rotation @ X_0.rotation.T)]
    )


def nearest(chain: ClosedChain, goal: tuple[float, float, float], starts: int = 2) -> Array:
    """From the nearest point that closed loops allow to a goal, limits left out; by scipy."""
    rng, best = np.random.default_rng(0), np.full(3, np.inf)

    def residual(q: Array) -> Array:
        return np.concatenate([goal - chain.object_pose(q).translation, 100.0 * gap(chain, q)])

    def slope(q: Array) -> Array:
        J = chain.object_jacobians(q)
        return np.vstack([-np.mean(J, axis=0)[:3], 100.0 * (J[1] - J[0])])

    for i in range(starts):
        q = chain.q_start + (rng.normal(scale=0.3, size=chain.n) if i else 0.0)
        way = least_squares(residual, q, slope, max_nfev=500).fun[:3]
        best = min(best, way, key=lambda w: float(np.linalg.norm(w)))
    return best


# Limits, and what would do


@dataclass(frozen=True)
class Wider(Robot):
    """A robot with other position limits."""

    model: RobotModel

    def build(self) -> RobotModel:
        return self.model


def given_more(scenario: Scenario, found: RunExplanation, share: float = 1.0) -> float:
    """The run's last error when the joints get a share of what is said, over its tolerance."""
    robot = scenario.robot_model
    model = robot.model.copy()
    for need in found.needed:
        joint, side = need.limit.removeprefix("limit.position[").split("].")
        i = model.idx_qs[model.getJointId(joint)]
        ends = model.upperPositionLimit if side == "upper" else model.lowerPositionLimit
        ends[i] += share * need.amount * (1 if side == "upper" else -1)
    other = replace(scenario, robot=Wider(replace(robot, model=model)))
    return float(run(other, controller="qp").final_error[0] / scenario.tasks[0].tolerance)


@pytest.fixture(scope="module")
def stress() -> tuple[Scenario, RunExplanation]:
    scenario = load("joint_limit_stress")
    return scenario, explained(scenario)


def test_limits_with_exactly_what_is_said_let_the_law_reach_its_goal(
    stress: tuple[Scenario, RunExplanation],
) -> None:
    """And eight tenths of it do not, so that the amount is that of the whole way."""
    scenario, found = stress
    assert (found.kind, found.tried) == ("limits", True)
    assert given_more(scenario, found) <= 1.0
    assert given_more(scenario, found, share=0.8) > 1.0
    assert "(tried: reached)" in found.sentence


def test_the_limits_that_hold_back_are_at_their_bounds_and_come_first(
    stress: tuple[Scenario, RunExplanation],
) -> None:
    scenario, found = stress
    margins = {row.name: m[-1] for row, m in run(scenario, controller="qp").margins.items()}
    assert len(found.held_back) == 3
    for held in found.held_back:
        assert margins[held.limit] < 1e-5
    assert sum(held.share for held in found.held_back) == pytest.approx(1.0, abs=0.03)
    order = [found.sentence.index(held.words.split(" (")[0]) for held in found.held_back]
    assert order == sorted(order)


def test_no_search_of_another_kind_finds_a_smaller_total(
    stress: tuple[Scenario, RunExplanation],
) -> None:
    """SLSQP on the sum of overruns with the goal and the loops as equalities."""
    scenario, found = stress
    chain = scenario.chain
    goal = np.array(scenario.tasks[0].goal)  # type: ignore[attr-defined]
    n = chain.n

    def equal(x: Array) -> Array:
        p = chain.object_pose(x[:n]).translation - goal
        return np.concatenate([p, gap(chain, x[:n])])

    def inside(x: Array) -> Array:
        q, s = x[:n], x[n:]
        return np.concatenate([q - chain.lower + s, chain.upper - q + s, s])

    end = run(scenario, controller="qp").q[-1]
    answer = minimize(
        lambda x: x[n:].sum(),
        np.concatenate([end, np.full(n, 0.3)]),
        jac=lambda x: np.concatenate([np.zeros(n), np.ones(n)]),
        method="SLSQP",
        constraints=[{"type": "eq", "fun": equal}, {"type": "ineq", "fun": inside}],
        options={"maxiter": 300},
    )
    assert answer.success
    told = sum(need.amount for need in found.needed)
    assert answer.fun < told < 1.05 * answer.fun + 0.012  # 5 % and a little more, rounded up


@pytest.mark.parametrize("mode", ["hard", "scaled"])
def test_hard_and_scaled_tasks_are_held_back_by_the_same_limits(
    mode: str, stress: tuple[Scenario, RunExplanation]
) -> None:
    scenario, soft = stress
    tasks = (replace(scenario.tasks[0], mode=mode),)  # type: ignore[arg-type]
    found = explained(replace(scenario, tasks=tasks))
    assert (found.kind, found.tried) == ("limits", True)
    assert {h.limit for h in found.held_back} == {h.limit for h in soft.held_back}


def test_an_acceleration_limit_does_not_hide_the_position_limits(
    stress: tuple[Scenario, RunExplanation],
) -> None:
    scenario, soft = stress
    limits = (*scenario.limits, JointAcceleration(max=10.0))
    found = explained(replace(scenario, limits=limits))
    assert (found.kind, found.tried) == ("limits", True)
    assert {h.limit for h in found.held_back} == {h.limit for h in soft.held_back}


def test_a_wall_is_named_alone_in_millimetres_and_moved_as_a_whole() -> None:
    """The origin has to go 2 cm beyond a wall that lies in its way."""
    x, y, z = load("point_on_point").chain.start_position.tolist()
    task = PointOnPoint(name="forth", goal=(x - 0.02, y, z))
    wall = Workspace(
        name="wall", normal=(1, 0, 0), through=(x - 0.01, 0, 0), points=((0, 0, 0),), gain=20.0
    )
    scenario = nao(task, limits=(*LIMITS, wall), duration=3.0)
    found = explained(scenario)
    assert found.kind == "limits"
    assert [held.limit for held in found.held_back] == ["limit.wall.object[0]"]
    (need,) = found.needed
    assert need.unit == "m"
    assert 0.01 < need.amount < 0.0125  # 5 % and half a millimetre more, rounded up
    assert "the wall, point (0, 0, 0) of the object holds it back alone" in found.sentence
    assert "mm more room (tried: reached)" in found.sentence


def test_bodies_that_would_have_to_sink_into_each_other_are_not_called_curable() -> None:
    task = PointOnPoint(name="inside", goal=(0.08, 0.0, 0.0))
    found = explained(nao(task, limits=(*LIMITS, SelfCollision())))
    assert found.kind == "limits"
    assert found.held_back[0].words == "the distance of object and torso"
    assert found.tried is None
    assert "not tried" in found.sentence


def test_a_corner_has_a_name_that_a_person_can_find() -> None:
    """The corner that holds the table case back is the one that is lowest in the end."""
    scenario, found = advice("my4"), of_case("my4")
    table = next(k for k in scenario.limits if isinstance(k, Workspace))
    q = run(scenario, controller="qp").q[-1]
    X = scenario.chain.object_pose(q)
    half = 0.5 * np.array(scenario.held.size)
    held = found.held_back[0]
    assert held.words.startswith("the table, corner ")
    signs = [-1.0 if f"-{axis}" in held.words else 1.0 for axis in "xyz"]
    assert X.act(half * signs)[2] == pytest.approx(table.through[2], abs=1e-3)


# Out of reach


def test_the_table_case_is_told_apart_from_what_is_out_of_reach_anyway() -> None:
    """Without the table 4.2 mm are missing, by scipy; with it the run ends much farther off."""
    scenario, found = advice("my4"), of_case("my4")
    way = nearest(scenario.chain, (0.19, 0.0, 0.0))
    assert found.kind == "reach"
    assert found.distance == pytest.approx(float(np.linalg.norm(way)), abs=2e-4)
    end = run(scenario, controller="qp").final_error[0]
    assert f"back by {1e3 * (end - found.distance):.2g}" in found.sentence
    assert found.sentence.startswith("the table, corner ")


@pytest.mark.parametrize("goal", [(0.28, 0.0, 0.05), (0.19, 0.0, 0.35)])
def test_goals_out_of_reach_are_told_by_distance_and_direction(
    goal: tuple[float, float, float],
) -> None:
    scenario = nao(PointOnPoint(name="reach", goal=goal))
    found, way = explained(scenario), nearest(scenario.chain, goal)
    assert found.kind == "reach"
    assert found.distance == pytest.approx(float(np.linalg.norm(way)), abs=5e-4)
    np.testing.assert_allclose(found.way, way / np.linalg.norm(way), atol=5e-3)
    assert "rad/s" not in found.sentence
    assert "out of reach by" in found.sentence


def test_a_twist_that_stretches_the_arms_is_out_of_reach_along_its_axis() -> None:
    """The loops' own Jacobian has all but lost that direction, whatever limits say."""
    scenario, found = advice("nod"), of_case("nod")
    assert found.kind == "reach"
    assert found.way[0] > 0.97
    assert "along +x" in found.sentence
    assert "rad/s" not in found.sentence
    chain, q = scenario.chain, run(scenario, controller="qp").q[-1]
    J = chain.object_jacobians(q)
    free = np.linalg.svd(J[1] - J[0])[2][6:]  # six loop rows, rank six
    stretched, across = (np.linalg.norm(free @ (way @ J[0][:3])) for way in (found.way, (0, 0, 1)))
    assert stretched < 0.01 * across


@needs_robots
def test_a_goal_half_a_metre_too_far_is_not_blamed_on_speeds_or_on_an_idle_wall() -> None:
    found = of_case("far")
    assert found.kind == "reach"
    assert found.tasks == ("carry",)
    assert found.distance is not None
    assert found.distance > 0.1
    assert "wall" not in found.sentence
    assert "velocity" not in found.sentence


# Tasks that contradict each other


def test_two_heights_at_once_are_named_and_not_the_loops() -> None:
    found = of_case("conflict")
    assert found.kind == "contradiction"
    assert set(found.tasks) == {"low", "high"}
    assert found.any_robot
    assert "low and high cannot hold together, on any robot; they end 15 mm off" in found.sentence


@pytest.mark.parametrize("modes", [("hard", "hard"), ("hard", "soft"), ("scaled", "hard")])
def test_hard_tasks_that_conflict_are_named(modes: tuple[str, str]) -> None:
    """A third that has no part in it is left out."""
    low, high = (replace(t, mode=m) for t, m in zip((LOW, HIGH), modes, strict=True))  # type: ignore[arg-type]
    beside = PointOnPlane(name="beside", normal=(0, 1, 0), through=(0, 0.01, 0))
    found = explained(nao(low, beside, high))
    assert found.kind == "contradiction"
    assert set(found.tasks) == {"low", "high"}


def test_of_tasks_with_priorities_it_is_said_who_comes_first() -> None:
    found = explained(nao(LOW, replace(HIGH, priority=1)))
    assert set(found.tasks) == {"low", "high"}
    assert "low comes first, high stays 30 mm off" in found.sentence


def test_tasks_that_only_this_robot_cannot_join_are_said_to_be_so() -> None:
    """A free object could be there and turned so; two arms of five joints cannot."""
    chain = load("point_on_point").chain
    turned = PoseValue(position=(0.18, 0.0, 0.05), rpy_deg=(0, 0, 20))
    there = PointOnPoint(name="there", goal=turned.position)
    found = explained(nao(there, Orientation(name="turned", rpy_deg=(20, 0, 20))))
    assert len(chain.joint_names) == 10
    assert found.kind == "contradiction"
    assert set(found.tasks) == {"there", "turned"}
    assert not found.any_robot


def test_a_twist_against_a_plane_is_a_contradiction() -> None:
    plane = PointOnPlane(name="stay", normal=(1, 0, 0), through=(0.18, 0, 0))
    found = explained(nao(Twist(name="go", velocity={"x": 0.02}), plane))
    assert found.kind == "contradiction"
    assert set(found.tasks) == {"go", "stay"}


def test_redundant_tasks_that_agree_are_no_contradiction() -> None:
    found = explained(nao(REACH, replace(REACH, name="again")))
    assert found.kind == "reached"


def test_a_pose_asks_for_more_than_firm_hands_leave() -> None:
    """Six rows; the loops of two arms of five joints leave ten less six motions."""
    pose = Pose(name="carry", goal=PoseValue(position=(0.175, 0.008, 0.02), rpy_deg=(-9, 12, 0)))
    found = explained(nao(pose))
    assert found.kind == "freedom"
    assert "carry asks for 6 motions, the loops leave 4" in found.sentence


# Speed, time, budget


@pytest.mark.parametrize(
    ("limits", "word"),
    [
        ((JointPosition(), JointVelocity(scale=0.02)), "velocity of "),
        ((*LIMITS, JointAcceleration(max=0.05)), "acceleration of "),
    ],
)
def test_speeds_that_hold_up_are_named_with_the_time_that_would_do(
    limits: tuple[Any, ...], word: str
) -> None:
    """A run of that time reaches the goal, one of nine tenths of it does not."""
    scenario = replace(load("point_on_point"), limits=limits)
    found = explained(scenario)
    assert (found.kind, found.tried) == ("speed", True)
    assert found.time is not None
    assert found.held_back[0].words.startswith(word)
    ends = [
        run(replace(scenario, duration=share * found.time), controller="qp").final_error[0]
        for share in (1.0, 0.9)
    ]
    assert ends[0] <= scenario.tasks[0].tolerance < ends[1]


def test_a_run_that_is_too_short_blames_nobody() -> None:
    task = replace(REACH, gain=2.0, profile=STEP)
    found = explained(nao(task, duration=1.0))
    assert (found.kind, found.tried, found.held_back) == ("short", True, ())
    assert "nothing is in the way; the run ends too early" in found.sentence


def test_a_twist_that_is_too_fast_is_told_by_how_much() -> None:
    scenario = nao(Twist(name="tele", velocity={"z": 2.0}), duration=0.3)
    found = explained(scenario)
    assert found.kind == "speed"
    assert "times the speed there is" in found.sentence
    assert all(held.words.startswith("velocity of ") for held in found.held_back)


# Phases, other laws, damaged runs


def test_the_phase_that_missed_is_explained_and_not_the_last(tmp_path: Path) -> None:
    far = "goal: [0.37, 0.01, 0.06], gain: 5, profile: {duration: 0.4}"
    text = (HEAD + PHASES + TAIL).replace(
        "goal: [0.17, 0.01, 0.06], gain: 5, profile: {duration: 0.4}", far, 1
    )
    scenario = phased(tmp_path, text)
    found = explained(scenario)
    assert (found.phase, found.kind, found.tick) == ("carry", "reach", 59)
    way = nearest(scenario.chain, (0.37, 0.01, 0.06))
    assert found.distance == pytest.approx(float(np.linalg.norm(way)), abs=5e-4)


def test_a_later_phase_is_explained_with_its_own_chain(tmp_path: Path) -> None:
    """The open left arm is asked beyond its elbow's limit; the law reaches what it then may."""
    text = (HEAD + PHASES + TAIL).replace("left: [0.5, 0.5, -1.0, -0.7, 0.1]", "LElbowRoll: 0.3")
    scenario = phased(tmp_path, text)
    found = explained(scenario)
    chain = scenario.chain
    i = chain.joint_names.index("LElbowRoll")
    assert (found.phase, found.kind, found.tried) == ("alone", "limits", True)
    assert [held.limit for held in found.held_back] == ["limit.position[LElbowRoll].upper"]
    (need,) = found.needed
    assert need.amount >= 0.3 - chain.upper[i] - 0.01  # the task's own tolerance


def test_a_law_that_knows_no_limits_is_not_blamed_on_them() -> None:
    found = explained(load("joint_limit_stress"), "pseudoinverse")
    assert found.kind == "reached"


def test_no_goal_counts_as_reached_where_the_loop_came_open() -> None:
    """The pseudoinverse follows the stretching twist by pulling the hands apart."""
    scenario = advice("nod")
    found = explained(scenario, "pseudoinverse")
    far = run(scenario, controller="pseudoinverse").loop_position.max()
    assert far > 0.1
    assert found.kind == "open"
    assert f"open by {1e3 * far:.3g} mm" in found.sentence


def test_a_run_of_nans_says_its_status() -> None:
    scenario = nao(REACH, duration=0.2)
    recording = recording_of(run(scenario, controller="qp"))
    recording.q[-1, 0] = np.nan
    status = (*recording.status[:-1], "NOT_FINITE")
    found = explain_run(scenario, replace(recording, status=status, errors={"reach": np.nan}))
    assert found.kind == "failed"
    assert "the state or the answer has NaN or infinite values" in found.sentence


# From files


def test_a_robot_beside_its_scenario_is_found_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Written elsewhere, and explained from another folder; the rail's limit is in metres."""
    for file in ("gantry.yaml", "gantry.urdf"):
        shutil.copy(ADVICE / file, tmp_path / file)
    text = (tmp_path / "gantry.yaml").read_text(encoding="utf-8")
    far = tmp_path / "far.yaml"
    far.write_text(text.replace("[0.75, 0.1, 0]", "[1.25, 0.1, 0]"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "out"
    assert typed("compare", "far.yaml", "--controllers", "qp", "--out", out).exit_code == 0
    monkeypatch.chdir("/")
    said = typed("explain", out)
    assert said.exit_code == 0
    assert "rail (upper)" in said.output
    assert "mm more (tried: reached)" in said.output
    assert of_case("gantry").kind == "reached"


DAMAGES = {
    "columns": lambda text: "\n".join(line[: line.rfind(",", 0, 200)] for line in text.split("\n")),
    "rows": lambda text: "\n".join(text.split("\n")[:6]) + "\n",
    "text": lambda text: text.replace("0.7", "zero", 1),
    "status": lambda text: text.replace("OPTIMAL", "FINE"),
    "binary": lambda text: text[:300] + "\x00\x01" + text[300:],
}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a short run."""
    folder = tmp_path_factory.mktemp("written")
    short = folder / "short.yaml"
    text = load("point_on_point").source.replace("duration: 3.0", "duration: 0.1")
    short.write_text(text.replace("duration: 2.0", "duration: 0.1"), encoding="utf-8")
    out = folder / "out"
    assert typed("compare", short, "--controllers", "qp", "--out", out).exit_code == 0
    return out


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_traces_are_refused_in_one_line(damage: str, written: Path, tmp_path: Path) -> None:
    out, trace = tmp_path, tmp_path / "trace.csv"
    shutil.copy(written / "scenario.yaml", out / "scenario.yaml")
    text = (written / "trace.csv").read_text(encoding="utf-8")
    trace.write_text(DAMAGES[damage](text), encoding="utf-8")
    result = typed("explain", out)
    assert result.exit_code == 2
    assert len(result.stderr.strip().splitlines()) == 1
    assert "damaged" in result.stderr or "is not a trace.csv" in result.stderr
