"""Why a tick could not do what its tasks asked, and whether what it says is so."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import qpsolvers
from numpy.typing import NDArray
from scipy.optimize import linprog

import coopqp
from coopqp.checked import Pose as PoseValue
from coopqp.closed_chain import ClosedChain
from coopqp.comparison import Comparison, compare
from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.qp_law.law import QPLaw
from coopqp.errors import CoopqpError, InvalidValueError
from coopqp.limits import JointAcceleration, JointPosition, JointVelocity, ObjectSpeed
from coopqp.profile import Profile
from coopqp.report import files
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Budget, Solver, Status
from coopqp.solvers import Daqp, Osqp, Proxqp, Qpsolvers
from coopqp.state import State
from coopqp.study.explanation import (
    Explanation,
    Relaxation,
    TickRecord,
    explain,
    record_tick,
    replay,
)
from coopqp.study.trace_file import blocked_tick, controllers_of, state_from_trace
from coopqp.task import Task
from coopqp.tasks import PointOnPoint, Pose

Array = NDArray[np.float64]

DT = 0.01
STEP = Profile(kind="step")
NEAR, FAR = (0.19, 0.01, 0.06), (0.19, 0.1, 0.25)
LIMITS = (JointPosition(), JointVelocity())
LATE = (150, 220, 299)
GOAL, GAIN, DURATION = np.array([0.10, -0.05, 0.04]), 5.0, 2.0  # of joint_limit_stress
WIDE = Budget(loop_position=1.0, loop_orientation=3.0)


def problem(chain: ClosedChain, *tasks: Task, **settings: Any) -> ControlProblem:
    given: dict[str, Any] = {
        "solver": Daqp(), "limits": LIMITS, "dt": DT, "kappa": 1 / DT, "budget": WIDE, **settings,
    }  # fmt: skip
    return ControlProblem(chain=chain, tasks=tasks, **given)


def build(problem: ControlProblem) -> QPLaw:
    law = QPController().build(problem)
    assert isinstance(law, QPLaw)
    return law


def record(law: QPLaw, state: State, tick: int = 0) -> TickRecord:
    return record_tick(law, state, scenario="made here", controller="qp", tick=tick)


def first_tick(chain: ClosedChain, *tasks: Task, **settings: Any) -> TickRecord:
    law = build(problem(chain, *tasks, **settings))
    return record(law, law.start())


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load("joint_limit_stress")


@pytest.fixture(scope="module")
def compared(scenario: Scenario) -> Comparison:
    return compare(scenario, controllers=["qp", "pseudoinverse"])


@pytest.fixture(scope="module")
def trace_csv(compared: Comparison, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    files.write(compared, folder)
    return folder / "trace.csv"


@pytest.fixture(scope="module")
def law(scenario: Scenario) -> QPLaw:
    built = scenario.controllers["qp"].build(scenario.problem())
    assert isinstance(built, QPLaw)
    return built


def at(compared: Comparison, law: QPLaw, tick: int) -> State:
    """The state before a tick, from the trace in memory."""
    trace = compared.traces["qp"]
    state = law.start(trace.q[tick])
    state.t = float(trace.t[tick])
    state.v[:] = trace.v[tick - 1] if tick else 0.0
    return state


# Blocked by limits.


class Physics:
    """What a tick of joint_limit_stress must do, written out from chain, state and goal."""

    def __init__(self, state: State) -> None:
        chain, n = state.chain, len(state.q)
        x = min(state.t / DURATION, 1.0)
        share = x**3 * (10 - 15 * x + 6 * x * x)
        speed = 30 * x * x * (1 - x) ** 2 / DURATION
        way = GOAL - chain.start_position
        wanted = speed * way - GAIN * (state.p_WO - chain.start_position - share * way)
        self.A = np.vstack([state.J_rel, state.J_task[:3]])
        self.b = np.concatenate([-state.loop_error / DT, wanted])
        self.names = chain.joint_names
        self.lower, self.upper = (chain.lower - state.q) / DT, (chain.upper - state.q) / DT
        self.speed = chain.velocity
        self.n = n

    def holds(self, slack: dict[str, float]) -> bool:
        """Whether loops and task hold with these limits widened [rad] or [rad/s]."""
        lower, upper = self.lower.copy(), self.upper.copy()
        low, high = -self.speed.copy(), self.speed.copy()
        for name, amount in slack.items():
            i = self.names.index(name.split("[")[1].split("]")[0])
            assert name.split("[")[0] in ("limit.position", "limit.velocity")
            if name.startswith("limit.position"):
                side, change = (lower, upper), amount / DT
            else:
                side, change = (low, high), amount
            if name.endswith(".lower"):
                side[0][i] -= change
            else:
                side[1][i] += change
        bounds = np.column_stack([np.maximum(lower, low), np.minimum(upper, high)])
        bounds += [-1e-8, 1e-8]
        return bool(linprog(np.zeros(self.n), A_eq=self.A, b_eq=self.b, bounds=bounds).success)

    def least_relaxation(self) -> float:
        """Smallest sum by which bounds on v must give way [rad/s], from the dual program.

        max b'y - ub'z+ + lb'z- with A'y = z+ - z-, 0 <= z <= 1: a certificate that no smaller
        sum will do.
        """
        ub, lb = np.minimum(self.upper, self.speed), np.maximum(self.lower, -self.speed)
        m = len(self.b)
        eye = np.eye(self.n)
        found = linprog(
            -np.concatenate([self.b, -ub, lb]),
            A_eq=np.hstack([self.A.T, -eye, eye]),
            b_eq=np.zeros(self.n),
            bounds=[(None, None)] * m + [(0.0, 1.0)] * (2 * self.n),
        )
        assert found.success
        return float(-found.fun)


@pytest.mark.parametrize("tick", LATE)
def test_elbows_at_their_limits_are_named(compared: Comparison, law: QPLaw, tick: int) -> None:
    found = explain(record(law, at(compared, law, tick), tick))
    names = {relaxation.name for relaxation in found.relaxations}
    assert names & {"limit.position[RElbowRoll].upper", "limit.position[LElbowRoll].lower"}
    assert all(relaxation.unit == "rad" for relaxation in found.relaxations)
    assert set(found.missed) <= {"task[reach].x", "task[reach].y", "task[reach].z"}
    assert found.missed
    assert found.impossible == ()
    for name in (*names, *found.missed):
        assert name in found.sentence
    for relaxation in found.relaxations:
        assert f"{relaxation.amount:.3g} rad more" in found.sentence


@pytest.mark.parametrize("tick", LATE)
def test_named_limits_are_at_their_ends_in_the_trace(
    compared: Comparison, law: QPLaw, tick: int
) -> None:
    """The explanation blames joints that really rest at that limit."""
    trace = compared.traces["qp"]
    for relaxation in explain(record(law, at(compared, law, tick), tick)).relaxations:
        assert trace.margins[relaxation.name][tick] < 1e-6


@pytest.mark.parametrize("tick", LATE)
def test_the_named_relaxation_would_do(compared: Comparison, law: QPLaw, tick: int) -> None:
    """The limits widened by exactly what is said let loops and task hold; 1 % less does not."""
    state = at(compared, law, tick)
    found, physics = explain(record(law, state, tick)), Physics(state)
    slack = {relaxation.name: relaxation.amount for relaxation in found.relaxations}
    assert not physics.holds({})
    assert physics.holds(slack)
    assert not physics.holds({name: 0.99 * amount for name, amount in slack.items()})
    for name in slack:
        assert not physics.holds({k: a for k, a in slack.items() if k != name})


@pytest.mark.parametrize("tick", LATE)
def test_nothing_smaller_would_do(compared: Comparison, law: QPLaw, tick: int) -> None:
    """Against the dual program, whose value is a lower bound of every relaxation's sum."""
    state = at(compared, law, tick)
    found = explain(record(law, state, tick))
    total = sum(relaxation.amount for relaxation in found.relaxations) / DT
    assert total == pytest.approx(Physics(state).least_relaxation(), rel=1e-6)


