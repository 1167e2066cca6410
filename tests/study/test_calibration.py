"""The errors of a model that a run's measured joints tell, against those that were put in."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from chains import three_arms
from command_line import refused, refused_in_one_line, typed
from scenario_files import HEAD, PHASES, TAIL, cut, phased

import coopqp
from coopqp.base.errors import InvalidValueError
from coopqp.base.rank import null_space
from coopqp.base.spec import Array
from coopqp.execution.comparison import summarize
from coopqp.execution.rollout import rollout
from coopqp.grasps import Revolute, Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.plant import Disturbance, Plant
from coopqp.plants import Kinematic, Mujoco, RigidBody
from coopqp.plants._true_chain import true_chain
from coopqp.report import files
from coopqp.scenario.scenario import Scenario
from coopqp.study.calibration import Calibration, calibrate
from coopqp.study.trace_file import measured_run
from coopqp.trace import Trace

GRASP = Disturbance(grasp_offset=2e-3, grasp_offset_angle=5e-3)
NOISE = 1e-4  # rad
SHORT = """\
robot: nao_t14
object: {size: [0.08, 0.19, 0.08], mass: 0.2}
start: {right: [0.7, -0.2, 1.2, 0.9, 0.1], left: [0.7, 0.2, -1.2, -0.9, -0.1]}
tasks:
  - point_on_point: {name: reach, goal: [0.17, 0.01, 0.06], gain: 5, profile: {duration: 0.4}}
