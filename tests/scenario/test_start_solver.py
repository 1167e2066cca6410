"""Start poses from the object's place: those that are there, and those that are not."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scenario_files import LOADABLE, needs_robots

from coopqp.base.errors import GraspError, UnknownNameError
from coopqp.base.spec import Array, Pose
from coopqp.grasp import Grasp
from coopqp.grasps import Prismatic, Revolute, Rigid, Spherical
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State
from coopqp.robot import Arm, RobotModel
from coopqp.robot_files import mdh
from coopqp.robots import NaoT14, PlanarPair
from coopqp.scenario.loader import load, load_and_solve, load_text
from coopqp.scenario.start import Start
from coopqp.scenario.start_solver import TRIES, StartSolution, solve_start

CLOSED = 1e-9  # loop error of a start [m, rad]
NEW = ("baxter_tray", "tiago_torso", "two_pandas", "three_ur", "yeo_4_5")
NEW_HERE = [name for name in NEW if name in LOADABLE]


def pose(X: pin.SE3) -> Pose:
    return Pose(
        position=tuple(X.translation.tolist()), rpy=tuple(pin.rpy.matrixToRpy(X.rotation).tolist())
    )


def tips(robot: RobotModel, q: Array) -> dict[str, pin.SE3]:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return {arm.name: data.oMf[robot.model.getFrameId(arm.tip)].copy() for arm in robot.arms}


def held_at(
    robot: RobotModel, q: Array, kind: type[Grasp] = Rigid, **keys: Any
) -> tuple[dict[str, Grasp], HeldObject]:
    """Grasps and object as they are where the robot holds it at q, hinges at zero."""
    places = tips(robot, q)
    X_WO = pin.SE3(np.eye(3), np.mean([X.translation for X in places.values()], axis=0))
    grasps = {arm: kind(object_in_hand=pose(X.actInv(X_WO)), **keys) for arm, X in places.items()}
    return grasps, HeldObject(pose=pose(X_WO))


def nao_start(robot: RobotModel) -> Array:
    return robot.configuration(
        {"right": [0.7, -0.2, 1.2, 0.9, 0.1], "left": [0.7, 0.2, -1.2, -0.9, -0.1]}
    )


def torso_pair(wide: float = 0.3, lift: str = "lift") -> RobotModel:
    """A slide that lifts two arms of three joints in the plane, on one base."""
    row, parameters = mdh.MdhRow, mdh.MdhParameters
    rows = [
        row(name=lift, lower=0.0, upper=0.5, velocity=1.0, sigma="prismatic"),
    ]  # fmt: skip
    for side, name in ((-1.0, "r"), (1.0, "l")):
        before = lift
        for i, p in enumerate(
            (
                parameters(gamma=side * math.pi / 2, d=wide, theta=-side * math.pi / 2),
                parameters(d=0.3),
                parameters(d=0.25),
            )
        ):
            joint = f"{name}{i + 1}"
            rows.append(
                row(name=joint, antecedent=before, **vars(p), lower=-2.5, upper=2.5, velocity=5)
            )
            before = joint
    ends = {
        "r_tip": mdh.Tip(parent="r3", offset=(0.1, 0.0, 0.0)),
        "l_tip": mdh.Tip(parent="l3", offset=(0.1, 0.0, 0.0)),
    }
    arms = (Arm(name="right", tip="r_tip"), Arm(name="left", tip="l_tip"))
    return RobotModel(name="torso", model=mdh.build_model("torso", rows, ends), arms=arms)


def check(
    robot: RobotModel, grasps: Grasp | dict[str, Grasp], held: HeldObject, found: StartSolution
) -> ClosedChain:
    """All loops closed, the object where it was asked for, all joints inside; margin as said."""
    chain = ClosedChain.attach(robot, found.q, grasps, held, passive_start=found.passive)
    state = State(chain)
    assert np.abs(state.loop_error).max() < CLOSED
    assert held.pose is not None
    np.testing.assert_allclose(state.p_WO, held.pose.position, atol=CLOSED)
    R = pin.rpy.rpyToMatrix(*held.pose.angles)
    assert np.linalg.norm(pin.log3(state.R_WO @ R.T)) < CLOSED
    margin = np.minimum(chain.q_start - chain.lower, chain.upper - chain.q_start).min()
    assert margin > 0.0
    assert found.margin == pytest.approx(margin, abs=1e-6)
    own = {k: v for k, v in found.start.items() if k not in found.passive}
    np.testing.assert_array_equal(robot.configuration(own), found.q)
    return chain


# ---- starts that are there -------------------------------------------------------------------


@pytest.mark.few(6)
@pytest.mark.parametrize("name", NEW_HERE)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_shipped_scenario_closes(name: str, seed: int) -> None:
    scenario = load(name)
    found = load_and_solve(name, seed=seed)
    assert isinstance(scenario.grasps, dict)
    check(scenario.robot_model, scenario.grasps, scenario.held, found)
    assert found.candidates > 1


def test_a_pose_that_is_reached_is_found_again(rng: np.random.Generator) -> None:
    """NAO's arms have five joints: hardly any pose is reached, but these are."""
    robot = NaoT14().build()
    lower, upper = robot.model.lowerPositionLimit, robot.model.upperPositionLimit
    for q in rng.uniform(lower + 0.1, upper - 0.1, (5, len(lower))):
        grasps, held = held_at(robot, q)
        check(robot, grasps, held, solve_start(robot, grasps, held))


