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
        measured: where the sensors say that the joints are, shape (n,) [rad, m]; None where the
            joints do exactly as told. A run begins there, and so does each phase.
        lost: which hand has lost the object and why, where the plant cannot go on without; empty
            while it is held.
    """

    def __init__(self) -> None:
        self.lost = ""
        self.signals = {}
        self.measured = None

    as_told: bool = False
    """Whether a step is :meth:`State.advance` alone, so that many may be done at once."""
    signals: dict[str, Array]
    measured: Array | None
    lost: str

    @property
    def hand_wrench(self) -> Array | None:
        """What the force sensors say now, ``State.hand_wrench``; None where there are none."""
        told = self.signals.get("hand_wrench")
        return None if told is None else told.copy()

    @abstractmethod
    def step(self, state: State, command: Command) -> None:
        """Carry the command out for one dt: writes t, q, v and what is measured of the state.

        After a velocity command q is the commanded configuration and v the commanded velocity,
        :meth:`State.advance`, and q_measured says where the joints are: limits, damping and the
        drift correction go by what was asked for, not by what a servo has made of it so far. After
        a torque command q and v are measured, and q_measured is None. Plants that know what the
        hands do to the object write hand_wrench.
        """

    def truth(self, state: State) -> State:
        """What is really so: joints, object and loops, with the kinematics up to date.

        The state itself where joints do exactly as told and the model has no errors.

        Args:
            state: as the last step left it, or as the run began.
        """
        return state

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
