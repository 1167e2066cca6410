"""The true closed chain, which differs from the modelled one.

The true chain counts its angles as the encoders do: an encoder's offset is part of where the joint
is fixed, q_true = q - offset. So its q is what sensors measure but for noise, what servos work on,
and what reports show. Its loops close where the model's are open by some b(q), and vice versa.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import GraspConfiguration
from coopqp.model.state import State
from coopqp.plant import Disturbance
from coopqp.robot import RobotModel

#: A link shorter than this has no direction to be longer in [m].
SHORTEST_LINK = 1e-3
#: Newton steps to the nearest start with the true loops closed, and when they count as closed.
STEPS, CLOSED = 20, 1e-9
#: So that the errors do not depend on what else is random.
STREAM = 1


def true_chain(chain: ClosedChain, seed: int, disturbance: Disturbance) -> ClosedChain:
    """The chain with the disturbance's errors, at the nearest start with its loops closed.

    ``seed`` decides the errors' signs and directions. Without errors the chain is returned.
    InvalidValueError: the true loops cannot be closed near the start.
    """
    if any(disturbance.object_com):
        held = chain.hold.held
        x, y, z = np.array(held.com) + disturbance.object_com
        chain = ClosedChain(replace(chain.hold, held=replace(held, com=(x, y, z))))
    nothing = Disturbance(slip=disturbance.slip, faults=disturbance.faults)
    if disturbance.kinematic == nothing:
        return chain
    rng, hold = np.random.default_rng([seed, STREAM]), chain.hold
    robot = _with_errors(hold.robot, rng, disturbance)
    X_EO = _misplaced(hold, rng, disturbance)
    return _closed(ClosedChain(replace(hold, robot=robot, X_EO=X_EO)))


def slipped(chain: ClosedChain, seed: int, distance: float) -> ClosedChain:
    """The chain after the object has moved by a distance [m] in the hand of the last holder."""
    if chain.standing:
        return chain
    hold, arm = chain.hold, chain.hold.holders[-1]
    direction = _direction(np.random.default_rng([seed, STREAM + 1]))
    X = hold.X_EO[arm].copy()
    X.translation = X.translation + distance * direction
    return ClosedChain(replace(hold, X_EO={**hold.X_EO, arm: X}))


def _with_errors(
    robot: RobotModel, rng: np.random.Generator, disturbance: Disturbance
) -> RobotModel:
    """Other link lengths, encoders with an offset; limits in encoder angles."""
    model = robot.model.copy()
    turns = np.array([not j.shortname().startswith("JointModelP") for j in list(model.joints)[1:]])
    offset = disturbance.encoder_offset * turns * _signs(rng, model.nv)
    data = model.createData()
    pin.forwardKinematics(model, data, -offset)
    places = [data.liMi[j].copy() for j in range(model.njoints)]
    signs = _signs(rng, model.njoints)
    for j in range(1, model.njoints):
        longer = signs[j] * disturbance.link_length * _along(model.jointPlacements[j].translation)
        places[j].translation = places[j].translation + longer
        model.jointPlacements[j] = places[j]
    for arm, sign in zip(robot.arms, _signs(rng, len(robot.arms)), strict=True):
        frame = model.frames[model.getFrameId(arm.tip)]
        X = frame.placement.copy()
        X.translation = X.translation + sign * disturbance.link_length * _along(X.translation)
        frame.placement = X
    model.lowerPositionLimit = model.lowerPositionLimit + offset
    model.upperPositionLimit = model.upperPositionLimit + offset
    return replace(robot, model=model)


def _misplaced(
    hold: GraspConfiguration, rng: np.random.Generator, disturbance: Disturbance
) -> Mapping[str, pin.SE3]:
    X_EO = dict(hold.X_EO)
    for arm in hold.robot.arms:
        shift = disturbance.grasp_offset * _direction(rng)
        turn = disturbance.grasp_offset_angle * _direction(rng)
        X = hold.X_EO[arm.name]
        X_EO[arm.name] = pin.SE3(X.rotation @ pin.exp3(turn), X.translation + shift)
    return X_EO


def _closed(chain: ClosedChain) -> ClosedChain:
    """At the nearest start with closed loops; what no joint can close is another grasp."""
    state = State(chain)
    state.close_loops(STEPS)
    if not np.abs(state.e_loop).max(initial=0.0) < CLOSED:
        raise InvalidValueError(
            "disturbance: with these errors of the model the arms cannot close their loops near "
            "the start; make link_length, encoder_offset and the grasp's offsets smaller"
        ).at("disturbance")
    X_WO = chain.object_pose(state.q)
    hold = replace(chain.hold, q=state.q.copy(), p_WO=X_WO.translation.copy())
    held = hold.in_hands({arm.name: X_WO for arm in chain.arms})
    kept = {arm: held[arm] for arm in hold.holders}
    return ClosedChain(replace(hold, X_EO={**hold.X_EO, **kept}))


def _signs(rng: np.random.Generator, count: int) -> Array:
    return rng.choice([-1.0, 1.0], count)


def _direction(rng: np.random.Generator) -> Array:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector), float)


def _along(link: Array) -> Array:
    """Direction of a link; zero where it has no length."""
    length = float(np.linalg.norm(link))
    return link / length if length > SHORTEST_LINK else np.zeros(3)