def test_the_margin_is_no_worse_than_that_of_the_pose_it_was_made_of() -> None:
    robot = NaoT14().build()
    q = nao_start(robot)
    grasps, held = held_at(robot, q)
    found = solve_start(robot, grasps, held)
    margins = np.minimum(q - robot.model.lowerPositionLimit, robot.model.upperPositionLimit - q)
    assert found.margin > margins.min() - 1e-6


@pytest.mark.parametrize(
    ("kind", "keys"),
    [
        (Revolute, {"point": (0.0, 0.0, -0.05), "lower": -0.4, "upper": 0.7}),
        (Revolute, {"axis": (0, 1, 0), "axis_in": "world", "lower": -0.5, "upper": 0.5}),
        (Prismatic, {"lower": -0.03, "upper": 0.02}),
        (Spherical, {"cone": 0.8}),
    ],
)
def test_passive_joints_are_found_too(kind: type[Grasp], keys: dict[str, Any]) -> None:
    robot = NaoT14().build()
    grasps, held = held_at(robot, nao_start(robot), kind, **keys)
    found = solve_start(robot, grasps, held)
    chain = check(robot, grasps, held, found)
    assert set(found.passive) == {chain.joint_names[i] for i in chain.passive}
    assert all(found.start[name] == value for name, value in found.passive.items())


def test_a_hinge_must_turn_where_the_arm_alone_cannot_reach() -> None:
    """Hinges whose limits leave out zero: the object is grasped with them turned."""
    robot = NaoT14().build()
    q = nao_start(robot)
    hinge = {"point": (0.0, 0.0, -0.05), "lower": 0.15, "upper": 0.6}
    turned = {"right.hinge": 0.3, "left.hinge": 0.4}
    made = ClosedChain.attach(robot, q, Revolute(**hinge), HeldObject(), passive_start=turned)
    data, straight = made.model.createData(), made.q_start.copy()
    straight[made.passive] = 0.0
    pin.framesForwardKinematics(made.model, data, straight)
    grasps: dict[str, Grasp] = {}
    for arm, frame in zip(robot.arms, made.frames, strict=True):
        X_TO = data.oMf[made.model.getFrameId(arm.tip)].actInv(data.oMf[frame])
        grasps[arm.name] = Revolute(object_in_hand=pose(X_TO), **hinge)
    held = HeldObject(pose=Pose(position=tuple(made.start_position.tolist())))
    found = solve_start(robot, grasps, held)
    check(robot, grasps, held, found)
    assert all(0.15 < value < 0.6 for value in found.passive.values())
    with pytest.raises(GraspError, match="does not close"):
        ClosedChain.attach(robot, found.q, grasps, held)  # with the hinges at zero


