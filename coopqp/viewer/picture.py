"""What is drawn of a controller: links, object, forces, and what is violated."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin

from coopqp.assessment.thresholds import AT_LIMIT, TOO_FAST, closed, matters, within
from coopqp.base.spec import Array
from coopqp.execution.instants import arm_points
from coopqp.model.marker import SolidMarker, marks_of
from coopqp.model.state import State
from coopqp.report.scene.bodies import Body, moved, robot_bodies, solid_body
from coopqp.report.scene.playback import MIN_FORCE, Place, squeeze_words, weight
from coopqp.scenario.scenario import Scenario
from coopqp.signal import axes_along, quaternion_of
from coopqp.study.explanation.words import listed, size
from coopqp.viewer.messages import ControllerFrame
from coopqp.viewer.simulated_controller import SimulatedController

FORCES = "hand_wrench"
ARROW = 0.8  # length of the longest force, in longest edges of the object
#: Forces are above the hands, and the weight below the object, where they can be seen, by so many
#: longest edges of it.
ABOVE, BELOW = 1.0, 0.6
ROUND = 48  # corners of a circle
MAX_NAMED = 2
DIGITS = 6  # of errors that are shown [m, rad]
NOTHING = np.zeros((0, 2, 3))


def all_bodies(scenario: Scenario) -> tuple[tuple[Body, ...], tuple[str, ...]]:
    """Those of the robot and its surroundings, and meshes that could not be read."""
    bodies, faults = robot_bodies(scenario.chain.robot)
    marks = (mark for limit in scenario.limits for mark in limit.marks(0.0))
    solids = (solid_body(mark) for mark in marks if isinstance(mark, SolidMarker))
    return (*bodies, *solids), faults


def space(scenario: Scenario, bodies: Sequence[Body]) -> tuple[Array, Array]:
    """Lowest and highest corner of the robot at its start and of the object, shape (3,) each."""
    state, size = State(scenario.chain), max(scenario.held.size)
    points = [state.p_WO[None] - 0.5 * size, state.p_WO[None] + 0.5 * size]
    points += [moved(body.surface, _joint_pose(state, body)).vertices for body in bodies]
    joined = np.concatenate(points)
    return joined.min(axis=0), joined.max(axis=0)


def drawn(controller: SimulatedController, bodies: Sequence[Body]) -> ControllerFrame:
    """A controller at its last tick."""
    state = controller.plant.truth(controller.state)
    reached, errors = _goal_errors(controller, state)
    arrows, weight, squeeze = _forces(controller, state)
    frame, broken = still(state, bodies), _broken(controller, state)
    errors = ", ".join(filter(None, (errors, squeeze)))
    frame = replace(frame, arrows=arrows, weight=weight)
    return replace(frame, reached=reached, errors=errors, broken=broken)


def still(state: State, bodies: Sequence[Body]) -> ControllerFrame:
    """Arms and object at a state, without a controller."""
    places = [pin.SE3ToXYZQUAT(_joint_pose(state, body)) for body in bodies]
    held = np.concatenate([state.p_WO, quaternion_of(state.R_WO)])
    bodies_at = np.array(places).reshape(-1, 7)
    return ControllerFrame(bodies_at, held, _left(state), NOTHING, NOTHING, False, "", "")


def outlines(controller: SimulatedController, place: Place) -> Array:
    """The tasks' markers as line segments, shape (s, 2, 3) [m]."""
    state, segments = controller.state, [NOTHING]
    for task in controller.run.problem.tasks:
        for mark in marks_of(task.name, partial(task.marks, state), []):
            kind, values = place.drawn(mark)
            match kind:
                case "planes":
                    segments.append(_closed(np.array(values["corners"])))
                case "lines":
                    segments.append(np.array(values["ends"])[None])
                case "circles":
                    segments.append(_circle(**values))
                case "spheres":
                    segments += [_circle(normal=n, **values) for n in np.eye(3)]
                case "directions":
                    segments.append(np.array([[state.p_WO, state.p_WO + values["way"]]]))
    return np.concatenate(segments)


def _joint_pose(state: State, body: Body) -> pin.SE3:
    """By name: the grasps' joints stand between those of the robot."""
    chain = state.chain
    return state.joint_pose(chain.model.getJointId(chain.robot.model.names[body.joint]))


