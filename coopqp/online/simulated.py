"""A scenario's plant in the place of a robot."""

import numpy as np

from coopqp.base.spec import Array
from coopqp.controller import Command
from coopqp.model.state import State
from coopqp.online.loop import OnlineLoop
from coopqp.plant import PlantModel


class SimulatedRobot:
    """The plant of a loop's scenario with a robot's methods; each write simulates one period.

    With the plant ``kinematic`` and ``reference="measured"`` the loop is bit-equal to a comparison.

    Attributes:
        plant, state: with its signals, such as forces; its state, which is not the loop's.
    """

    def __init__(self, loop: OnlineLoop) -> None:
        self._loop, self._index = loop, 0
        self.plant = self._built()
        self.state = State(loop.problem.chain, self.plant.measured)
        self._command = Command(loop.problem.chain.n)

    def read(self) -> Array:
        """As of :class:`coopqp.online.real_time.Robot`, or TorqueRobot; NaN is a lost reading."""
        state = self.state
        measured = self.plant.measured if state.q_measured is None else state.q_measured
        q = state.q.copy() if measured is None else measured.copy()
        return np.stack([q, state.v]) if self._loop.by_torques else q

    def apply(self, tau: Array) -> None:
        """Simulate one period with torques, shape (n,) [N m]."""
        self._command.tau = tau
        self.write(self.state.q, np.zeros_like(tau))

    def write(self, q: Array, v: Array) -> None:
        """Simulate one period."""
        if len(self._loop.phases) - 1 > self._index:
            self._hand_over()
        self._command.v[:] = v
        self.plant.step(self.state, self._command)

    def _built(self) -> PlantModel:
        return self._loop.scenario.simulated(self._loop.problem)

    def _hand_over(self) -> None:
        before, old, self._index = self.plant, self.state, len(self._loop.phases) - 1
        self.plant = self._built()
        self.plant.resume(before)
        self.state = State(self._loop.problem.chain, old.q)
        self.state.v[:] = old.v
        if self.plant.measured is not None:
            np.copyto(self.state.q, self.plant.measured)