def test_law_with_the_relaxed_limits_meets_the_task(
    scenario: Scenario, compared: Comparison, law: QPLaw
) -> None:
    """Rebuilt with the limits widened by what is said, one tick of the law moves as wanted."""
    state = at(compared, law, 250)
    found = explain(record(law, state, 250))
    model = scenario.robot_model.model.copy()
    lower, upper = model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()
    for relaxation in found.relaxations:
        joint, side = relaxation.name.removeprefix("limit.position[").split("].")
        change = relaxation.amount + 1e-9
        if side == "lower":
            lower[scenario.chain.joint_names.index(joint)] -= change
        else:
            upper[scenario.chain.joint_names.index(joint)] += change
    model.lowerPositionLimit, model.upperPositionLimit = lower, upper
    chain = scenario.chain
    wider = ClosedChain.take_hold(
        replace(scenario.robot_model, model=model),
        chain.q_start,
        scenario.grasps,
        scenario.held,  # type: ignore[arg-type]
    )
    given = replace(scenario.problem(), chain=wider, budget=WIDE, tasks=(
        replace(scenario.tasks[0], mode="hard"),
    ))  # fmt: skip
    command = build(given).tick(state)
    assert command.status is Status.OPTIMAL
    physics = Physics(state)
    np.testing.assert_allclose(physics.A @ command.v, physics.b, atol=1e-6)
    assert build(replace(given, chain=chain)).tick(state).status is Status.TASKS_GIVEN_UP


