"""Loops that open and close on the way: grasp, release and regrasp as phases."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray
from shipped_here import HAS_ROBOTS
from test_closed_chain import three_arms

from coopqp import cli
from coopqp.closed_chain import ClosedChain
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.comparison import compare, summarize
from coopqp.controller_run import run
from coopqp.errors import GraspError, ScenarioError, UnknownNameError
from coopqp.grasps import Revolute, Rigid
from coopqp.held_object import HeldObject
from coopqp.plants import Kinematic, Mujoco, RigidBody
from coopqp.report import files
from coopqp.report.mobility import study
from coopqp.robot import RobotModel
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.state import State
from coopqp.study.explanation import TickRecord
from coopqp.trace import Trace

Array = NDArray[np.float64]

HEAD = """\
robot: nao_t14
grasp: {rigid: {}}
object: {size: [0.08, 0.19, 0.08], mass: 0.2}
start:
  right: [0.7, -0.2, 1.2, 0.9, 0.1]
  left: [0.7, 0.2, -1.2, -0.9, -0.1]
"""
#: Both carry; the left hand lets go and moves away; both carry again, held otherwise.
PHASES = """\
phases:
  - name: carry
    duration: 0.6
    tasks:
      - point_on_point: {name: reach, goal: [0.17, 0.01, 0.06], gain: 5, profile: {duration: 0.4}}
  - name: alone
    duration: 0.6
    released: [left]
    tasks:
      - point_on_point: {name: stay, goal: [0.17, 0.01, 0.06], gain: 5, profile: {duration: 0.1}}
      - posture: {name: away, goal: {left: [0.5, 0.5, -1.0, -0.7, 0.1]}, gain: 5,
                  tolerance: 0.01, profile: {duration: 0.4}}
  - name: again
    duration: 0.5
    tasks:
      - point_on_point: {name: up, goal: [0.17, 0.01, 0.07], gain: 5, profile: {duration: 0.3}}
