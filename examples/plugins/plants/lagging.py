"""Joints that reach the commanded velocity late: v_dot = (command - v) / lag.

Held for a period dt, the command moves the joints by exactly

    v+ = c + (v - c) s,   q+ = q + c dt + (v - c) lag (1 - s),   s = exp(-dt / lag)
"""

from __future__ import annotations

import math
from typing import ClassVar

from coopqp import (
    Array,
    Command,
    ControlProblem,
    Disturbance,
    Plant,
    PlantModel,
    State,
    spec,
)


class LaggingModel(PlantModel):
    """Velocity servos with a first-order lag; all that they know is in the state."""

    def __init__(self, dt: float, lag: float) -> None:
        super().__init__()
        self._dt, self._lag = dt, lag

    def step(self, state: State, command: Command) -> None:
        """The exact solution over dt."""
        left = math.exp(-self._dt / self._lag)
        late = state.v - command.v
        state.q += command.v * self._dt + late * (self._lag * (1.0 - left))
        state.v[:] = command.v + late * left
        state.t += self._dt

    def configuration(self, state: State) -> Array:
        """As told: the sensors are perfect."""
        return state.q

    def resume(self, before: PlantModel) -> None:
        """Nothing: the velocity goes on in the state."""


@spec
class Lagging(Plant):
    """Joints that follow a commanded velocity with a first-order lag."""

    takes_torques: ClassVar[bool] = False

    lag: float = 0.02
    """Time after which 63 % of a step have arrived [s]."""

    def build(self, problem: ControlProblem, seed: int, disturbance: Disturbance) -> PlantModel:
        """Nothing to prepare."""
        return LaggingModel(problem.dt, self.lag)