# Blocked by other limits, by the loops, by nothing.


def test_velocity_limits_are_named_with_what_they_lack(chain: ClosedChain) -> None:
    """Asked for 0.9 m/s at one percent of the joints' speed."""
    task = PointOnPoint(name="dash", goal=NEAR, profile=STEP, gain=50.0)
    slow = JointVelocity(scale=0.01)
    found = explain(first_tick(chain, task, limits=(JointPosition(), slow)))
    assert found.relaxations
    state = State(chain)
    A = np.vstack([state.J_rel, state.J_task[:3]])
    b = np.concatenate([-state.loop_error / DT, -50.0 * (state.p_WO - NEAR)])
    lb, ub = -0.01 * chain.velocity, 0.01 * chain.velocity
    for relaxation in found.relaxations:
        assert relaxation.name.startswith("limit.velocity[")
        assert relaxation.unit == "rad/s"
        joint, side = relaxation.name.removeprefix("limit.velocity[").split("].")
        i = chain.joint_names.index(joint)
        if side == "lower":
            lb[i] -= relaxation.amount
        else:
            ub[i] += relaxation.amount
    bounds = np.column_stack([lb - 1e-8, ub + 1e-8])
    assert linprog(np.zeros(chain.n), A_eq=A, b_eq=b, bounds=bounds).success


def test_acceleration_limit_is_named_where_it_is_what_holds_back(chain: ClosedChain) -> None:
    task = PointOnPoint(name="dash", goal=NEAR, profile=STEP, gain=50.0)
    limits = (*LIMITS, JointAcceleration(max=1.0))
    found = explain(first_tick(chain, task, limits=limits))
    assert found.relaxations
    assert {r.name.split("[")[0] for r in found.relaxations} == {"limit.acceleration"}


def test_object_speed_is_named_by_its_row(chain: ClosedChain) -> None:
    """Wanted along z is 5 times the way; the rest of 0.02 m/s is what must give."""
    x, y, z = State(chain).p_WO.tolist()
    task = PointOnPoint(name="lift", goal=(x, y, z + 0.05), profile=STEP)
    found = explain(first_tick(chain, task, limits=(*LIMITS, ObjectSpeed(linear=0.02))))
    assert [r.name.removeprefix("limit.") for r in found.relaxations] == ["object_speed.z.upper"]
    assert found.relaxations[0].amount == pytest.approx(5 * 0.05 - 0.02, abs=1e-6)


def test_object_speed_is_told_in_metres(chain: ClosedChain) -> None:
    x, y, z = State(chain).p_WO.tolist()
    task = PointOnPoint(name="lift", goal=(x, y, z + 0.05), profile=STEP)
    found = explain(first_tick(chain, task, limits=(*LIMITS, ObjectSpeed(linear=0.02))))
    assert found.relaxations[0].unit == "m/s"
    assert "rad" not in found.sentence


def test_rows_have_one_name_in_explanation_and_audit(chain: ClosedChain) -> None:
    x, y, z = State(chain).p_WO.tolist()
    task = PointOnPoint(name="lift", goal=(x, y, z + 0.05), profile=STEP)
    limit = ObjectSpeed(linear=0.02)
    found = explain(first_tick(chain, task, limits=(*LIMITS, limit)))
    audited = limit.margins(chain, np.tile(chain.q_start, (2, 1)), np.zeros((1, chain.n)), DT)
    assert {relaxation.name for relaxation in found.relaxations} <= set(audited)


