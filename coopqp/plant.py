"""What is controlled: the plant takes a command and says where the joints are dt later."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from coopqp.checked import Array, spec
from coopqp.controller import Command, ControlProblem
from coopqp.disturbance import Disturbance
from coopqp.state import State


class PlantModel(ABC):
    """A plant built for one problem.

    Attributes:
        signals: what the plant tells beside the state, by name, written by each step; the trace
            keeps it.
    """

    def __init__(self) -> None:
        self.signals = {}

    signals: dict[str, Array]

    @abstractmethod
    def step(self, state: State, command: Command) -> None:
        """Carry the command out for one dt: writes t, q and v of the state, nothing else."""

    @abstractmethod
    def configuration(self, state: State) -> Array:
        """Where the joints really are, which is not what noisy sensors say, shape (n,).

        Args:
            state: as the last step left it.
        """

    @abstractmethod
    def resume(self, before: PlantModel) -> None:
        """Go on from where the plant of the phase before stopped, with other arms holding.

        Args:
            before: of the same type.
        """


@spec
class Plant(ABC):
    """A plug-in in ``plants/``: settings, and how to build the plant."""

    takes_torques: ClassVar[bool] = True
    """Whether torques can be commanded, and disturbances have an effect."""

    @abstractmethod
    def build(self, problem: ControlProblem, seed: int, disturbance: Disturbance) -> PlantModel:
        """Make the plant, at rest at the chain's start.

        Args:
            problem: what the controller was built for.
            seed: of everything random.
            disturbance: what the controller does not know.

        Raises:
            CoopqpError: the plant cannot be built for this problem.
        """
