"""What is controlled: the plant takes a command and says where the joints are dt later."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from coopqp.controller import Command, ControlProblem
from coopqp.spec import spec
from coopqp.state import State


class PlantModel(ABC):
    """A plant built for one problem.

    Attributes:
        signals: what the plant tells beside the state, by name, written by each step; the trace
            keeps it.

    """

    signals: Mapping[str, NDArray[np.float64]] = MappingProxyType({})

    @abstractmethod
    def step(self, state: State, command: Command) -> None:
        """Carry the command out for one dt: writes t, q and v of the state, nothing else."""


@spec
class Plant:
    """A plug-in in ``plants/``: settings, and how to build the plant."""

    @abstractmethod
    def build(self, problem: ControlProblem, seed: int) -> PlantModel:
        """Make the plant, at rest at the chain's start.

        Raises:
            CoopqpError: the plant cannot be built for this problem.

        """
        raise NotImplementedError