POSE = Pose(
    name="carry",
    goal=PoseValue(position=(0.175, 0.008, 0.020), rpy_deg=(-9, 12, 0)),
    profile=STEP,
)


@pytest.mark.parametrize("mode", ["soft", "hard", "scaled"])
def test_rows_that_firm_hands_rule_out_are_said_to_be_impossible(
    mode: str, chain: ClosedChain
) -> None:
    """Six rows, four motions: two are impossible, whatever the limits."""
    task = replace(POSE, mode=mode)  # type: ignore[arg-type]
    found = explain(first_tick(chain, task))
    assert len(found.impossible) == 2
    state = State(chain)
    free = np.linalg.svd(state.J_rel)[2][np.linalg.matrix_rank(state.J_rel) :]
    assert np.linalg.matrix_rank(state.J_task @ free.T, tol=1e-9) == 4
    rows = [f"task[carry].{axis}" for axis in ("x", "y", "z", "rot_x", "rot_y", "rot_z")]
    kept = [i for i, name in enumerate(rows) if name not in found.impossible]
    assert np.linalg.matrix_rank(state.J_task[kept] @ free.T, tol=1e-9) == 4
    assert found.sentence.startswith("the loops alone leave no motion along task[carry].")
    for name in found.impossible:
        assert name in found.sentence


def test_pose_that_hinges_allow_is_not_impossible() -> None:
    """The same pose with a hinge in each hand has all six motions."""
    hinged = load("passive_grasp_pose").problem()
    law = QPController().build(replace(hinged, tasks=(replace(POSE, gain=5.0),), budget=WIDE))
    assert isinstance(law, QPLaw)
    assert explain(record(law, law.start())).impossible == ()


@pytest.mark.parametrize("mode", ["soft", "hard", "scaled"])
def test_tick_that_misses_nothing_says_so(mode: str, chain: ClosedChain) -> None:
    """The object is where it shall be; or a hard or scaled task has room."""
    here = State(chain).p_WO.tolist()
    goal = tuple(here) if mode == "soft" else NEAR
    task = PointOnPoint(name="reach", goal=goal, profile=STEP, mode=mode)  # type: ignore[arg-type]
    found = explain(first_tick(chain, task))
    nothing = "nothing was in the way: every task row was met"
    assert found == Explanation((), (), (), nothing)


@pytest.mark.parametrize("name", ["point_on_plane", "tilting_plane", "yeo_4_5"])
def test_ordinary_tick_meets_its_tasks(name: str) -> None:
    """No joint of these comes near a limit; all that is missing is what the damping costs."""
    given = coopqp.load(name).problem()
    law = QPController().build(given)
    assert isinstance(law, QPLaw)
    state = law.start()
    for tick in range(200):
        state.update()
        kept = record(law, state, tick)
        assert kept.status == "OPTIMAL"
        assert explain(kept).missed == ()
        state.q += given.dt * law.command.v
        state.t += given.dt


def test_task_that_damping_or_weights_keep_back_blames_no_limit(chain: ClosedChain) -> None:
    """Two goals for one point: one of them must be missed, with all limits far away."""
    tasks = [
        PointOnPoint(name="here", goal=NEAR, profile=STEP, gain=0.5),
        PointOnPoint(name="there", goal=(0.18, -0.01, 0.04), profile=STEP, gain=0.5),
    ]
    found = explain(first_tick(chain, *tasks))
    assert len(found.missed) >= 3
    assert found.relaxations == ()
    assert "limit" not in found.sentence


def test_a_tick_that_failed_is_explained_as_well(chain: ClosedChain) -> None:
    """With hold, the impossible hard task leaves v = 0 and a record that says why."""
    kept = first_tick(chain, replace(POSE, mode="hard"), on_infeasible="hold")
    assert not Status[kept.status].usable
    assert not np.any(kept.answer)
    assert len(explain(kept).impossible) == 2


# Records.


