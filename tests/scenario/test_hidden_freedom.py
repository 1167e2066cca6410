"""Over-constrained loops in files: rounded values hide their freedom, and the notes say so."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from chains import HANDS, planar_pair, ring, stretched_pair, three_arms
from command_line import typed
from scenario_files import LOADABLE, write

from coopqp.base.errors import GraspError, ScenarioError
from coopqp.base.spec import Array, Pose
from coopqp.closed_loop.mobility import HiddenFreedom, hidden_freedom, mobility
from coopqp.execution.comparison import compare
from coopqp.grasps import Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.robot import RobotModel
from coopqp.robots import NaoT14
from coopqp.scenario.loader import load, load_and_solve
from coopqp.scenario.notes import notes
from coopqp.scenario.scenario import Scenario

#: Lengths a and b, twists alpha and beta with a / sin(alpha) = b / sin(beta).
BENNETT = """\
robot:
  mdh_table:
    rows:
      - {name: a1, lower: -3, upper: 3, velocity: 2}
      - {name: a2, antecedent: a1, d: 0.2, alpha_deg: 30, lower: -3, upper: 3, velocity: 2}
      - {name: a_tip, antecedent: a2, sigma: fixed, d: 0.4, alpha_deg: 90}
      - {name: b1, d: -0.4, alpha_deg: -90, lower: -3, upper: 3, velocity: 2}
      - {name: b2, antecedent: b1, d: -0.2, alpha_deg: -30, lower: -3, upper: 3, velocity: 2}
    arms: {a: a_tip, b: b2}
grasps:
  a: {rigid: {object_in_hand: {position: [0, 0, 0]}}}
  b: {rigid: {object_in_hand: {position: [0, 0, 0]}}}
object: {size: [0.05, 0.05, 0.05]}
START
tasks:
  - point_on_point:
      {name: reach, goal: [-0.449868196, 0, 0.193683151], gain: 5, profile: {duration: 1.5}}
