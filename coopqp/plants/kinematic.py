"""Joints that follow commands exactly: q <- q + v dt."""

from typing import ClassVar

from coopqp.base.spec import spec
from coopqp.controller import Command, ControlProblem
from coopqp.model.state import State
from coopqp.plant import Disturbance, Plant, PlantModel
from coopqp.plants._true_chain import slipped, true_chain


class KinematicModel(PlantModel):
    """Perfect joint velocity servos with a control period dt [s]."""

    ideal = True

    def __init__(self, dt: float) -> None:
        super().__init__()
        self._dt = dt

    def step(self, state: State, command: Command) -> None:
        """One Euler step, which is exact for a velocity held constant."""
        state.advance(command.v, self._dt)

    def resume(self, before: PlantModel) -> None:
        """Nothing: the state has all of it."""


class MisledModel(PlantModel):
    """Perfect servos of arms that differ from the model."""

    def __init__(self, problem: ControlProblem, seed: int, disturbance: Disturbance) -> None:
        super().__init__()
        self._dt, self._seed, self._disturbance = problem.dt, seed, disturbance
        self._t, self._slipped = 0.0, 0.0
        self._occupy(State(true_chain(problem.chain, seed, disturbance)))

    def step(self, state: State, command: Command) -> None:
        """One Euler step; joints are as commanded, the hands are not."""
        state.advance(command.v, self._dt)
        self._t += self._dt
        self._true.q[:] = state.q
        self.measured = state.q.copy()
        state.q_measured = state.q.copy()
        distance = self._disturbance.slipped(self._t)
        if distance != self._slipped:
            chain = slipped(self._true.chain, self._seed, distance - self._slipped)
            self._slipped = distance
            self._occupy(State(chain, self._true.q))

    def truth(self, state: State) -> State:
        """Where the hands really are; nothing holds them together."""
        self._true.t, self._true.v[:] = state.t, state.v
        self._true.update()
        return self._true

    def resume(self, before: PlantModel) -> None:
        assert isinstance(before, MisledModel)
        q, released = before._true.q, self._true.chain.hold.released
        self._t, self._slipped = before._t, before._slipped
        self._occupy(State(before._true.chain.handed_over(q, released)))

    def _occupy(self, true: State) -> None:
        self._true = true
        self.measured = true.q.copy()


@spec
class Kinematic(Plant):
    """Joints that follow commands exactly, q + v dt: shows the control law and nothing else."""

    takes_torques: ClassVar[bool] = False

    def build(self, problem: ControlProblem, seed: int, disturbance: Disturbance) -> PlantModel:
        """With errors of the model the arms begin where the real hands hold the object."""
        if disturbance.kinematic == Disturbance():
            return KinematicModel(problem.dt)
        return MisledModel(problem, seed, disturbance)
