"""Joints that reach the commanded velocity late: v_dot = (command - v) / lag.

Held for a period dt, the command moves the joints by exactly

    v+ = c + (v - c) s,   q+ = q + c dt + (v - c) lag (1 - s),   s = exp(-dt / lag)
"""

from __future__ import annotations

import math
from typing import ClassVar

from coopqp import (
    Command,
    ControlProblem,
    Disturbance,
    Plant,
    PlantModel,
    State,
    spec,
)


class LaggingModel(PlantModel):
    """Velocity servos with a first-order lag, and encoders that see it."""

    def __init__(self, problem: ControlProblem, lag: float) -> None:
        super().__init__()
        self._dt, self._lag = problem.dt, lag
        self._true = State(problem.chain)
        self.measured = self._true.q.copy()

    def step(self, state: State, command: Command) -> None:
        """The exact solution over dt; the state goes on as commanded."""
        left, true = math.exp(-self._dt / self._lag), self._true
        late = true.v - command.v
        true.q += command.v * self._dt + late * (self._lag * (1.0 - left))
        true.v[:] = command.v + late * left
        self.measured = true.q.copy()
        state.advance(command.v, self._dt)
        state.q_measured = true.q.copy()

    def truth(self, state: State) -> State:
        """Where the joints are by now."""
        self._true.t = state.t
        self._true.update()
        return self._true

    def resume(self, before: PlantModel) -> None:
        """The motion goes on."""
        assert isinstance(before, LaggingModel)
        self._true.q[:], self._true.v[:] = before._true.q, before._true.v
        self.measured = before._true.q.copy()


@spec
class Lagging(Plant):
    """Joints that follow a commanded velocity with a first-order lag."""

    takes_torques: ClassVar[bool] = False

    lag: float = 0.02
    """Time after which 63 % of a step have arrived [s]."""

    def build(self, problem: ControlProblem, seed: int, disturbance: Disturbance) -> PlantModel:
        """Nothing to prepare."""
        return LaggingModel(problem, self.lag)