def test_arms_on_one_torso_agree_on_it() -> None:
    robot = torso_pair()
    q = robot.configuration({"right": [0.2, 0.9, -1.2, 0.6], "left": [0.2, -0.9, 1.2, -0.6]})
    grasps, held = held_at(robot, q)
    found = solve_start(robot, grasps, held)
    check(robot, grasps, held, found)
    right, left = found.start["right"], found.start["left"]
    assert isinstance(right, list)
    assert isinstance(left, list)
    assert right[0] == left[0] == pytest.approx(0.2, abs=1e-9)


def test_equal_seeds_give_equal_starts() -> None:
    robot = NaoT14().build()
    grasps, held = held_at(robot, nao_start(robot), Revolute, point=(0.0, 0.0, -0.05))
    first, second, other = (solve_start(robot, grasps, held, seed=s) for s in (3, 3, 4))
    np.testing.assert_array_equal(first.q, second.q)
    assert first.tries != other.tries or not np.array_equal(first.q, other.q)


def test_progress_rises_to_its_end() -> None:
    robot = NaoT14().build()
    grasps, held = held_at(robot, nao_start(robot))
    seen: list[tuple[int, int]] = []
    solve_start(robot, grasps, held, progress=lambda done, total: seen.append((done, total)))
    done, totals = zip(*seen, strict=True)
    assert list(done) == sorted(done)
    assert set(totals) == {2 * TRIES}
    assert done[-1] == 2 * TRIES


def test_a_redundant_planar_grasp_closes() -> None:
    """Six rows to an arm with three joints: three of them follow."""
    robot = PlanarPair().build()
    q = robot.configuration({"right": [-0.35, 1.2, -0.9], "left": [0.35, -1.2, 0.9]})
    grasps, held = held_at(robot, q)
    check(robot, grasps, held, solve_start(robot, grasps, held))


# ---- starts that are not ---------------------------------------------------------------------


def test_it_says_which_arm_cannot_reach_and_how_far_it_gets() -> None:
    """A planar arm that is 2 x 0.3 m and so short: the rest of the way is known."""
    robot = PlanarPair().build()
    q = robot.configuration({"right": [-0.35, 1.2, -0.9], "left": [0.35, -1.2, 0.9]})
    grasps, held = held_at(robot, q)
    assert held.pose is not None
    x, y, z = held.pose.position
    lifted = HeldObject(pose=Pose(position=(x, y, z + 0.03)))
    with pytest.raises(GraspError) as caught:
        solve_start(robot, grasps, lifted)
    for arm in ("right", "left"):
        assert f"arm {arm} cannot reach its grasp: the nearest of " in str(caught.value)
    assert str(caught.value).count("off by 30.0 mm and 0.0 degrees") == 2
    X_TO = grasps["left"].object_in_hand
    assert X_TO is not None
    x, y, z = X_TO.position
    grasps["left"] = Rigid(object_in_hand=Pose(position=(x, y, z + 0.02), rpy=X_TO.rpy))
    with pytest.raises(GraspError) as caught:
        solve_start(robot, grasps, held)
    assert "arm left cannot reach its grasp" in str(caught.value)
    assert "off by 20.0 mm and 0.0 degrees" in str(caught.value)
    assert "arm right" not in str(caught.value)