controllers: [qp, pseudoinverse]
dt: 0.01
duration: 2.5
"""
#: tan(a2 / 2) of a closed linkage from tan(a1 / 2), by Bennett's equation.
RATIO = math.sin(math.radians(60.0)) / math.sin(math.radians(30.0))


def closed(first: float) -> Array:
    """All four joints where the first is given; opposite hinges turn alike."""
    second = 2.0 * math.atan2(RATIO, math.tan(0.5 * first))
    return np.array([first, second, second, first])


def bennett(folder: Path, digits: int, old: str = "", new: str = "") -> Path:
    """The linkage in a file, its start written with so many digits."""
    a1, a2, b1, b2 = np.round(closed(2.0012345678), digits).tolist()
    text = BENNETT.replace("START", f"start: {{a: [{a1}, {a2}], b: [{b1}, {b2}]}}")
    assert old in text
    return write(folder, text.replace(old, new) if old else text)


def found(scenario: Scenario) -> HiddenFreedom:
    hidden = hidden_freedom(scenario.chain)
    assert hidden is not None
    assert hidden.describe() in notes(scenario)
    return hidden


def reached(scenario: Scenario) -> dict[str, bool]:
    verdicts = compare(scenario).verdicts
    return {name: said.startswith("Reaches the goal") for name, said in verdicts.items()}


def test_the_start_is_closed_where_bennetts_equation_says(tmp_path: Path) -> None:
    chain = load(bennett(tmp_path, 15)).chain
    assert np.abs(chain.loop_error(closed(2.3))).max() < 1e-14
    assert mobility(chain).freedom == 1
    assert hidden_freedom(chain) is None


@pytest.mark.parametrize("digits", [3, 4, 5])
def test_a_rounded_start_hides_the_freedom_and_solve_start_finds_it(
    digits: int, tmp_path: Path
) -> None:
    path = bennett(tmp_path, digits)
    scenario = load(path)
    hidden = found(scenario)
    assert (hidden.rank, hidden.resisting) == (4, 3)
    assert hidden.start[0] == pytest.approx(
        np.linalg.norm(scenario.chain.loop_error(scenario.chain.q_start)[:3])
    )
    assert hidden.walk[0] < 1e-12
    assert "paste the start that `coopqp solve-start` prints" in hidden.describe()
    told = mobility(scenario.chain)
    assert told.freedom == 0
    assert "which may hide a freedom" in told.verdict()
    result = typed("solve-start", path)
    assert result.exit_code == 0
    pasted = load(write(tmp_path, BENNETT.replace("START", result.stdout)))
    assert np.abs(pasted.chain.q_start - scenario.chain.q_start).max() < 2.0 * 10.0**-digits
    again = mobility(pasted.chain)
    assert (again.freedom, again.freedom_start, again.object_freedom) == (1, 1, 1)
    assert again.hidden is None
    assert pasted.chain.loops.rank == 3


def test_with_the_solved_start_the_qp_reaches_as_the_pseudoinverse_does(tmp_path: Path) -> None:
    path = bennett(tmp_path, 4)
    assert reached(load(path)) == {"qp": False, "pseudoinverse": True}
    pasted = write(tmp_path, BENNETT.replace("START", typed("solve-start", path).stdout))
    assert reached(load(pasted)) == {"qp": True, "pseudoinverse": True}


def test_validate_and_mobility_print_it(tmp_path: Path) -> None:
    path = bennett(tmp_path, 4)
    told = typed("validate", path)
    assert told.exit_code == 0
    assert "note: the start closes the loops only to 0.0" in told.stderr
    shown = typed("mobility", path)
    assert shown.exit_code == 0
    assert "The start closes the loops only to 0.0" in " ".join(shown.stdout.split())


def test_grasps_taken_at_a_rounded_start_hide_it_too(tmp_path: Path) -> None:
    grasps = BENNETT[BENNETT.index("grasps:") : BENNETT.index("object:")]
    path = bennett(tmp_path, 4, grasps)
    hidden = found(load(path))
    assert hidden.taken == ("a", "b")
    assert "give object_in_hand in the grasp of a and b" in hidden.describe()
    with pytest.raises(ScenarioError, match="give object_in_hand in the grasp of a and b"):
        load_and_solve(path)


def test_where_lengths_are_rounded_solve_start_cannot_help(tmp_path: Path) -> None:
    path = bennett(tmp_path, 4, "d: 0.2, alpha_deg: 30", "d: 0.2, alpha: 0.5236")
    hidden = found(load(path))
    assert not hidden.of_the_start
    assert "solve-start cannot help" in hidden.describe()
    with pytest.raises(ScenarioError, match="no start near this one closes the loops exactly"):
        load_and_solve(path)


def test_a_rounded_pose_is_to_be_left_out(tmp_path: Path) -> None:
    """Arms of two joints reach no pose that is written with six digits."""
    chain = load(bennett(tmp_path, 15)).chain
    X_WO = chain.object_pose(chain.q_start)
    position = np.round(X_WO.translation, 6).tolist()
    rpy = np.round(pin.rpy.matrixToRpy(X_WO.rotation), 6).tolist()
    posed = f"object: {{pose: {{position: {position}, rpy: {rpy}}}, size"
    path = bennett(tmp_path, 4, "object: {size", posed)
    assert "prints with object.pose left out" in found(load(path)).describe()
    with pytest.raises(ScenarioError, match=r"the pose is rounded: leave object\.pose out"):
        load_and_solve(path)


def test_start_solve_closes_the_loops_near_start_near(tmp_path: Path) -> None:
    near = "start: solve\nstart_near: {a: [2.0012, 1.6754], b: [1.6754, 2.0012]}"
    scenario = load(write(tmp_path, BENNETT.replace("START", near)))
    assert np.abs(scenario.chain.loop_error(scenario.chain.q_start)).max() < 1e-12
    assert mobility(scenario.chain).freedom == 1


def test_a_start_that_closes_outside_the_limits_is_refused(tmp_path: Path) -> None:
    path = bennett(tmp_path, 4, "{name: a1, lower: -3, upper: 3", "{name: a1, lower: -3, upper: 1")
    with pytest.raises(ScenarioError, match="has a1 outside its limits"):
        load_and_solve(path)


# ---- no false alarms ---------------------------------------------------------------------------


@pytest.mark.few(10)
@pytest.mark.parametrize("name", LOADABLE)
def test_no_shipped_scenario_hides_a_freedom(name: str) -> None:
    assert hidden_freedom(load(name).chain) is None


def regrasped(robot: RobotModel, q: Array) -> dict[str, Rigid]:
    """Grasps that close exactly at q."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    tips = {arm.name: data.oMf[robot.model.getFrameId(arm.tip)] for arm in robot.arms}
    X_WO = pin.SE3(np.eye(3), np.mean([X.translation for X in tips.values()], axis=0))
    held = {arm: X.actInv(X_WO) for arm, X in tips.items()}
    return {
        arm: Rigid(
            object_in_hand=Pose(
                position=tuple(X.translation.tolist()),
                rpy=tuple(pin.rpy.matrixToRpy(X.rotation).tolist()),
            )
        )
        for arm, X in held.items()
    }


def mirrored() -> ClosedChain:
    robot = NaoT14().build()
    return ClosedChain.attach(robot, robot.configuration(HANDS), Rigid(), HeldObject())


CHAINS = {
    "planar": planar_pair,
    "stretched": stretched_pair,
    "mirrored": mirrored,
    "three": three_arms,
    "ring of 2 x 4": lambda: ring(2, 4),
    "ring of 2 x 5": lambda: ring(2, 5),
}


@pytest.mark.few(2)
@pytest.mark.parametrize("name", CHAINS)
def test_rounded_starts_of_other_loops_hide_nothing_even_near_singular_poses(
    name: str, rng: np.random.Generator
) -> None:
    chain, tried = CHAINS[name](), 0
    for q in [chain.q_start, *chain.sample(rng, 24)]:
        near = np.where(rng.random(chain.n) < 0.4, rng.choice([0.0, math.pi / 2], chain.n), q)
        near += rng.normal(size=chain.n) * 10.0 ** rng.uniform(-6, -2)
        for start, digits in ((q, 4), (near, 4), (near, 3)):
            given = regrasped(chain.robot, start)
            for grasps in (given, Rigid()):
                rounded = np.round(start, digits)
                try:
                    rough = ClosedChain.attach(chain.robot, rounded, grasps, HeldObject())
                except GraspError:
                    continue  # farther off than counts as closed
                tried += 1
                assert hidden_freedom(rough) is None
    assert tried > 90