duration: 0.6
controllers: [qp]
dt: 0.01
"""


def true_offsets(model: ClosedChain, true: ClosedChain) -> Array:
    """Shift and turn of the object in each hand but the first, where it stays in the first."""
    first, *others = (arm.name for arm in model.arms[: model.holding])
    found = []
    for arm in others:
        X = true.hold.X_EO[arm] * true.hold.X_EO[first].inverse() * model.hold.X_EO[first]
        off = model.hold.X_EO[arm].inverse() * X
        found += [*off.translation, *pin.log3(off.rotation)]
    return np.array(found)


def values(found: Calibration) -> Array:
    return np.array([offset.value for offset in found.offsets])


def drawn(chain: ClosedChain, rng: np.random.Generator) -> ClosedChain:
    """The object some millimetres and milliradians elsewhere in every hand."""
    X_EO = {
        arm: X * pin.SE3(pin.exp3(5e-3 * rng.normal(size=3)), 3e-3 * rng.normal(size=3))
        for arm, X in chain.hold.X_EO.items()
    }
    true = ClosedChain(replace(chain.hold, X_EO=X_EO))
    return true.moved(closed_start(true))


def closed_start(chain: ClosedChain) -> Array:
    state = State(chain)
    state.close_loops(20)
    return state.q.copy()


def readings(true: ClosedChain, count: int = 60) -> Array:
    """A smooth way along the loops, which turns."""
    state, found = State(true), []
    ways = np.random.default_rng(3).normal(size=(2, true.n))
    for angle in np.linspace(0.0, 3.0, count):
        free = null_space(state.J_rel)
        state.q += 1.2 / count * free @ (free.T @ (np.array([np.cos(angle), np.sin(angle)]) @ ways))
        state.update()
        state.close_loops(4)
        found.append(state.q.copy())
    return np.array(found)


@pytest.fixture(scope="module")
def three() -> ClosedChain:
    return three_arms()


def test_where_three_arms_hold_the_object_is_found_exactly(
    three: ClosedChain, rng: np.random.Generator
) -> None:
    true = drawn(three, rng)
    found = calibrate(three, readings(true))
    np.testing.assert_allclose(values(found), true_offsets(three, true), atol=1e-9)
    np.testing.assert_allclose(true_offsets(three, found.chain), values(found), atol=1e-12)
    assert found.explains
    assert found.hidden == 0
    assert found.chain.hold.X_EO["right"] == three.hold.X_EO["right"]


def test_standard_deviations_are_those_of_the_estimates(rng: np.random.Generator) -> None:
    """Over many draws of noise the estimates scatter as each of them says."""
    three = three_arms()
    true = drawn(three, rng)
    q = readings(true, 40)
    found = [calibrate(three, q + rng.normal(0.0, NOISE, q.shape)) for _ in range(25)]
    off = np.array([values(f) - true_offsets(three, true) for f in found])
    said = np.array([[offset.deviation for offset in f.offsets] for f in found])
    assert np.sqrt(np.mean((off / said) ** 2)) == pytest.approx(1.0, abs=0.25)


def test_encoders_do_not_pass_for_a_grasp(three: ClosedChain, rng: np.random.Generator) -> None:
    """What the model says with the offsets found holds where it was not looked at."""
    offsets = rng.choice([-5e-3, 5e-3], three.n)
    q = readings(three, 120) + offsets
    seen, unseen = q[:80], q[80:]
    assert calibrate(three, seen).explains is False
    found = calibrate(three, seen, encoders=True)
    assert found.explains
    o = values(found)[12:]
    assert found.chain.n == len(o)
    np.testing.assert_allclose(_loops(found.chain, unseen - o), 0.0, atol=1e-8)
    shown = np.array([np.isfinite(offset.deviation) for offset in found.offsets[12:]])
    assert 0 < shown.sum() < len(o)
    np.testing.assert_allclose(o[shown], offsets[shown], atol=1e-7)


def _loops(chain: ClosedChain, q: Array) -> Array:
    return np.array([State(chain, row).loop_error for row in q])


def test_standing_still_tells_one_pose_and_no_encoder(
    three: ClosedChain, rng: np.random.Generator
) -> None:
    true = drawn(three, rng)
    q = true.q_start + rng.normal(0.0, NOISE, (50, true.n))
    found = calibrate(three, q)
    assert found.explains is None
    np.testing.assert_allclose(values(found), true_offsets(three, true), atol=2e-4)
    still = calibrate(three, q, encoders=True)
    assert still.hidden >= len(still.offsets) - 12  # twelve rows are all that one pose has


def run(scenario: Scenario) -> tuple[Trace, Calibration]:
    trace = coopqp.run(scenario, controller="qp")
    one = isinstance(scenario.plant, Kinematic)
    return trace, calibrate(scenario.chain, trace.measured[: 1 if one else None])


def loop_offset(trace: Trace) -> Array:
    return np.linalg.norm(trace.loop_offset[-1].reshape(2, 3), axis=1)


FIRM, HINGE = Rigid(), Revolute(point=(0.0, 0.0, 0.02))


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("plant", "grasp"),
    [
        (Kinematic(), FIRM),
        (Kinematic(), HINGE),
        (RigidBody(time_step=0.002), FIRM),
        (RigidBody(time_step=0.002), HINGE),
        (Mujoco(time_step=0.001), FIRM),
    ],
    ids=["kinematic", "kinematic, hinges", "rigid_body", "rigid_body, hinges", "mujoco"],
)
def test_with_what_a_run_tells_the_loop_offset_is_gone(
    plant: Plant, grasp: Rigid | Revolute, tmp_path: Path
) -> None:
    """The same robot with the same errors again, and a law that knows what was found."""
    if isinstance(plant, Mujoco):
        pytest.importorskip("mujoco")
    wrong = GRASP if isinstance(plant, Kinematic) else replace(GRASP, noise_position=NOISE)
    scenario = replace(phased(tmp_path, SHORT), plant=plant, grasps=grasp, disturbance=wrong)
    trace, found = run(scenario)
    expected = true_offsets(scenario.chain, true_chain(scenario.chain, scenario.seed, wrong))
    np.testing.assert_allclose(values(found)[:3], expected[:3], atol=2e-5)
    np.testing.assert_allclose(values(found)[3:], expected[3:], atol=2e-4)
    problem = scenario.problem()
    law = scenario.controllers["qp"].build(replace(problem, chain=found.chain))
    real = plant.build(problem, scenario.seed, wrong)
    again = rollout(law, real, scenario.ticks, controller="qp", solver=None)
    assert (loop_offset(trace) > [1e-3, 5e-3]).all()
    assert (loop_offset(again) < 0.1 * loop_offset(trace)).all()


def written(folder: Path, scenario: Scenario) -> Path:
    trace = coopqp.run(scenario, controller="qp")
    files.write(summarize(scenario, {"qp": trace}), folder)
    return folder


WRONG = "disturbance: {grasp_offset: 0.002, grasp_offset_angle: 0.005, noise_position: 0.0001}\n"


def test_lines_can_be_pasted_into_the_scenario(tmp_path: Path) -> None:
    text = SHORT + "plant: rigid_body\n" + WRONG
    hinge = "grasps: {right: rigid, left: {revolute: {axis: [0, 1, 1], lower: -1.0}}}\n"
    scenario = phased(tmp_path, text + hinge)
    out = written(tmp_path / "out", scenario)
    done = typed("calibrate", str(out))
    assert done.exit_code == 0
    assert "left.hinge: its reading is taken for true" in done.output
    assert "warning" not in done.output
    lines = done.output[done.output.index("\ngrasps:") :]
    rest = "".join(line for line in text.splitlines(True) if not line.startswith("start:"))
    (tmp_path / "pasted.yaml").write_text(rest + lines, encoding="utf-8")
    assert typed("validate", str(tmp_path / "pasted.yaml")).exit_code == 0
    chain = coopqp.load(tmp_path / "pasted.yaml").chain
    found = calibrate(scenario.chain, measured_run(out / "trace.csv", scenario)[1])
    assert chain.grasps["left"].lower == -1.0
    np.testing.assert_allclose(true_offsets(scenario.chain, chain), values(found), atol=1e-6)
    np.testing.assert_allclose(chain.q_start, found.chain.q_start, atol=1e-7)


def test_what_the_grasp_does_not_explain_is_warned_of(tmp_path: Path) -> None:
    wrong = "disturbance: {encoder_offset: 0.005}\nplant: rigid_body\n"
    out = written(tmp_path / "out", phased(tmp_path, SHORT + wrong))
    done = typed("calibrate", str(out))
    assert "links or encoders (try --encoders)" in done.output
    told = json.loads(typed("calibrate", str(out), "--json").output)
    assert told["explains"] is False
    done = typed("calibrate", str(out), "--encoders")
    assert "warning" not in done.output
    assert "The motion does not show 3 combinations of" in done.output
    assert "not shown" in done.output


def test_only_the_grasp_of_the_start_counts(tmp_path: Path) -> None:
    """A hand that has let go takes hold otherwise."""
    scenario = phased(tmp_path, HEAD + PHASES + TAIL + "plant: rigid_body\n" + WRONG)
    scenario = cut(scenario, 20)
    out = written(tmp_path / "out", scenario)
    _, q = measured_run(out / "trace.csv", scenario)
    assert len(q) == 20
    wrong = true_chain(scenario.chain, scenario.seed, scenario.disturbance)
    expected = true_offsets(scenario.chain, wrong)
    np.testing.assert_allclose(values(calibrate(scenario.chain, q)), expected, atol=3e-4)


def test_one_arm_alone_and_too_few_ticks_are_refused(three: ClosedChain) -> None:
    alone = three.handed_over(three.q_start, ["left", "middle"])
    with pytest.raises(InvalidValueError, match="one arm holds"):
        calibrate(alone, np.tile(three.q_start, (20, 1)))
    with pytest.raises(InvalidValueError, match="found 3 measured ticks, needs at least 10"):
        calibrate(three, np.tile(three.q_start, (3, 1)))
    with pytest.raises(InvalidValueError, match="hands are where the model says"):
        calibrate(three, np.tile(three.q_start, (20, 1)))


def test_runs_that_tell_nothing_are_refused_in_one_line(tmp_path: Path) -> None:
    out = written(tmp_path / "out", phased(tmp_path, SHORT))
    other = SHORT.replace("robot: nao_t14", "robot: planar_pair").replace(", 0.9, 0.1]", "]")
    for arguments, message in (
        ((tmp_path / "nowhere",), "cannot be read"),
        ((out,), "nothing to calibrate: no sensors say where the joints are"),
        ((out, "--controller", "pq"), "qp"),
    ):
        assert message in refused_in_one_line("calibrate", *map(str, arguments))
    other = other.replace("-1.2, -0.9, -0.1]", "-1.2]")
    (out / "scenario.yaml").write_text(other, encoding="utf-8")
    assert "it is of another scenario" in refused("calibrate", str(out))