def records(compared: Comparison, law: QPLaw, chain: ClosedChain) -> dict[str, TickRecord]:
    everything = (*LIMITS, ObjectSpeed(linear=0.05), JointAcceleration(max=30.0))
    point = PointOnPoint(name="reach", goal=NEAR, profile=STEP)
    return {
        "late": record(law, at(compared, law, 250), 250),
        "early": record(law, at(compared, law, 10), 10),
        "every limit": first_tick(chain, point, limits=everything),
        "no limit": first_tick(chain, point, limits=()),
        "hard": first_tick(chain, replace(point, mode="hard")),
        "scaled": first_tick(chain, replace(point, mode="scaled"), limits=everything),
        "impossible": first_tick(chain, POSE),
    }


KINDS = ("late", "early", "every limit", "no limit", "hard", "scaled", "impossible")
each_kind = pytest.mark.parametrize("kind", KINDS)


@each_kind
def test_record_comes_back_from_its_file_bit_for_bit(
    kind: str, compared: Comparison, law: QPLaw, chain: ClosedChain, tmp_path: Path
) -> None:
    kept = records(compared, law, chain)[kind]
    path = tmp_path / "tick.json"
    kept.save(path)
    again = TickRecord.read(path)
    assert again == kept
    for name in ("P", "q", "C", "lower", "upper"):
        np.testing.assert_array_equal(getattr(again.qp(), name), getattr(kept.qp(), name))
    assert explain(again) == explain(kept)
    json.loads(path.read_text(encoding="utf-8"), parse_constant=pytest.fail)  # no NaN, no Infinity


def test_record_is_the_program_that_the_law_solved(compared: Comparison, law: QPLaw) -> None:
    state = at(compared, law, 250)
    kept = record(law, state, 250)
    law.assemble(state)
    for name in ("P", "q", "C", "lower", "upper"):
        np.testing.assert_array_equal(getattr(kept.qp(), name), getattr(law.qp, name))
    assert kept.variables == list(state.chain.joint_names)
    assert kept.task_names == ["task[reach].x", "task[reach].y", "task[reach].z"]
    lower, upper = np.array(kept.lower[:10]), np.array(kept.upper[:10])
    for i, (low, high) in enumerate(zip(kept.lb_names, kept.ub_names, strict=True)):
        joint = state.chain.joint_names[i]
        slowest = -state.chain.velocity[i] == lower[i]
        assert low == f"limit.{'velocity' if slowest else 'position'}[{joint}].lower"
        fastest = state.chain.velocity[i] == upper[i]
        assert high == f"limit.{'velocity' if fastest else 'position'}[{joint}].upper"


SOLVERS: dict[str, Solver] = {
    "daqp": Daqp(),
    "osqp": Osqp(),
    "proxqp": Proxqp(),
    "quadprog": Qpsolvers(backend="quadprog"),
}


@pytest.mark.parametrize("solver", SOLVERS.values(), ids=SOLVERS.keys())
@each_kind
def test_replay_gives_the_same_motion_with_every_solver(
    kind: str, solver: Solver, compared: Comparison, law: QPLaw, chain: ClosedChain
) -> None:
    """Against quadprog, asked directly; the status tells nothing but small differences apart."""
    kept = records(compared, law, chain)[kind]
    qp = kept.qp()
    expected = qpsolvers.solve_qp(
        qp.P, qp.q, qp.G if qp.p else None, qp.h if qp.p else None, qp.A, qp.b,
        np.maximum(qp.lb, -1e6), np.minimum(qp.ub, 1e6), solver="quadprog",
    )  # fmt: skip
    found = replay(kept, solver)
    assert found.status in (Status.OPTIMAL, Status.INACCURATE)
    assert found.primal_residual < 1e-7
    np.testing.assert_allclose(found.v, expected, atol=1e-5)
    assert found.difference == pytest.approx(
        np.abs(found.v - np.array(kept.first_answer)).max(), abs=1e-15
    )


def test_replay_repeats_a_tick_without_a_secondary_exactly(chain: ClosedChain) -> None:
    """The saved answer is the answer: difference 0, status as saved."""
    for mode in ("soft", "hard", "scaled"):
        task = PointOnPoint(name="reach", goal=NEAR, profile=STEP, mode=mode)
        kept = first_tick(chain, task)
        again = replay(kept, Daqp())
        assert again.difference < 1e-12
        assert again.status.name == kept.status


