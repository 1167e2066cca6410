"""The phases of a loop, one after the other, each begun where the robot is then.

A scenario says where the object is in the hands by ``object_in_hand`` or ``object.pose``, for its
own start. The hands of the robot are not quite there: links, encoders and grasp are some
millimetres off. The object is then where the hands have it in the mean, and each hand holds it
there. Where the scenario says nothing, each hand holds it midway between the hands, as ever.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.base.errors import CoopqpError, GraspError, InvalidValueError
from coopqp.base.spec import Array, Pose, finite, vector
from coopqp.controller import Controller
from coopqp.execution.phase_run import Measured, PhaseRun, begin_phase
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import grasp_of_each
from coopqp.model.loop_observer import MOST_ORIENTATION, MOST_POSITION
from coopqp.model.state import State
from coopqp.online.arrivals import Arrivals
from coopqp.online.braking import Braking
from coopqp.scenario.input import Arrival
from coopqp.scenario.scenario import Scenario

#: What force sensors say arrives as an input of this name with every tick; ``State.hand_wrench``.
HAND_WRENCH = "hand_wrench"


class Phases:
    """The phases so far.

    Args:
        given: the scenario as it is written.
        observed: whether what is measured stays a measurement, from which commands may differ.
        by_time: whether a phase ends by itself.

    Attributes:
        scenario: as begun.
        done: the phases so far, the last one that which runs; none before the beginning.
        now: the phase that runs, or would. arrivals: at its inputs. braking: brings it to rest.
        fault: why the next phase could not begin; empty if it could.
    """

    def __init__(
        self, given: Scenario, controller: Controller, *, observed: bool, by_time: bool
    ) -> None:
        self.scenario = self._given = given
        self._controller, self._observed, self._by_time = controller, observed, by_time
        self._asked, self.fault = False, ""
        self.done: tuple[PhaseRun, ...] = ()
        self._enter(None, None)

    def begin(self, q: Array, *, held: bool) -> None:
        """Begin the first phase."""
        if held and not np.array_equal(q, self._given.chain.q_start):
            self.scenario = as_held(self._given, q)
        self._enter(None, q)
        self.done = (self.now,)

    def _enter(self, before: PhaseRun | None, q: Array | None) -> None:
        robot = Measured(q, self._observed)
        self.now = now = begin_phase(self.scenario, self._controller, before, robot=robot)
        names = {*self.scenario.inputs, *([HAND_WRENCH] if now.law.squeezer else [])}
        self.arrivals = Arrivals(now.inputs, names, now.since)
        self.braking = Braking(now.problem, now.law.squeezer)

    def ask(self) -> None:
        """Let the phase end."""
        if self.now.is_last:
            raise InvalidValueError(f"phase '{self.now.phase.name}' is the last")
        self._asked = True

    @property
    def over(self) -> bool:
        """Whether the next phase is due."""
        return not self.now.is_last and (self._asked or (self._by_time and self.now.over))

    def hand_over(self, q: Array) -> bool:
        """Begin the next phase, if the arms can stop in a tick, with the speed that they have.

        Returns:
            Whether it was tried; :attr:`fault` says if it was in vain.
        """
        if not self.braking.can_stop(self.now.state):
            return False
        self._asked = False
        try:
            self._enter(self.now, q)
        except CoopqpError as error:
            self.fault = f"phase '{self.now.phase.name}' does not end: {error}"
            return True
        self.done = (*self.done, self.now)
        return True

    def take_up(self, q: Array) -> None:
        """Go on from where the robot is, at rest, at the time where the phase has stopped."""
        now, before = self.now, self.now.state
        now.state = Measured(q, self._observed).start(now.law)
        now.state.t, now.state.inputs = before.t, before.inputs
        self.rest_inputs()

    def take(self, inputs: Any, now: float) -> list[Arrival]:
        """Let what has come since the last tick arrive."""
        state = self.now.state
        arrivals = self.arrivals.read(self._feel(inputs), state.t, now)
        self.now.inputs.step(state, arrivals)
        state.inputs.refused = (*self.arrivals.refused, *state.inputs.refused)
        return arrivals

    def _feel(self, inputs: Any) -> Any:
        """Take what the force sensors say out of what has come, where hands squeeze by it."""
        if not self.now.law.squeezer:
            return inputs
        self.now.state.hand_wrench = None
        if not isinstance(inputs, Mapping) or HAND_WRENCH not in inputs:
            return inputs
        self.now.state.hand_wrench = inputs[HAND_WRENCH]  # anything; the law looks at it
        return {name: given for name, given in inputs.items() if name != HAND_WRENCH}

    def rest_inputs(self) -> None:
        """Let what follows the inputs stand where it is."""
        for channel in self.now.inputs.channels.values():
            channel.rate[:] = channel.acceleration[:] = 0.0
            if channel.kind.velocity:
                channel.value[:] = 0.0


#: Numbers of a scenario file are at least so large, or zero.
LEAST = 1e-30


def as_held(scenario: Scenario, q: Array) -> Scenario:
    """The scenario with its start where the robot is, and the grasp as it is held there.

    Raises:
        GraspError: the hands are so far from how the scenario says they hold the object that it
            cannot be the model's error.
        InvalidValueError: q is no n finite numbers.
    """
    chain = scenario.chain
    q = _plain(finite("q", vector("q", q, chain.n)))
    start = dict(zip(chain.joint_names, q.tolist(), strict=True))
    grasps = grasp_of_each(scenario.robot_model, scenario.grasps)
    holders = chain.hold.holders
    if scenario.held.pose is None and not any(grasps[arm].object_in_hand for arm in holders):
        return replace(scenario, start=start)
    _check(chain, q)
    held = replace(scenario.held, pose=_pose(chain.object_pose(q)))
    without_places = {arm: replace(grasps[arm], object_in_hand=None) for arm in holders}
    return replace(scenario, start=start, held=held, grasps={**grasps, **without_places})


def _plain(numbers: Array) -> Array:
    return np.where(np.abs(numbers) < LEAST, 0.0, numbers)


def _pose(X: pin.SE3) -> Pose:
    place, angles = _plain(X.translation), _plain(pin.rpy.matrixToRpy(X.rotation))
    return Pose(position=tuple(place.tolist()), rpy=tuple(angles.tolist()))


def _check(chain: ClosedChain, q: Array) -> None:
    state = State(chain, q)
    apart, turned = state.loop_position_error, state.loop_orientation_error
    if apart > MOST_POSITION or turned > MOST_ORIENTATION:
        raise GraspError(
            f"the hands are {1e3 * apart:.0f} mm and {1e3 * turned:.0f} mrad from how the scenario "
            "says they hold the object, more than a model's error; bring the robot near the "
            "scenario's start, or leave out object_in_hand and object.pose to hold it as it is"
        )
