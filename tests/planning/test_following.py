"""Plans that are followed: found in one go, waited for, and through phases."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pinocchio as pin
import pytest
from command_line import typed
from scenario_files import needs_robots
from side_by_side import needs_kernel

import coopqp
from coopqp.assessment import assess
from coopqp.base.errors import InvalidValueError, ScenarioError
from coopqp.base.spec import spec
from coopqp.controller import Command, ControlProblem
from coopqp.execution.controller_run import run
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.online.loop import OnlineLoop
from coopqp.planning import Budget
from coopqp.planning.closed_space import ClosedSpace
from coopqp.planning.plan import plan
from coopqp.planning.time_along import TOLERATED, table_of_phases, time_phases
from coopqp.plant import Disturbance, Plant, PlantModel
from coopqp.plants.kinematic import KinematicModel
from coopqp.recordings import read
from coopqp.report.files import write
from coopqp.report.planning import write_plan, write_timed
from coopqp.scenario.input import BRAKES, STANDS
from coopqp.scenario.loader import load, load_text
from coopqp.scenario.notes import notes
from coopqp.scenario.scenario import Scenario
from coopqp.signal import quaternion_of
from coopqp.signals import Waypoints
from coopqp.study.trace_file import off_the_record, recorded_tick
from coopqp.tasks import Pose
from coopqp.trace import Trace

pytestmark = [needs_kernel, needs_robots]

AMPLE = Budget(seconds=60.0)


def in_one_go(name: str, **keys: object) -> Scenario:
    """A shipped scenario with ``reference: {plan: true}``."""
    shipped = load(name)
    said = ", ".join(f"{key}: {value}" for key, value in {"plan": "true", **keys}.items())
    text = f"{shipped.source}\nreference: {{{said}}}\n"
    return load_text(Path(f"{name}.yaml"), text, shipped.catalog)


@spec
class Shoved(Plant):
    """Joints that follow commands exactly, and are shoved along closed loops for a while."""

    takes_torques: ClassVar[bool] = False
    start: float
    """When [s]."""
    duration: float
    """For how long [s]."""
    speed: float
    """Of one joint of each arm before the loops are closed [rad/s]."""

    def build(self, problem: ControlProblem, seed: int, disturbance: Disturbance) -> PlantModel:
        return _ShovedModel(problem, self)


class _ShovedModel(KinematicModel):
    ideal = False

    def __init__(self, problem: ControlProblem, settings: Shoved) -> None:
        super().__init__(problem.dt)
        self._settings, self._t, self._space = settings, 0.0, ClosedSpace(problem)
        self._step = settings.speed * problem.dt * (np.arange(problem.chain.n) % 7 == 0)

    def step(self, state: State, command: Command) -> None:
        super().step(state, command)
        begun, self._t = self._t - self._settings.start, state.t
        if 0.0 <= begun < self._settings.duration:
            q = (state.q + self._step)[None]
            assert self._space.project(q)[0]
            state.q[:] = q[0]


def astray(trace: Trace) -> np.ndarray:
    """Distance of the joints from their reference at each instant of the way [rad]."""
    column = [task.name for task in trace.tasks].index("way.planned joints")
    return trace.task_error[trace.tasks[column].rows, column]


@pytest.mark.parametrize(
    ("reference", "words"),
    [
        ("{plan: true, late: 1.0e+9}", r"reference.late: found \d+ ticks, more than are kept"),
        ("{plan: false}", "reference.plan: found false; needs a path or true"),
    ],
)
def test_a_plan_that_cannot_be_followed_is_refused_at_its_own_key(
    reference: str, words: str
) -> None:
    shipped = load("planar_pair")
    with pytest.raises(ScenarioError, match=words):
        load_text(Path("a.yaml"), f"{shipped.source}\nreference: {reference}\n", shipped.catalog)


def test_a_plan_in_one_go_is_the_plan_of_the_command_followed(tmp_path: Path) -> None:
    scenario = load("planar_pair")
    _, path = write_plan(plan(scenario, budget=AMPLE), scenario, tmp_path)
    first, second, filed = in_one_go("planar_pair"), in_one_go("planar_pair"), load(path)
    assert first.phases == second.phases  # by the scenario's seed
    assert [phase.name for phase in first.schedule] == ["way", "goal"]
    runs = [coopqp.run(one, controller="qp", timed=False) for one in (first, second, filed)]
    np.testing.assert_array_equal(runs[0].q, runs[1].q)
    np.testing.assert_allclose(runs[0].q, runs[2].q, atol=1e-9)  # of 12 digits in the file
    assert assess(runs[0]).reached


def test_where_no_way_is_found_the_file_is_refused_at_its_line() -> None:
    with pytest.raises(ScenarioError) as caught:
        in_one_go("shelves", seconds=1e-3)
    (fault,) = caught.value.faults
    assert fault.place.startswith("shelves.yaml:")
    assert "reference: not found in" in str(fault)
    assert "it had 'seconds: 0.001'" in str(fault)
    with pytest.raises(ScenarioError, match="round: its goal moves by a signal"):
        in_one_go("pr2_circle")
    with pytest.raises(ScenarioError, match="plan"):
        in_one_go("planar_pair", plan="false")


@pytest.mark.few(1)
@pytest.mark.parametrize(("name", "speed"), [("shelves", 4.0), ("two_pandas", -4.0)])
def test_pushed_off_a_run_goes_on_where_it_has_left_the_path(name: str, speed: float) -> None:
    calm = in_one_go(name)
    lasts = calm.schedule[0].duration - 2.0
    at, shove = 0.5 * lasts, 0.2  # where no arm is shoved into the board
    pushed = replace(calm, plant=Shoved(start=at, duration=shove, speed=speed))
    undisturbed, trace = (coopqp.run(one, controller="qp") for one in (calm, pushed))
    assert (undisturbed.inputs["way"].rate[: int(lasts / calm.dt)] == 1.0).all()
    clock, off = trace.inputs["way"], astray(trace)
    gone = round((at + shove) / calm.dt)
    assert np.abs(trace.q[gone] - undisturbed.q[gone]).max() > STANDS
    assert clock.rate[gone : gone + 20, 0].min() < 0.5  # it waits
    assert off[gone + 20] > 3.0 * astray(undisturbed).max()
    assert off[gone + 100 :].max() <= astray(undisturbed).max()  # as near as if never pushed
    held = slice(None, calm.schedule[0].ticks(calm.dt))
    tau, pace = clock.value[held, 0], clock.rate[held, 0]
    np.testing.assert_allclose(np.diff(tau), calm.dt * pace[:-1], atol=1e-12)
    assert np.abs(np.diff(pace)).max() <= calm.dt / BRAKES + 1e-12  # and never jumps
    assert tau[-1] > lasts - 1e-9
    assert min(margin.min() for margin in trace.margins.values()) > -1e-9
    found = assess(trace)
    assert found.reached
    assert found.succeeds
    np.testing.assert_allclose(trace.q[held][-1], undisturbed.q[held][-1], atol=1e-3)


@pytest.mark.full
@pytest.mark.few(1)
@pytest.mark.parametrize("share", [0.3, 0.1])
def test_shoved_into_the_board_a_run_leaves_it_tick_by_tick_and_says_so(share: float) -> None:
    """Who shoves knows no board; the law comes out of it, and the run goes back to its path."""
    calm = in_one_go("shelves")
    lasts = calm.schedule[0].duration - 2.0
    at, shove = share * lasts, 0.2
    pushed = replace(calm, plant=Shoved(start=at, duration=shove, speed=4.0))
    ran = coopqp.compare(pushed, controllers=["qp"])
    trace, gone = ran.traces["qp"], round((at + shove) / calm.dt)
    least = np.min(list(trace.margins.values()), axis=0)
    deepest = int(least.argmin())
    assert deepest == gone - 1  # the last tick of the shove
    assert least[deepest] < -0.01
    (out,) = np.nonzero(least[deepest:] >= 0.0)
    assert (np.diff(least[deepest : deepest + out[0] + 1]) > 0.0).all()
    assert out[0] <= 10
    assert least[deepest + out[0] :].min() > -1e-9
    undisturbed = coopqp.run(calm, controller="qp")
    assert astray(trace)[gone + 100 :].max() <= astray(undisturbed).max()
    assert assess(trace).reached
    said = f"brings left/panda_link5 {-1e3 * least[deepest]:.2g} mm closer to board than allowed"
    assert said in ran.verdicts["qp"]


def test_a_clock_that_no_posture_follows_is_told_of() -> None:
    shipped = load("two_pandas")
    pose = shipped.chain.object_pose(shipped.chain.q_start)
    there = [*pose.translation, *quaternion_of(pose.rotation)]
    goal = Waypoints(times=[0.0, 1.0], values=[there, there], clock="mine")
    said = notes(replace(shipped, tasks=(Pose(goal=goal, profile=Profile(kind="step")),)))
    assert "the clock 'mine' waits for nobody: no posture's way-points name it" in said
    assert not any("waits for nobody" in line for line in notes(in_one_go("planar_pair")))


def test_joints_that_are_held_for_good_are_told_of(tmp_path: Path) -> None:
    calm = in_one_go("planar_pair", late=0.5)
    held = replace(calm, plant=Shoved(start=0.3, duration=1e3, speed=6.0))
    said = coopqp.compare(held, controllers=["qp"]).verdicts["qp"]
    assert re.search(r"the joints are held back at 0\.\d\d of the [01]\.\d\d s of 'way'", said)


def test_a_regrasp_is_planned_through_and_followed(tmp_path: Path) -> None:
    scenario = load("regrasp")
    found = plan(scenario, budget=AMPLE)
    assert found.success
    np.testing.assert_array_equal(np.unique(found.phase), [1.0, 2.0, 3.0, 4.0])
    assert np.abs(np.diff(found.timed, axis=0)).max() < 0.1
    _, path = write_plan(found, scenario, tmp_path)
    follows = load(path)
    names = [phase.name for phase in follows.schedule]
    assert names[:4] == ["carry way", "carry", "let go way", "let go"]
    assert follows.schedule[2].released == ("right/arm",)
    trace = coopqp.run(follows, controller="qp")
    assert assess(trace).reached
    assert assess(trace).succeeds
    short = path.with_name("plan.csv")
    lines = short.read_text().splitlines()
    short.write_text("\n".join(line for line in lines if not line.endswith(",4")) + "\n")
    result = typed("validate", path)
    assert result.exit_code == 2
    assert "leads to 3 phases, and the scenario has 4" in result.output


@pytest.mark.full
def test_a_regrasp_is_timed_phase_by_phase_and_followed(tmp_path: Path) -> None:
    """Each with the arms that hold the object then, at rest at its ends, within its limits."""
    shipped = load("regrasp")
    text = shipped.source.replace("dt: 0.01 ", "dt: 0.004 ")
    scenario = load_text(Path("regrasp.yaml"), text, shipped.catalog)
    planned = plan(scenario, budget=AMPLE)
    write_plan(planned, scenario, tmp_path)
    follows = load(tmp_path / "regrasp.yaml")  # whose own ways are no phases to be timed
    parts = time_phases(tmp_path, follows)
    assert [len(part.path.chain.hold.holders) for part in parts] == [2, 1, 1, 2]
    assert all(part.exceeded < TOLERATED for part in parts)
    assert 0.5 * planned.t[-1] > sum(part.duration for part in parts) > 0.5
    table = table_of_phases(parts, scenario.dt)
    np.testing.assert_allclose(np.diff(table["t"]), scenario.dt)
    ends = np.flatnonzero(np.diff(table["phase"], append=5.0))
    for joint in scenario.chain.joint_names:
        assert not table[f"v[{joint}]"][ends].any()
    assert not table["squeeze"][table["phase"] == 2.0].any()
    *_, path, _ = write_timed(parts, [{}] * 4, follows, tmp_path / "fast")
    trace = coopqp.run(load(path), controller="qp")
    assert assess(trace).succeeds
    with pytest.raises(InvalidValueError, match="phase: found None, needs 0 to 3"):
        coopqp.time_along(tmp_path, follows)
    with pytest.raises(InvalidValueError, match=r"speed: found .* needs 0 at the ends of phases"):
        time_phases(tmp_path, follows, speed=(0.1, 0.0))


def test_a_phase_in_which_nothing_moves_is_held(tmp_path: Path) -> None:
    """The torques are those of the tree at rest; its object stands on the table."""
    shipped = load("pick_and_place")
    write_plan(plan(shipped, budget=AMPLE), shipped, tmp_path)
    still = coopqp.time_along(tmp_path, shipped, phase=2)
    assert still.duration == shipped.dt
    now = still.at(0.0)
    assert not now.v.any()
    assert not now.a.any()
    chain = still.path.chain
    weight = pin.computeGeneralizedGravity(chain.model, chain.model.createData(), now.q)
    box = 9.81 * shipped.held.mass
    at_hands = chain.loop_jacobian(now.q).T @ now.internal[1]
    assert np.abs(now.tau - weight + at_hands).max() < 2.0 * box


@pytest.mark.full
def test_of_an_object_that_stands_only_the_joints_are_planned(tmp_path: Path) -> None:
    shipped = load("pick_and_place")
    _, path = write_plan(plan(shipped, budget=AMPLE), shipped, tmp_path)
    scenario = load(path)
    for phase in scenario.phases[::2]:
        stands = len(phase.released) == 2
        assert ("planned object" in [task.name for task in phase.tasks]) != stands
    found = assess(coopqp.run(scenario, controller="qp"))
    assert not found.broken
    assert all(task.reached for task in found.tasks if " way." not in task.name)


def test_a_scenario_that_is_refused_with_its_plan_leaves_nothing(tmp_path: Path) -> None:
    shipped = load("planar_pair")
    way = plan(shipped, budget=AMPLE)
    with pytest.raises(ScenarioError, match="from the start of"):
        write_plan(replace(way, timed=way.timed + 0.2), shipped, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.full
def test_ticks_in_which_the_clock_waits_can_be_repeated(tmp_path: Path) -> None:
    held = replace(in_one_go("shelves"), plant=Shoved(start=2.0, duration=0.2, speed=4.0))
    write(coopqp.compare(held, controllers=["qp"]), tmp_path)
    run = read(tmp_path / "trace.csv")
    for tick in (10, 220):
        assert off_the_record(run, recorded_tick(run, held, "qp", tick)) < 1e-6
    assert run.columns["followed[way].t"][220] < 2.19


@pytest.mark.full
def test_a_tray_that_is_kept_level_is_so_on_the_way_round_a_beam(tmp_path: Path) -> None:
    scenario = load("tray_round_beam")
    alone = coopqp.run(scenario, controller="qp")
    assert not assess(alone).reached
    found = plan(scenario, keep=["level"], budget=AMPLE)
    _, path = write_plan(found, scenario, tmp_path, ["level"])
    follows = load(path)
    assert [task.mode for task in follows.schedule[0].tasks] == ["soft", "soft", "hard"]
    trace = coopqp.run(follows, controller="qp")
    assert assess(trace).succeeds
    tilt = np.arccos(np.clip(trace.rotation[:, 2, 2], -1.0, 1.0))
    assert tilt.max() < 1e-3
    way = np.linalg.norm(np.diff(trace.position, axis=0), axis=1).sum()
    assert way > 1.5 * np.linalg.norm(trace.position[-1] - trace.position[0])


def test_a_task_to_keep_has_to_be_there() -> None:
    with pytest.raises(ScenarioError, match="did you mean 'level'"):
        in_one_go("tray_round_beam", keep="[levl]")


def beside(shipped: Scenario, by: str) -> Scenario:
    """Laws alone, and one that follows a plan."""
    text = shipped.source.replace("pseudoinverse_null_space", "{qp: {name: planned}}")
    more = f"reference: {{plan: true, by: [{by}]}}\n"
    return load_text(Path("beside.yaml"), f"{text}\n{more}", shipped.catalog)


@pytest.mark.full
def test_laws_alone_stand_beside_the_one_that_follows_a_plan(tmp_path: Path) -> None:
    """The QP is stuck at the board, the pseudoinverse goes through it, the plan goes round."""
    scenario = beside(load("shelves"), "planned")
    names = ["qp", "pseudoinverse", "planned"]
    compared = coopqp.compare(scenario, controllers=names)
    alone, through, planned = (assess(compared.traces[name]) for name in names)
    assert not alone.reached
    assert not alone.broken
    assert "obstacles" in " ".join(through.broken)
    assert planned.succeeds
    assert len({len(one.trace.t) for one in (alone, through, planned)}) == 1
    paths = write(compared, tmp_path)
    assert "report.html" in [path.name for path in paths]
    run = read(tmp_path / "trace.csv")
    for name in ("qp", "planned"):
        assert off_the_record(run, recorded_tick(run, scenario, name, 300)) < 1e-6
    with pytest.raises(ScenarioError, match="did you mean 'planned'"):
        beside(load("shelves"), "planed")


@pytest.mark.few(1)
@pytest.mark.parametrize("elsewhere", [False, True])
def test_results_have_the_plan_that_was_followed(tmp_path: Path, elsewhere: bool) -> None:
    """Without the plan's folder; with another file's path the results stay on this machine."""
    scenario = load("planar_pair")
    if elsewhere:
        (tmp_path / "way.csv").write_text("t,target.x\n0,0.3\n")
        source = f"{scenario.source}\ninputs: {{unused: {{feed_file: way.csv}}}}\n"
        scenario = replace(scenario, source=source, folder=tmp_path)
    found = plan(scenario, budget=AMPLE)
    _, path = write_plan(found, scenario, tmp_path / "plan", keep=())
    followed = load_text(path, f"# kept\n{path.read_text()}", scenario.catalog)
    ran = coopqp.compare(followed, controllers=["qp"])
    out = write(ran, tmp_path / "results")[0].parent
    shutil.rmtree(tmp_path / "plan")
    again = load(out / "scenario.yaml")
    assert "# kept" in again.source
    assert (again.folder == tmp_path) == elsewhere
    one = run(again, controller="qp")
    np.testing.assert_array_equal(one.q, ran.traces["qp"].q)


def test_a_session_begun_beside_the_start_plays_its_plan_again(tmp_path: Path) -> None:
    scenario = load("planar_pair")
    _, path = write_plan(plan(scenario, budget=AMPLE), scenario, tmp_path / "plan")
    followed, chain = load(path), scenario.chain
    beside = chain.q_start[None] + 0.05 * np.random.default_rng(1).normal(size=(1, chain.n))
    assert ClosedSpace(scenario.problem()).project(beside)[0]
    assert 0.02 < np.abs(beside[0] - chain.q_start).max() < STANDS
    loop = OnlineLoop(followed, clock=None, out=tmp_path / "out")
    q = beside[0]
    went = []
    for _ in range(followed.ticks):
        loop.tick(q)
        went.append(loop.state.q.copy())
        q = loop.setpoint.copy()
    loop.close()
    shutil.rmtree(tmp_path / "plan")
    again = run(load(tmp_path / "out" / "scenario.yaml"), controller="qp")
    np.testing.assert_allclose(again.commanded, went, atol=1e-12)
    assert assess(again).tasks[-1].reached