def test_replay_repeats_a_tick_with_a_secondary(compared: Comparison, law: QPLaw) -> None:
    """On the way, where joint centring moves the arms."""
    assert replay(record(law, at(compared, law, 50), 50), Daqp()).difference < 1e-9


def test_replay_of_an_impossible_tick_reports_the_failure(chain: ClosedChain) -> None:
    kept = first_tick(chain, replace(POSE, mode="hard"))
    assert kept.status == "TASKS_GIVEN_UP"
    for solver in SOLVERS.values():
        assert not replay(kept, solver).status.usable


def test_replay_checks_against_the_budget_of_the_run(chain: ClosedChain) -> None:
    """Rounding alone breaks a budget of 1e-30."""
    point = PointOnPoint(name="reach", goal=NEAR, profile=STEP)
    strict = first_tick(chain, point, budget=Budget(equality=1e-30))
    assert replay(strict, Daqp()).status is Status.EQUALITY_RESIDUAL
    assert replay(replace(strict, budget=Budget()), Daqp()).status is Status.OPTIMAL


def test_recording_a_stop_keeps_the_memory_from_before_the_tick(chain: ClosedChain) -> None:
    """The state that the tick began with had not stopped yet."""
    law = build(problem(chain, replace(POSE, mode="hard"), on_infeasible="stop"))
    kept = record(law, law.start())
    assert kept.memory == [0.0]


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "[1, 2]", "null", "3", '"tick"', "{}", '{"tick": 3}', "\x00\x01"],
    ids=repr,
)
def test_file_that_is_no_record_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "tick.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CoopqpError, match="is not a tick saved by"):
        TickRecord.read(path)


def test_binary_missing_and_unreadable_files_are_refused(tmp_path: Path) -> None:
    binary = tmp_path / "binary.json"
    binary.write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(CoopqpError, match="is not a tick saved by"):
        TickRecord.read(binary)
    with pytest.raises(CoopqpError, match="cannot be read: No such file"):
        TickRecord.read(tmp_path / "none.json")
    with pytest.raises(CoopqpError, match="cannot be read: Is a directory"):
        TickRecord.read(tmp_path)


@pytest.fixture
def saved(chain: ClosedChain, tmp_path: Path) -> Path:
    path = tmp_path / "tick.json"
    first_tick(chain, PointOnPoint(name="reach", goal=NEAR, profile=STEP)).save(path)
    return path


@pytest.mark.parametrize("name", [field.name for field in fields(TickRecord)])
def test_record_with_a_field_missing_is_refused(name: str, saved: Path) -> None:
    data = json.loads(saved.read_text(encoding="utf-8"))
    del data[name]
    saved.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(CoopqpError, match="is not a tick saved by"):
        TickRecord.read(saved)


def test_truncated_or_extended_record_is_refused(saved: Path) -> None:
    text = saved.read_text(encoding="utf-8")
    for broken in (text[: len(text) // 2], text[:-3], text.rstrip()[:-1] + ', "more": 1}'):
        saved.write_text(broken, encoding="utf-8")
        with pytest.raises(CoopqpError, match="is not a tick saved by"):
            TickRecord.read(saved)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("P", "large"),
        ("P", [[1.0]]),
        ("C", [[0.0, 1.0]]),
        ("lower", [None]),
        ("q_cost", [1.0]),
        ("J", [[1.0, 2.0, 3.0]]),
        ("wanted", "up"),
        ("variables", 10),
        ("damping", "little"),
        ("answer", []),
        ("lb_names", []),
    ],
    ids=lambda value: repr(value)[:20],
)
def test_record_with_rubbish_in_a_field_is_refused(field: str, value: Any, saved: Path) -> None:
    data = json.loads(saved.read_text(encoding="utf-8"))
    data[field] = value
    saved.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(CoopqpError):
        TickRecord.read(saved)


# Traces read back.