"""
TAIL = "controllers: [qp]\ndt: 0.01\nkappa: 100\n"
ALONE, AGAIN = 60, 120  # first ticks of the later phases


def scenario(folder: Path, text: str = HEAD + PHASES + TAIL) -> Scenario:
    path = folder / "scenario.yaml"
    path.write_text(text, encoding="utf-8")
    return load(path)


@pytest.fixture(scope="module")
def regrasped(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scenario, Trace]:
    """The scenario above and its run."""
    made = scenario(tmp_path_factory.mktemp("phases"))
    return made, run(made, controller="qp")


# The chain


def poses(chain: ClosedChain, q: Array) -> dict[str, pin.SE3]:
    """Where each arm carries the object, by pinocchio alone."""
    data = chain.model.createData()
    pin.framesForwardKinematics(chain.model, data, q)
    return {a.name: data.oMf[f].copy() for a, f in zip(chain.arms, chain.frames, strict=True)}


def moved_left(chain: ClosedChain, rng: np.random.Generator) -> Array:
    """A configuration with the left arm somewhere else."""
    q = chain.q_start.copy()
    left = [i for i, name in enumerate(chain.joint_names) if name.startswith("L")]
    q[left] += rng.uniform(-0.2, 0.2, len(left))
    return q


def test_letting_go_leaves_the_other_hand_and_the_object_where_they_are(
    chain: ClosedChain, rng: np.random.Generator
) -> None:
    alone = chain.handed_over(chain.q_start, ["left"])
    assert [arm.name for arm in alone.arms] == ["right", "left"]
    assert alone.holding == 1
    q = moved_left(alone, rng)
    before, after = poses(chain, chain.q_start), poses(alone, q)
    assert after["right"].isApprox(before["right"], 1e-12)
    assert alone.object_pose(q).isApprox(before["right"], 1e-12)
    state = State(alone, q)
    assert state.loop_position_error == state.loop_orientation_error == 0.0
    assert state.J_loop.shape == (0, chain.n)
    assert np.linalg.norm(state.loop_error[:3]) > 0.01, "the left hand has moved away"
    left = [i for i, name in enumerate(chain.joint_names) if name.startswith("L")]
    assert not state.J_task[:, left].any(), "and no longer moves the object"


def test_the_first_arm_can_let_go_as_well(chain: ClosedChain) -> None:
    alone = chain.handed_over(chain.q_start, ["right"])
    assert [arm.name for arm in alone.arms] == ["left", "right"]
    assert alone.alpha.tolist() == [1.0, 0.0]
    assert all(name.startswith("loop[right]") for name in alone.loops.names)
    right = [i for i, name in enumerate(chain.joint_names) if name.startswith("R")]
    assert not State(alone).J_task[:, right].any()


def test_a_hand_takes_hold_where_it_is(chain: ClosedChain, rng: np.random.Generator) -> None:
    alone = chain.handed_over(chain.q_start, ["left"])
    q = moved_left(alone, rng)
    again = alone.handed_over(q)
    assert [arm.name for arm in again.arms] == ["right", "left"]
    object_pose = alone.object_pose(q)
    for pose in poses(again, q).values():
        assert pose.isApprox(object_pose, 1e-12)
    state = State(again)
    assert state.loop_position_error < 1e-15
    assert again.loops.rank == 6
    # Held otherwise, and so free to move otherwise.
    assert np.abs(state.J_loop - State(chain, q).J_loop).max() > 1e-3


def test_the_velocity_of_the_object_is_that_of_its_pose(
    chain: ClosedChain, rng: np.random.Generator
) -> None:
    for released in (["left"], ["right"]):
        alone, h = chain.handed_over(chain.q_start, released), 1e-6
        v = rng.normal(size=chain.n)
        before, after = State(alone, alone.q_start - h * v), State(alone, alone.q_start + h * v)
        twist = State(alone).J_task @ v
        np.testing.assert_allclose((after.p_WO - before.p_WO) / (2 * h), twist[:3], atol=1e-8)
        turn = pin.log3(after.R_WO @ before.R_WO.T) / (2 * h)
        np.testing.assert_allclose(turn, twist[3:], atol=1e-8)


@pytest.mark.parametrize(
    ("released", "rank", "closed"),
    [((), 12, 12), (("left",), 6, 6), (("right", "middle"), 0, 0)],
)
def test_three_arms_lose_a_loop_for_each_that_lets_go(
    released: tuple[str, ...], rank: int, closed: int
) -> None:
    chain = three_arms().handed_over(three_arms().q_start, released)
    assert (chain.loops.rank, chain.loops.closed) == (rank, closed)
    assert len(chain.loops.names) == 12
    assert State(chain).J_loop.shape == (rank, chain.n)
    assert {arm.name for arm in chain.arms[chain.holding :]} == set(released)


def test_when_the_leader_lets_go_the_others_share_the_object(nao: RobotModel) -> None:
    alpha = {"right": 1.0, "left": 0.0}
    q = nao.configuration({})
    led = ClosedChain.take_hold(nao, q, Rigid(), HeldObject(), alpha=alpha)
    assert led.handed_over(led.q_start, ["left"]).alpha.tolist() == [1.0, 0.0]
    other = led.handed_over(led.q_start, ["right"])
    assert (other.arms[0].name, other.alpha.tolist()) == ("left", [1.0, 0.0])


def test_a_released_hand_leaves_its_hinge_alone(nao: RobotModel, chain: ClosedChain) -> None:
    hinge = Revolute(axis=(1.0, 0.0, 0.0))
    held = ClosedChain.take_hold(nao, chain.q_start, hinge, HeldObject())
    turned = held.q_start.copy()
    turned[held.joint_names.index("left.hinge")] = 0.4
    alone = held.moved(turned).handed_over(turned, ["left"])
    state = State(alone)
    column = alone.joint_names.index("left.hinge")
    assert not state.J_ext[:, column].any()
    assert poses(alone, turned)["left"].isApprox(poses(held, turned)["left"], 1e-12)


def test_someone_must_hold_the_object(chain: ClosedChain) -> None:
    with pytest.raises(GraspError, match="no arm is left that holds"):
        chain.handed_over(chain.q_start, ["left", "right"])
    with pytest.raises(UnknownNameError, match="unknown arm 'lefft'; did you mean 'left'"):
        chain.handed_over(chain.q_start, ["lefft"])


# The run


def in_the_hand(made: Scenario, trace: Trace, arm: str, rows: slice) -> Array:
    """The object's pose in a hand, from the robot's own model, shape (rows, 12)."""
    robot = made.robot_model
    model, data = robot.model, robot.model.createData()
    tip = model.getFrameId(next(a.tip for a in robot.arms if a.name == arm))
    found = []
    for q, p, R in zip(trace.q[rows], trace.position[rows], trace.rotation[rows], strict=True):
        pin.framesForwardKinematics(model, data, q[: model.nq])
        found.append(data.oMf[tip].actInv(pin.SE3(R, p)).homogeneous[:3].ravel())
    return np.array(found)


def test_the_object_keeps_its_place_in_the_hands_that_hold_it(
    regrasped: tuple[Scenario, Trace],
) -> None:
    made, trace = regrasped
    whole = in_the_hand(made, trace, "right", slice(None))
    np.testing.assert_allclose(whole, np.tile(whole[0], (len(whole), 1)), atol=2e-4)
    first = in_the_hand(made, trace, "left", slice(0, ALONE + 1))
    np.testing.assert_allclose(first, np.tile(first[0], (len(first), 1)), atol=2e-4)
    last = in_the_hand(made, trace, "left", slice(AGAIN, None))
    np.testing.assert_allclose(last, np.tile(last[0], (len(last), 1)), atol=2e-4)
    assert np.abs(first[0] - last[0]).max() > 0.05, "it has taken hold elsewhere"


def test_a_run_goes_on_without_a_jump_and_inside_its_limits(
    regrasped: tuple[Scenario, Trace],
) -> None:
    made, trace = regrasped
    assert trace.ticks == made.ticks == 170
    np.testing.assert_allclose(trace.t, 0.01 * np.arange(171), atol=1e-12)
    np.testing.assert_allclose(np.diff(trace.q, axis=0), 0.01 * trace.v, atol=1e-15)
    assert np.abs(np.diff(trace.position, axis=0)).max() < 2e-3
    assert ((trace.lower <= trace.q) & (trace.q <= trace.upper)).all()
    assert (np.abs(trace.v) <= trace.velocity + 1e-12).all()
    assert trace.loop_position.max() < 1e-4
    assert not trace.loop_position[ALONE + 1 : AGAIN + 1].any()


def test_each_phase_answers_for_its_own_tasks(regrasped: tuple[Scenario, Trace]) -> None:
    _, trace = regrasped
    names = [task.name for task in trace.tasks]
    assert names == ["carry.reach", "alone.stay", "alone.away", "again.up"]
    known = np.isfinite(trace.task_error)
    assert [np.flatnonzero(column)[[0, -1]].tolist() for column in known.T] == [
        [0, ALONE], [ALONE, AGAIN], [ALONE, AGAIN], [AGAIN, 170],
    ]  # fmt: skip
    reached = trace.final_error <= [task.tolerance for task in trace.tasks]
    assert reached.all(), trace.final_error
    metrics = summarize(*_as_comparison(regrasped)).metrics["qp"]
    assert metrics["reached"]
    assert set(metrics["task_error"]) == set(names)


def _as_comparison(regrasped: tuple[Scenario, Trace]) -> tuple[Scenario, Mapping[str, Trace]]:
    made, trace = regrasped
    return made, {"qp": trace}


def test_a_posture_of_one_arm_leaves_the_other_to_the_object(tmp_path: Path) -> None:
    """Both count alike; the joints of the arm that holds the object are not asked to rest."""
    stay, lifted = "0.01, 0.06], gain: 5, profile: {duration: 0.1}", "-0.01, 0.07], gain: 5"
    lift = PHASES.replace(stay, lifted + ", profile: {duration: 0.3}")
    assert lift != PHASES
    text = HEAD + lift.replace("    duration: 0.6\n    released", "    duration: 1.5\n    released")
    trace = run(scenario(tmp_path, text + TAIL), controller="qp")
    reached = dict(zip([t.name for t in trace.tasks], trace.final_error, strict=True))
    assert reached["alone.stay"] < 5e-4
    assert reached["alone.away"] < 0.01


def test_one_phase_is_the_same_as_none(tmp_path: Path) -> None:
    tasks = "- point_on_point: {name: reach, goal: [0.17, 0.01, 0.06], gain: 5}\n"
    plain = scenario(tmp_path, f"{HEAD}duration: 1.0\ntasks:\n  {tasks}{TAIL}")
    phased = scenario(
        tmp_path, f"{HEAD}phases:\n  - name: all\n    duration: 1.0\n    tasks:\n    {tasks}{TAIL}"
    )
    one, other = run(plain, controller="qp"), run(phased, controller="qp")
    np.testing.assert_array_equal(one.q, other.q)
    np.testing.assert_array_equal(one.task_error, other.task_error)


def test_a_phase_that_changes_nothing_changes_nothing(tmp_path: Path) -> None:
    """Cut where the reference rests; the grasp is kept, so only rounding may differ."""
    goal = "- point_on_point: {goal: [0.17, 0.01, 0.06], gain: 5, profile: {duration: 0.5}}"
    rest = goal.replace("{duration: 0.5}", "{kind: step}")
    text = f"phases:\n  - name: a\n    duration: 0.8\n    tasks:\n    {goal}\n"
    text += f"  - name: b\n    duration: 0.4\n    tasks:\n    {rest}\n"
    cut = run(scenario(tmp_path, HEAD + text + TAIL), controller="qp")
    whole = f"duration: 1.2\ntasks:\n  {goal}\n"
    np.testing.assert_allclose(
        cut.q, run(scenario(tmp_path, HEAD + whole + TAIL), controller="qp").q, atol=1e-9
    )


def test_every_law_runs_through_the_phases(tmp_path: Path) -> None:
    laws = "[qp, pseudoinverse, pseudoinverse_null_space]"
    made = scenario(tmp_path, (HEAD + PHASES + TAIL).replace("[qp]", laws))
    comparison = compare(made)
    for name, trace in comparison.traces.items():
        assert np.isfinite(trace.q).all(), name
        assert comparison.metrics[name]["reached"], name


def test_mobility_is_that_of_the_phase(tmp_path: Path) -> None:
    made = scenario(tmp_path)
    found = {name: study(made, phase=name).mobility for name in ("carry", "alone", "again")}
    assert [(m.rank, m.freedom) for m in found.values()] == [(6, 4), (0, 10), (6, 4)]
    # NAO's arm of five joints leaves the object five motions when it holds it alone.
    assert [m.object_freedom for m in found.values()] == [4, 5, 4]
    assert [m.tasks_rank for m in found.values()] == [3, 3, 3]
    with pytest.raises(UnknownNameError, match="unknown phase 'aloan'; did you mean 'alone'"):
        study(made, phase="aloan")


# Plants with masses


def test_a_hand_that_takes_hold_in_motion_stops_as_pinocchio_says(
    chain: ClosedChain, rng: np.random.Generator
) -> None:
    box = HeldObject(size=(0.08, 0.19, 0.08), mass=0.2)
    closed = ClosedChain.take_hold(chain.robot, chain.q_start, Rigid(), box)
    dynamics = ClosedLoopDynamics(closed)
    v = rng.normal(size=closed.n)
    dynamics.update(closed.q_start, v)
    after = dynamics.impact(v)
    J, data = State(closed).J_loop, dynamics.model.createData()
    expected = pin.impulseDynamics(dynamics.model, data, closed.q_start, v, J, 0.0, 0.0)
    np.testing.assert_allclose(after, expected, atol=1e-9)
    assert np.abs(J @ after).max() < 1e-12
    energy = [dynamics.kinetic_energy(closed.q_start, speed) for speed in (v, after)]
    assert energy[1] < energy[0], "no bounce gives energy"


@pytest.mark.parametrize("plant", [RigidBody(), Mujoco()])
def test_plants_with_masses_open_and_close_the_loop(tmp_path: Path, plant: object) -> None:
    if isinstance(plant, Mujoco):
        pytest.importorskip("mujoco")
    # Welds give way a little, and a drift correction would pull at them without end.
    made = replace(scenario(tmp_path), plant=plant, kappa=0.0)
    trace, ideal = (
        run(made, controller="qp"),
        run(replace(made, plant=Kinematic()), controller="qp"),
    )
    assert trace.t[-1] == pytest.approx(1.7)
    np.testing.assert_allclose(trace.position, ideal.position, atol=2e-3)
    assert (trace.final_error <= 4.0 * np.array([task.tolerance for task in trace.tasks])).all()
    tau = trace.signals["tau"]
    assert np.isfinite(tau).all()
    assert (np.abs(tau) <= trace.effort + 1e-9).all()


def test_time_and_pushes_go_on_from_phase_to_phase(tmp_path: Path) -> None:
    """A push in the second phase, by the clock of the whole run, moves nothing before it."""
    push = "disturbance: {push: {force: [0, 0, -1.0], start: 0.9, duration: 0.1}}\n"
    text = HEAD + PHASES + TAIL + "plant: rigid_body\n"
    calm = run(scenario(tmp_path, text), controller="qp")
    pushed = run(scenario(tmp_path, text + push), controller="qp")
    difference = np.abs(calm.q - pushed.q).max(axis=1)
    assert not difference[:91].any()
    assert difference[95] > 1e-5


def test_a_released_hinge_is_refused_where_there_are_masses(tmp_path: Path) -> None:
    text = (HEAD + PHASES + TAIL).replace("{rigid: {}}", "{revolute: {axis: [1, 0, 0]}}")
    assert np.isfinite(run(scenario(tmp_path, text), controller="qp").q).all()
    made = scenario(tmp_path, text + "plant: rigid_body\n")
    with pytest.raises(
        GraspError, match="arm left, when it lets go, would leave the joints of its passive grasp"
    ):
        run(made, controller="qp")


# Files


def test_the_trace_names_the_phase_and_leaves_other_phases_errors_empty(
    regrasped: tuple[Scenario, Trace],
) -> None:
    text = files.trace_csv(summarize(*_as_comparison(regrasped)))
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [rows[k]["phase"] for k in (0, ALONE - 1, ALONE, AGAIN, 170)] == [
        "carry", "carry", "alone", "again", "again",
    ]  # fmt: skip
    assert rows[0]["error[alone.away]"] == rows[AGAIN + 1]["error[alone.away]"] == ""
    assert float(rows[ALONE]["error[alone.away]"]) >= 0.0


@pytest.mark.parametrize("tick", [10, ALONE, 90, AGAIN, 150])
def test_a_tick_of_any_phase_can_be_kept_and_solved_again(tmp_path: Path, tick: int) -> None:
    (tmp_path / "in.yaml").write_text(HEAD + PHASES + TAIL, encoding="utf-8")
    out, kept = tmp_path / "out", tmp_path / "tick.json"
    runner = CliRunner()
    assert (
        runner.invoke(cli.main, ["compare", str(tmp_path / "in.yaml"), "--out", str(out)]).exit_code
        == 0
    )
    arguments = ["explain", str(out), "--tick", str(tick), "--save", str(kept)]
    assert runner.invoke(cli.main, arguments).exit_code == 0
    record = TickRecord.read(kept)
    with (out / "trace.csv").open(encoding="utf-8") as stream:
        row = list(csv.DictReader(stream))[tick]
    recorded = [float(row[f"v[{name}]"]) for name in load(out / "scenario.yaml").chain.joint_names]
    np.testing.assert_allclose(record.answer, recorded, atol=1e-6)
    loops = [name for name in record.equality_names if name.startswith("loop[")]
    assert len(loops) == (0 if ALONE <= tick < AGAIN else 6)


FAULTS = [
    ("released: [left]", "released: [lefft]", "phases[1].released: unknown arm 'lefft'; did you"),
    ("released: [left]", "released: [left, right]", "no arm is left that holds the object"),
    ("released: [left]", "relaesed: [left]", "phases[1].relaesed: unknown key 'relaesed'"),
    ("name: alone", "name: carry", "phases[1].name: the name 'carry' is taken"),
    ("name: away,", "name: stay,", "phases[1].tasks[1]: the name 'stay' is taken"),
    ("    duration: 0.5\n", "", "phases[2].duration: is missing"),
    ("duration: 0.4", "duration: 4", "phases[0].tasks[0]: the reference of 'reach' arrives at 4 s"),
    ("goal: {left:", "goal: {leftt:", "phases[1].tasks[1]: "),
    ("controllers", "duration: 3\ncontrollers", "duration: belongs into each phase"),
    ("phases:", "tasks: []\nphases:", "tasks: belongs into each phase"),
    (PHASES, "phases:\n", "phases: needs at least one phase"),
    ("phases:", "phasen:", "unknown key 'phasen'; did you mean 'phases'"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), FAULTS)
def test_a_fault_is_answered_with_its_place(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    text = HEAD + PHASES + TAIL
    assert old in text
    with pytest.raises(ScenarioError) as error:
        scenario(tmp_path, text.replace(old, new, 1))
    assert message in str(error.value)


# The shipped scenario


@pytest.mark.skipif(not HAS_ROBOTS, reason="needs example-robot-data")
def test_pandas_regrasp_a_box_with_a_quarter_turn() -> None:
    made = load("regrasp")
    trace = run(made, controller="qp")
    assert (trace.final_error <= [task.tolerance for task in trace.tasks]).all()
    assert ((trace.lower <= trace.q) & (trace.q <= trace.upper)).all()
    lift = made.first_ticks[3]
    before = in_the_hand(made, trace, "right/arm", slice(0, 1)).reshape(3, 4)[:, :3]
    after = in_the_hand(made, trace, "right/arm", slice(lift, lift + 1)).reshape(3, 4)[:, :3]
    assert np.linalg.norm(pin.log3(before @ after.T)) == pytest.approx(np.pi / 2, abs=1e-3)
    classical = run(made, controller="pseudoinverse")
    beyond = np.maximum(classical.lower - classical.q, classical.q - classical.upper).max()
    assert beyond > 0.1, "which the pseudoinverse does beyond its limits"
