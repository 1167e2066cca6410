"""What is drawn of a lane: its links, its object, forces, and what is wrong with it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
import pinocchio as pin

from coopqp.assessment.thresholds import AT_LIMIT, TOO_FAST, closed, matters, within
from coopqp.base.spec import Array
from coopqp.closed_loop.forces import squeezes
from coopqp.model.marker import SolidMarker, asked
from coopqp.model.state import State
from coopqp.report.scene.bodies import robot_bodies, solid_body
from coopqp.report.scene.forces import LEAST_FORCE, squeeze_words, weight
from coopqp.report.scene.markers import Place
from coopqp.robot import RobotModel
from coopqp.scenario.scenario import Scenario
from coopqp.signal import axes_along, quaternion_of
from coopqp.study.explanation.words import listed, size
from coopqp.viewer.messages import LawFrame, Surface
from coopqp.viewer.simulated_controller import SimulatedController

FORCES = "hand_wrench"
#: The longest force is drawn as long as this share of the object.
ARROW = 0.8
#: So far above the hands, and the weight below the object's middle, in its longest edge: inside
#: them nobody would see an arrow.
ABOVE, BELOW = 1.0, 0.6
#: Corners of a circle.
ROUND = 48
MOST_NAMED = 2
#: What is smaller than this many digits tell is no error to people [m, rad].
DIGITS = 6


def surfaces(scenario: Scenario) -> tuple[tuple[Surface, ...], tuple[str, ...]]:
    """The robot and what stands around, and what could not be read."""
    robot = scenario.chain.robot
    bodies, faults = robot_bodies(robot)
    marks = (mark for limit in scenario.limits for mark in limit.marks(0.0))
    solids = [solid_body(mark) for mark in marks if isinstance(mark, SolidMarker)]
    names = scenario.chain.joint_names
    found = [
        Surface(
            names.index(robot.model.names[body.joint]) if body.joint else None,
            body.surface.vertices,
            body.surface.corners,
        )
        for body in (*bodies, *solids)
    ]
    return tuple(found), tuple(faults)


def space(scenario: Scenario, bodies: Sequence[Surface]) -> tuple[Array, Array]:
    """Lowest and highest corner of the robot at its start and of the object, shape (3,) each."""
    state, chain = State(scenario.chain), scenario.chain
    points = [state.p_WO[None] - 0.5 * max(scenario.held.size)]
    points.append(points[0] + max(scenario.held.size))
    for body in bodies:
        X = _joint_pose(state, chain.joint_names, body.joint)
        points.append(body.vertices @ X.rotation.T + X.translation)
    joined = np.concatenate(points)
    return joined.min(axis=0), joined.max(axis=0)


def drawn(lane: SimulatedController, bodies: Sequence[Surface]) -> LawFrame:
    """A lane as it is now."""
    state = lane.plant.truth(lane.state)
    names = lane.run.problem.chain.joint_names
    places = [pin.SE3ToXYZQUAT(_joint_pose(state, names, body.joint)) for body in bodies]
    reached, words = _off(lane, state)
    arrows, weight, squeeze = _forces(lane, state)
    return LawFrame(
        bodies=np.array(places).reshape(-1, 7),
        held=np.concatenate([state.p_WO, quaternion_of(state.R_WO)]),
        left=_left(state),
        arrows=arrows,
        weight=weight,
        reached=reached,
        words=", ".join(filter(None, (words, squeeze))),
        broken=_broken(lane, state),
    )


def outlines(lane: SimulatedController, place: Place) -> Array:
    """What the tasks ask for, as line segments, shape (s, 2, 3) [m]."""
    state, found = lane.state, [np.zeros((0, 2, 3))]
    for task in lane.run.problem.tasks:
        for mark in asked(task.name, partial(task.marks, state), []):
            kind, values = place.drawn(mark)
            match kind:
                case "planes":
                    found.append(_closed(np.array(values["corners"])))
                case "lines":
                    found.append(np.array(values["ends"])[None])
                case "circles":
                    found.append(_circle(**values))
                case "spheres":
                    found += [_circle(normal=n, **values) for n in np.eye(3)]
                case "directions":
                    found.append(np.array([[state.p_WO, state.p_WO + values["way"]]]))
    return np.concatenate(found)


def _joint_pose(state: State, names: Sequence[str], joint: int | None) -> pin.SE3:
    if joint is None:
        return pin.SE3.Identity()
    return state.joint_pose(state.chain.model.getJointId(names[joint]))


def _left(state: State) -> Array:
    """What is left to the nearer limit, in half ranges, 0 at it; 1 for joints that have none."""
    chain, q = state.chain, state.q
    with np.errstate(invalid="ignore"):
        room = np.minimum(q - chain.lower, chain.upper - q)
        left = room / (0.5 * (chain.upper - chain.lower))
    left[np.abs(room) <= AT_LIMIT] = 0.0
    return np.asarray(np.nan_to_num(left, nan=1.0, posinf=1.0, neginf=-1.0), float)


def _broken(lane: SimulatedController, state: State) -> str:
    """What has happened that must not."""
    if lane.plant.broken:
        return lane.plant.broken
    chain, q = state.chain, state.q
    said = []
    over = np.maximum(chain.lower - q, q - chain.upper)
    for i in np.argsort(-over)[:MOST_NAMED]:
        if matters(float(over[i]), chain.joint_units[i]):
            past = size(float(over[i]), chain.joint_units[i])
            said.append(f"{chain.joint_names[i]} is {past} past its limit")
    fast = np.abs(lane.command.v) / chain.velocity
    if len(fast) and fast.max() > 1.0 + TOO_FAST:
        i = int(fast.argmax())
        said.append(f"{chain.joint_names[i]} is told to go {fast[i]:.3g} times its fastest speed")
    if lane.torn:
        said.append("the loop came open so far that no goal counts any more")
    elif not closed(state.loop_position_error, state.loop_orientation_error):
        said.append(f"the loop is open by {size(state.loop_position_error, 'm')}")
    if not lane.command.status.usable:
        said.append(lane.command.status.value)
    return listed(said)


def _off(lane: SimulatedController, state: State) -> tuple[bool, str]:
    """Whether all goals are reached, and how far off each is."""
    problem, stack = lane.run.problem, lane.goals
    state.inputs = lane.state.inputs
    try:
        stack.update(state)
    except Exception:  # noqa: BLE001 - the tick, which met the same error, names it
        return False, lane.command.note
    said, reached, at = [], lane.followed and not lane.torn, 0
    for task in problem.tasks:
        errors = []
        for part in task.parts(problem.chain):
            rows = slice(at, at + part.rows)
            at += part.rows
            miss = stack.e[rows]
            if task.asks_velocity:
                miss = stack.J[rows] @ state.v - stack.rate[rows]
            error = math.hypot(*miss.tolist())
            reached = reached and within(error, part.tolerance)
            errors.append(size(round(error, DIGITS), part.unit))
        said.append(f"{task.name} {listed(errors)} off")
    return reached, ", ".join(said)


def _forces(lane: SimulatedController, state: State) -> tuple[Array, Array, str]:
    """What each hand does to the object, ending above the hand, shape (arms, 2, 3) [m].

    And its weight, from below the object on, shape (1, 2, 3), and the squeeze in words; nothing
    where the plant tells no forces.
    """
    wrenches, points = (lane.plant.signals.get(name) for name in (FORCES, "hand_point"))
    if wrenches is None or points is None:
        return np.zeros((0, 2, 3)), np.zeros((0, 2, 3)), ""
    forces, down = wrenches.reshape(-1, 6)[:, :3], weight(lane.run.scenario)
    longest = max(float(np.linalg.norm(forces, axis=1).max()), down, LEAST_FORCE)
    size = max(lane.run.scenario.held.size)
    scale = ARROW * size / longest
    hands = _hands(state, lane.run.scenario.chain.robot)
    hands[:, 2] += ABOVE * size
    below = state.p_WO - [0.0, 0.0, BELOW * size]
    arrows = np.stack([hands - scale * forces, hands], axis=1)
    words = squeeze_words(squeezes(points.reshape(-1, 3), wrenches.reshape(-1, 6)))
    return arrows, np.array([[below, below - [0.0, 0.0, scale * down]]]), words


def _hands(state: State, robot: RobotModel) -> Array:
    """Where the hands are, by the robot's arms, shape (arms, 3) [m]."""
    places = []
    for arm in robot.arms:
        frame = robot.model.frames[robot.model.getFrameId(arm.tip)]
        joint = state.chain.model.getJointId(robot.model.names[frame.parentJoint])
        places.append(state.joint_pose(joint).act(frame.placement.translation))
    return np.array(places)


def _closed(corners: Array) -> Array:
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def _circle(center: Array, normal: Array, radius: float) -> Array:
    u, w, _ = axes_along(np.asarray(normal))
    angles = np.linspace(0.0, 2.0 * np.pi, ROUND, endpoint=False)[:, None]
    return _closed(np.asarray(center) + radius * (np.cos(angles) * u + np.sin(angles) * w))