@pytest.mark.parametrize("tick", [0, 1, 57, 150, 299])
def test_tick_of_a_written_trace_is_done_again_bit_for_bit(
    tick: int, trace_csv: Path, compared: Comparison, scenario: Scenario
) -> None:
    """A new law, the state from the file: the command of the run."""
    law = scenario.controllers["qp"].build(scenario.problem())
    assert isinstance(law, QPLaw)
    state = state_from_trace(trace_csv, "qp", tick, law)
    trace = compared.traces["qp"]
    assert state.t == trace.t[tick]
    np.testing.assert_array_equal(state.q, trace.q[tick])
    np.testing.assert_array_equal(state.v, trace.v[tick - 1] if tick else np.zeros(10))
    command = law.tick(state)
    np.testing.assert_array_equal(command.v, trace.v[tick])
    assert command.status.name == trace.status[tick]


@pytest.mark.parametrize("tick", [0, 30, 80])
def test_trace_with_acceleration_limits_and_shares_is_done_again(
    tick: int, scenario: Scenario, tmp_path: Path
) -> None:
    """Acceleration limits look at the velocity of the tick before."""
    limits = (*LIMITS, JointAcceleration(max=20.0))
    tasks = (replace(scenario.tasks[0], mode="scaled"),)
    given = replace(scenario, limits=limits, tasks=tasks, duration=2.0, source="")
    done = compare(given, controllers=["qp"])
    files.write(done, tmp_path)
    law = given.controllers["qp"].build(given.problem())
    assert isinstance(law, QPLaw)
    command = law.tick(state_from_trace(tmp_path / "trace.csv", "qp", tick, law))
    np.testing.assert_array_equal(command.v, done.traces["qp"].v[tick])
    assert command.scale == done.traces["qp"].scale[tick]


def test_explanation_from_the_file_is_that_of_the_run(
    trace_csv: Path, compared: Comparison, law: QPLaw
) -> None:
    from_file = record(law, state_from_trace(trace_csv, "qp", 250, law), 250)
    assert from_file == record(law, at(compared, law, 250), 250)


def test_trace_names_its_controllers(trace_csv: Path) -> None:
    assert controllers_of(trace_csv) == ["qp", "pseudoinverse"]


def test_tick_worth_explaining_is_the_first_that_gave_something_up(
    trace_csv: Path, scenario: Scenario, tmp_path: Path
) -> None:
    """Else the last."""
    assert blocked_tick(trace_csv, "qp") == 299
    slow = replace(scenario, limits=(*LIMITS, JointAcceleration(max=10.0)), source="")
    done = compare(slow, controllers=["qp"])
    files.write(done, tmp_path)
    fine = ("OPTIMAL", "INACCURATE")
    first = next(k for k, s in enumerate(done.traces["qp"].status) if s not in fine)
    assert blocked_tick(tmp_path / "trace.csv", "qp") == first


@pytest.mark.parametrize("tick", [-1, 300, 100_000])
def test_tick_that_the_run_did_not_have_is_refused(tick: int, trace_csv: Path, law: QPLaw) -> None:
    with pytest.raises(InvalidValueError, match=f"has no tick {tick}; it has 0 to 299"):
        state_from_trace(trace_csv, "qp", tick, law)


def test_files_that_are_no_traces_are_refused(tmp_path: Path) -> None:
    other = tmp_path / "other.csv"
    other.write_text("a,b\n1,2\n", encoding="utf-8")
    with pytest.raises(CoopqpError, match=r"is not a trace\.csv"):
        controllers_of(other)
    with pytest.raises(CoopqpError, match="cannot be read: No such file"):
        controllers_of(tmp_path / "none.csv")


@pytest.mark.parametrize("wrong", ["file", "controller"])
def test_tick_of_nothing_is_refused(wrong: str, trace_csv: Path, tmp_path: Path) -> None:
    path = tmp_path / "none.csv" if wrong == "file" else trace_csv
    with pytest.raises(CoopqpError):
        blocked_tick(path, "nobody" if wrong == "controller" else "qp")


def test_state_from_a_missing_trace_is_refused(tmp_path: Path, law: QPLaw) -> None:
    with pytest.raises(CoopqpError):
        state_from_trace(tmp_path / "none.csv", "qp", 0, law)


def test_relaxations_are_listed_from_the_largest(compared: Comparison, law: QPLaw) -> None:
    found = explain(record(law, at(compared, law, 250), 250)).relaxations
    assert isinstance(found[0], Relaxation)
    assert [r.amount for r in found] == sorted((r.amount for r in found), reverse=True)
