"""Why a tick could not do what its tasks asked, and whether what it says is so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from example_limits import by_name
from kept_ticks import POSE, WIDE, at, first_tick, problem, record
from laws import DT, LIMITS, NEAR, STEP, UNREACHABLE, ticks
from scipy.optimize import linprog

import coopqp
from coopqp.controllers import QPController
from coopqp.execution.comparison import Comparison
from coopqp.limits import JointAcceleration, JointPosition, JointVelocity, ObjectSpeed
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.qp_law.law import QPLaw
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status, causes_of
from coopqp.study.explanation import Explanation, explain
from coopqp.tasks import Orientation, PointOnPlane, PointOnPoint

LATE = (150, 220, 299)
SLOW = ObjectSpeed(linear=0.02)
GOAL, GAIN, DURATION = np.array([0.10, -0.05, 0.04]), 5.0, 2.0  # of joint_limit_stress


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
def test_elbows_at_their_limits_are_named_with_the_least_relaxation_that_would_do(
    compared: Comparison, law: QPLaw, tick: int
) -> None:
    """They rest there in the trace.

    The limits widened by exactly what is said let loops and task hold; 1 % less, or without one of
    them, does not, and by the dual program no smaller sum does.
    """
    state, trace = at(compared, law, tick), compared.traces["qp"]
    found, physics = explain(record(law, state, tick)), Physics(state)
    slack = {relaxation.name: relaxation.amount for relaxation in found.relaxations}
    assert slack.keys() & {"limit.position[RElbowRoll].upper", "limit.position[LElbowRoll].lower"}
    assert all(relaxation.unit == "rad" for relaxation in found.relaxations)
    assert set(found.missed) <= {"task[reach].x", "task[reach].y", "task[reach].z"}
    assert found.missed
    assert found.impossible == ()
    for words in (*(r.words for r in found.relaxations), *found.missed):
        assert words in found.sentence
    # One tick knows no amount that would do.
    assert "(tried" not in found.sentence
    assert "more would" not in found.sentence
    assert not physics.holds({})
    assert physics.holds(slack)
    assert not physics.holds({name: 0.99 * amount for name, amount in slack.items()})
    for name in slack:
        assert by_name(trace.margins)[name][tick] < 1e-6
        assert not physics.holds({k: a for k, a in slack.items() if k != name})
    assert sum(slack.values()) / DT == pytest.approx(physics.least_relaxation(), rel=1e-6)
    amounts = [relaxation.amount for relaxation in found.relaxations]
    assert amounts == sorted(amounts, reverse=True)


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
    wider = ClosedChain.attach(
        replace(scenario.robot_model, model=model),
        chain.q_start,
        scenario.grasps,
        scenario.held,  # type: ignore[arg-type]
    )
    given = replace(scenario.problem(), chain=wider, budget=WIDE, tasks=(
        replace(scenario.tasks[0], mode="hard"),
    ))  # fmt: skip
    command = QPController().build(given).tick(state)
    assert command.status is Status.OPTIMAL
    physics = Physics(state)
    np.testing.assert_allclose(physics.A @ command.v, physics.b, atol=1e-6)
    assert (
        QPController().build(replace(given, chain=chain)).tick(state).status is Status.TASKS_RELAXED
    )


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


def test_object_speed_is_named_by_its_row_in_metres_as_the_audit_has_it(
    chain: ClosedChain,
) -> None:
    """Wanted along z is 5 times the way; the rest of 0.02 m/s is what must give."""
    x, y, z = State(chain).p_WO.tolist()
    task, limit = PointOnPoint(name="lift", goal=(x, y, z + 0.05), profile=STEP), SLOW
    found = explain(first_tick(chain, task, limits=(*LIMITS, limit)))
    (relaxation,) = found.relaxations
    assert relaxation.name == "limit.object_speed.z.upper"
    assert relaxation.amount == pytest.approx(5 * 0.05 - 0.02, abs=1e-6)
    assert relaxation.unit == "m/s"
    assert "rad" not in found.sentence
    q = np.tile(chain.q_start, (2, 1))
    assert relaxation.name in by_name(limit.margins(chain, q, np.zeros((1, chain.n)), DT))


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
    assert "the loops alone leave no motion along task[carry]." in found.sentence
    for name in found.impossible:
        assert name in found.sentence


def test_pose_that_hinges_allow_is_not_impossible() -> None:
    """The same pose with a hinge in each hand has all six motions."""
    hinged = load("passive_grasp_pose").problem()
    law = QPController().plain(replace(hinged, tasks=(replace(POSE, gain=5.0),), budget=WIDE))
    assert explain(record(law, law.start())).impossible == ()


@pytest.mark.parametrize("mode", ["soft", "hard", "scaled"])
def test_tick_that_misses_nothing_says_so(mode: str, chain: ClosedChain) -> None:
    """The object is where it shall be; or a hard or scaled task has room."""
    here = State(chain).p_WO.tolist()
    goal = tuple(here) if mode == "soft" else NEAR
    task = PointOnPoint(name="reach", goal=goal, profile=STEP, mode=mode)  # type: ignore[arg-type]
    found = explain(first_tick(chain, task))
    nothing = "every task row was met"
    assert found == Explanation((), (), (), nothing)


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["point_on_plane", "tilting_plane", "yeo_4_5"])
def test_ordinary_tick_meets_its_tasks(name: str) -> None:
    """No joint of these comes near a limit; all that is missing is what the damping costs."""
    given = coopqp.load(name).problem()
    law = QPController().plain(given)
    state = law.start()
    for tick, _ in enumerate(ticks(law, state, 200)):
        kept = record(law, state, tick)
        assert kept.status == "OPTIMAL"
        assert explain(kept).missed == ()


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
    assert not causes_of(kept.status)[0].usable
    assert not np.any(kept.answer)
    assert len(explain(kept).impossible) == 2


# Hard and scaled tasks that are not met in full


def blocked(chain: ClosedChain, mode: str) -> tuple[QPLaw, State]:
    """Two seconds after an unreachable task, beside soft ones that pull elsewhere."""
    far = PointOnPoint(name="far", goal=UNREACHABLE, mode=mode)  # type: ignore[arg-type]
    near = PointOnPoint(name="near", goal=NEAR)
    law = QPController().plain(
        problem(chain, near, far, Orientation(name="turn", rpy_deg=(20, 0, 20)))
    )
    state = law.start()
    for _ in ticks(law, state, 200):
        pass
    return law, state


@pytest.mark.parametrize("mode", ["hard", "scaled"])
def test_a_task_that_is_not_met_in_full_is_named_first_with_its_share(
    mode: str, chain: ClosedChain
) -> None:
    """The soft ones are missed as well, and are neither named nor blamed."""
    law, state = blocked(chain, mode)
    kept = record(law, state, 200)
    found = explain(kept)
    rows = [i for i, row in enumerate(kept.task_rows) if row.owner == "far"]
    got, wanted = (np.array(kept.J) @ kept.answer)[rows], np.array(kept.wanted)[rows]
    share = 1.0 - np.linalg.norm(got - wanted) / np.linalg.norm(wanted)
    assert kept.status == "TASKS_RELAXED"
    assert [(task.task, task.mode) for task in found.unmet] == [("far", mode)]
    assert found.unmet[0].share == pytest.approx(max(share, 0.0), abs=1e-9)
    assert found.sentence.startswith(f"{mode} task 'far' gets ")
    assert found.contradicting == ()
    assert {name.split("[")[1].split("]")[0] for name in found.missed} == {"near", "far", "turn"}
    assert "near" not in found.sentence
    assert "turn" not in found.sentence


def test_what_holds_a_hard_task_back_does_so_without_the_soft_ones(chain: ClosedChain) -> None:
    """The same is said of the same tick where nobody asks for them."""
    law, state = blocked(chain, "hard")
    kept = record(law, state, 200)
    hard = [i for i, row in enumerate(kept.task_rows) if row.owner == "far"]
    alone = replace(
        kept,
        J=[kept.J[i] for i in hard],
        wanted=[kept.wanted[i] for i in hard],
        task_rows=[kept.task_rows[i] for i in hard],
    )
    assert explain(kept).sentence == explain(alone).sentence
    assert explain(kept).holding == explain(alone).holding


@pytest.mark.parametrize("mode", ["hard", "scaled"])
def test_a_tick_in_which_hard_and_scaled_tasks_hold_speaks_of_the_soft_ones(
    mode: str, chain: ClosedChain
) -> None:
    task = PointOnPoint(name="reach", goal=NEAR, profile=STEP, mode=mode)  # type: ignore[arg-type]
    other = PointOnPoint(name="there", goal=(0.18, -0.01, 0.04), profile=STEP)
    found = explain(first_tick(chain, task, other))
    assert found.unmet == ()
    assert set(found.contradicting) == {"reach", "there"}


# Tasks against each other; what comes now and what next


@pytest.mark.parametrize("mode", ["soft", "hard"])
def test_tasks_that_ask_for_different_motions_are_named_and_not_the_loops(
    mode: str, chain: ClosedChain
) -> None:
    """One height asked for twice; the loops leave that motion."""
    z = float(State(chain).p_WO[2])
    tasks = [
        PointOnPlane(name=name, normal=(0, 0, 1), through=(0, 0, z + up), profile=STEP, mode=mode)  # type: ignore[arg-type]
        for name, up in (("low", -0.02), ("high", 0.02))
    ]
    beside = PointOnPlane(name="beside", normal=(0, 1, 0), through=(0, 0.01, 0), profile=STEP)
    found = explain(first_tick(chain, tasks[0], beside, tasks[1]))
    assert set(found.contradicting) == {"low", "high"}
    assert found.impossible == ()
    assert found.relaxations == ()
    assert "low and high ask for motions that rule each other out" in found.sentence
    assert "loops alone" not in found.sentence


def test_a_task_that_repeats_another_is_not_called_impossible(chain: ClosedChain) -> None:
    """Both are held up by the same speeds, and by nothing else."""
    task = PointOnPoint(name="dash", goal=NEAR, profile=STEP, gain=50.0)
    limits = (JointPosition(), JointVelocity(scale=0.01))
    found = explain(first_tick(chain, task, replace(task, name="again"), limits=limits))
    assert found.impossible == ()
    assert found.contradicting == ()
    assert {r.name.split("[")[0] for r in found.relaxations} == {"limit.velocity"}


def test_what_is_at_its_bound_comes_first_and_the_rest_is_said_to_come_next() -> None:
    """At a twentieth of the joints' speed some are at their limit and others near it."""
    slow = replace(
        load("point_on_point"), limits=(JointPosition(), JointVelocity(scale=0.05))
    ).problem()
    law = QPController().plain(slow)
    state = law.start()
    for _ in ticks(law, state, 80):
        pass
    kept = record(law, state, 80)
    found, v = explain(kept), np.array(kept.answer)
    now, coming = found.sentence.split("; the next limits would be ")
    names, most = law.problem.chain.joint_names, 0.05 * law.problem.chain.velocity
    assert {r.now for r in found.relaxations} == {True, False}
    for relaxation in found.relaxations:
        i = names.index(relaxation.name.removeprefix("limit.velocity[").split("]")[0])
        assert relaxation.now == (abs(abs(v[i]) - most[i]) < 1e-6)
        assert names[i] in (now if relaxation.now else coming)
        if relaxation.now and relaxation.name in found.holding:
            assert f"{relaxation.amount:.3g} rad/s short" in now


def test_a_tick_that_could_not_be_decided_says_its_status(chain: ClosedChain) -> None:
    """Zeros answer a state of NaNs, and mean nothing."""
    here = State(chain).p_WO.tolist()
    task = PointOnPoint(name="stay", goal=tuple(here), profile=STEP)
    kept = replace(first_tick(chain, task), status="NOT_FINITE")
    assert explain(kept).sentence == (
        "the tick stands still: the state or the answer has NaN or infinite values"
    )