@pytest.mark.parametrize(
    ("lift", "more"),
    [("lift", ""), ("left_finger", " (of a gripper, it seems: lock left_finger)")],
)
def test_the_distance_that_is_told_is_the_least(lift: str, more: str) -> None:
    """A goal 20 cm beyond an arm that is stretched out towards it."""
    robot = torso_pair(lift=lift)
    q = robot.configuration({"right": [0.2, 0.9, -1.2, 0.6], "left": [0.2, -0.9, 1.2, -0.6]})
    grasps, held = held_at(robot, q)
    assert held.pose is not None
    x, y, _ = held.pose.position
    far = HeldObject(pose=Pose(position=(x, y, 0.5 + 0.07)))
    with pytest.raises(GraspError) as caught:
        solve_start(robot, grasps, far)
    text = str(caught.value)
    assert "arm right cannot reach" in text
    assert "arm left cannot reach" in text
    assert text.count(f"off by 70.0 mm and 0.0 degrees, with {lift} at the limit{more}") == 2


def test_arms_that_need_their_torso_in_two_places_are_told_apart() -> None:
    robot = torso_pair()
    q = robot.configuration({"right": [0.2, 0.9, -1.2, 0.6], "left": [0.2, -0.9, 1.2, -0.6]})
    grasps, held = held_at(robot, q)
    X_TO = grasps["left"].object_in_hand
    assert X_TO is not None
    x, y, z = X_TO.position
    grasps["left"] = Rigid(object_in_hand=Pose(position=(x, y, z + 0.04), rpy=X_TO.rpy))
    with pytest.raises(GraspError) as caught:
        solve_start(robot, grasps, held)
    text = str(caught.value)
    assert "arms right and left reach their grasps each by itself, but not with" in text
    assert "right 20.0 mm and 0.0 degrees and left 20.0 mm and 0.0 degrees" in text


def test_what_is_not_known_is_asked_for() -> None:
    robot = NaoT14().build()
    grasps, held = held_at(robot, nao_start(robot))
    with pytest.raises(GraspError, match=r"give object.pose$"):
        solve_start(robot, grasps, HeldObject())
    with pytest.raises(GraspError, match=r"give object_in_hand in the grasp of right and left$"):
        solve_start(robot, Rigid(), held)
    with pytest.raises(GraspError, match="no grasp for arm left"):
        solve_start(robot, {"right": grasps["right"]}, held)
    with pytest.raises(UnknownNameError, match="unknown arm 'rihgt'"):
        solve_start(robot, {**grasps, "rihgt": Rigid()}, held)


def test_starts_that_do_not_fit_are_passed_over() -> None:
    """Elbows of two planar arms bend both ways; all four starts are had, the best first."""
    robot = PlanarPair().build()
    grasps, held = held_at(robot, np.array([-0.35, 1.2, -0.85, 0.35, -1.2, 0.85]))
    taken: list[list[float]] = []

    def bends(start: Start) -> list[float]:
        return [float(np.sign(np.asarray(start[arm])[1])) for arm in ("right", "left")]

    def fits(start: Start) -> bool:
        return bends(start) not in taken

    best = solve_start(robot, grasps, held)
    for _ in range(4):
        found = solve_start(robot, grasps, held, fits=fits)
        check(robot, grasps, held, found)
        taken.append(bends(found.start))
    assert sorted(taken) == [[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]]
    assert taken[0] == bends(best.start)
    np.testing.assert_array_equal(solve_start(robot, grasps, held, fits=lambda _: False).q, best.q)


@needs_robots
def test_a_solved_start_keeps_clear_of_what_the_file_has() -> None:
    """A ball where an elbow would be: the arm takes another of its starts, and keeps 10 mm."""
    shipped = load("shelves")
    chain = shipped.chain
    pin.forwardKinematics(chain.model, data := chain.model.createData(), chain.q_start)
    elbow = data.oMi[chain.model.getJointId("left/panda_joint4")].translation.round(4).tolist()
    ball = f"        ball: {{sphere: 0.06, position: {elbow}}}\n"
    text = shipped.source.replace("        back:", f"{ball}        back:")
    found = load_text(Path("shelves.yaml"), text, shipped.catalog)
    assert "ball" in found.source
    assert np.abs(found.chain.q_start - chain.q_start)[:7].max() > 0.1
    for limit in found.limits:
        clearance = limit.clearance(found.chain)
        assert clearance is None or clearance(State(found.chain)).min() >= 0.0