def _left(state: State) -> Array:
    """Of each of the robot's joints, 0 at its limit; 1 for joints without limits."""
    chain, q = state.chain, state.q
    own = [chain.joint_names.index(name) for name in chain.robot.joint_names]
    with np.errstate(invalid="ignore"):
        margin = np.minimum(q - chain.lower, chain.upper - q)
        left = margin / (0.5 * (chain.upper - chain.lower))
    left[np.abs(margin) <= AT_LIMIT] = 0.0
    return np.asarray(np.nan_to_num(left[own], nan=1.0, posinf=1.0, neginf=-1.0), float)


def _broken(controller: SimulatedController, state: State) -> str:
    """What is violated, as a sentence; empty if nothing."""
    if controller.plant.broken:
        return controller.plant.broken
    chain, q = state.chain, state.q
    texts = []
    over = np.maximum(chain.lower - q, q - chain.upper)
    for i in np.argsort(-over)[:MAX_NAMED]:
        if matters(float(over[i]), chain.joint_units[i]):
            past = size(float(over[i]), chain.joint_units[i])
            texts.append(f"{chain.joint_names[i]} is {past} past its limit")
    fast = np.abs(controller.command.v) / chain.velocity
    if len(fast) and fast.max() > 1.0 + TOO_FAST:
        i = int(fast.argmax())
        texts.append(f"{chain.joint_names[i]} is told to go {fast[i]:.3g} times its fastest speed")
    if controller.torn:
        texts.append("the loop opened so far that no goal counts any more")
    elif not closed(state.loop_position_error, state.loop_orientation_error):
        texts.append(f"the loop is open by {size(state.loop_position_error, 'm')}")
    if not controller.command.status.usable:
        texts.append(controller.command.status.value)
    return listed(texts)


def _goal_errors(controller: SimulatedController, state: State) -> tuple[bool, str]:
    """Whether all goals are reached, and the error of each in words."""
    problem, stack = controller.run.problem, controller.goals
    state.inputs = controller.state.inputs
    try:
        stack.update(state)
    except Exception:  # noqa: BLE001 - the tick, which met the same error, names it
        return False, controller.command.note
    texts, reached, at = [], controller.fed and not controller.torn, 0
    for task in problem.tasks:
        errors = []
        for part in task.parts(problem.chain):
            rows = slice(at, at := at + part.rows)
            e = stack.e[rows]
            if task.asks_velocity:
                e = stack.J[rows] @ state.v - stack.rate[rows]
            error = math.hypot(*e.tolist())
            reached = reached and within(error, part.tolerance)
            errors.append(size(round(error, DIGITS), part.unit))
        texts.append(f"{task.name} {listed(errors)} off")
    return reached, ", ".join(texts)


def _forces(controller: SimulatedController, state: State) -> tuple[Array, Array, str]:
    """Arrows of the hands' forces, shape (arms, 2, 3), and the weight, (1, 2, 3) [m]; squeeze."""
    wrenches, points = (controller.plant.signals.get(name) for name in (FORCES, "hand_point"))
    if wrenches is None or points is None:
        return NOTHING, NOTHING, ""
    forces, down = wrenches.reshape(-1, 6)[:, :3], weight(controller.run.scenario)
    longest = max(float(np.linalg.norm(forces, axis=1).max()), down, MIN_FORCE)
    size = max(controller.run.scenario.held.size)
    scale = ARROW * size / longest
    points_of = arm_points(state.chain, state.q[None])
    hands = np.array([points_of[arm.name][0, -1] for arm in state.chain.robot.arms])
    hands[:, 2] += ABOVE * size
    below = state.p_WO - [0.0, 0.0, BELOW * size]
    arrows = np.stack([hands - scale * forces, hands], axis=1)
    weight_arrow = np.array([[below, below - [0.0, 0.0, scale * down]]])
    return arrows, weight_arrow, squeeze_words(points, wrenches)


def _closed(corners: Array) -> Array:
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def _circle(center: Array, normal: Array, radius: float) -> Array:
    u, w, _ = axes_along(np.asarray(normal))
    angles = np.linspace(0.0, 2.0 * np.pi, ROUND, endpoint=False)[:, None]
    return _closed(np.asarray(center) + radius * (np.cos(angles) * u + np.sin(angles) * w))
