"""Joints that do exactly as told: q <- q + v dt."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from coopqp.checked import Array, spec
from coopqp.controller import Command, ControlProblem
from coopqp.disturbance import Disturbance
from coopqp.plant import Plant, PlantModel
from coopqp.state import State


class KinematicModel(PlantModel):
    """Perfect joint velocity servos.

    Args:
        dt: control period [s].
        n: number of joints.
    """

    def __init__(self, dt: float, n: int) -> None:
        super().__init__()
        self._dt = np.array(dt)
        self._step = np.zeros(n)

    def step(self, state: State, command: Command) -> None:
        """One Euler step, which is exact for a velocity held constant."""
        np.multiply(command.v, self._dt, self._step)
        np.add(state.q, self._step, state.q)
        state.v[:] = command.v
        state.t += float(self._dt)

    def configuration(self, state: State) -> Array:
        """As told: the sensors are perfect."""
        return state.q

    def resume(self, before: PlantModel) -> None:
        """Nothing: all that this plant knows is in the state."""


@spec
class Kinematic(Plant):
    """Joints that do exactly as told, q + v dt: shows the control law and nothing else."""

    takes_torques: ClassVar[bool] = False

    def build(self, problem: ControlProblem, seed: int, disturbance: Disturbance) -> PlantModel:
        """Nothing to prepare."""
        return KinematicModel(problem.dt, problem.chain.n)
