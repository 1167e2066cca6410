"""What is controlled: the plant takes a command and says where the joints are dt later."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from coopqp.base.spec import Array, NonNegative, Positive, Vector3, spec
from coopqp.controller import Command, ControlProblem
from coopqp.model.state import State


@spec
class Push:
    """A constant wrench on the object for a while."""

    force: Vector3 = (0.0, 0.0, 0.0)
    """In the world, at the object's origin [N]."""
    torque: Vector3 = (0.0, 0.0, 0.0)
    """In the world [N m]."""
    start: NonNegative
    """When it begins [s]."""
    duration: Positive
    """How long it lasts [s]."""

    def wrench(self, t: float) -> Array | None:
        """(force; torque) at time t [s], None when there is none."""
        if self.start <= t < self.start + self.duration:
            return np.array([*self.force, *self.torque])
        return None


Length = Annotated[float, Field(ge=0.0, le=0.02)]
"""Of an error of the model [m]; with more the model is of another robot."""
Angle = Annotated[float, Field(ge=0.0, le=0.1)]
"""Of an error of the model [rad]."""


@spec
class Slip:
    """The object slips in the hand of the last arm that holds it."""

    at: NonNegative
    """When it begins [s]."""
    by: Annotated[float, Field(gt=0.0, le=0.02)]
    """How far [m]."""

    #: How long it takes [s].
    DURATION: ClassVar[float] = 0.1

    def distance(self, t: float) -> float:
        """How far it has slipped at time t [m]."""
        return self.by * min(max((t - self.at) / self.DURATION, 0.0), 1.0)


@spec
class Disturbance:
    """All that the controller does not know; all plants know errors of the model and slip."""

    object_mass: Positive = 1.0
    """Mass and inertia of the real object over those of the model."""
    object_com: Vector3 = (0.0, 0.0, 0.0)
    """How far the real centre of mass is from the modelled one, in the object [m]."""
    friction: Positive = 1.0
    """Of the real contacts over the modelled one."""
    push: Push | None = None
    """On the object."""
    noise_position: NonNegative = 0.0
    """Standard deviation of each measured joint position [rad, m]."""
    noise_velocity: NonNegative = 0.0
    """Standard deviation of each measured joint velocity, which torque controllers read [rad/s]."""
    delay: Annotated[int, Field(ge=0, le=1000)] = 0
    """Ticks that a command is late."""
    link_length: Length = 0.0
    """Each link is longer or shorter than the model says by this [m]."""
    encoder_offset: Angle = 0.0
    """Each turning joint's encoder says more or less than its angle by this [rad]."""
    grasp_offset: Length = 0.0
    """Each hand holds the object this far from where the model says [m]."""
    grasp_offset_angle: Angle = 0.0
    """And turned by this [rad]."""
    slip: Slip | None = None
    """Of the object in a hand."""

    @property
    def kinematic(self) -> Disturbance:
        """The part that does not need masses."""
        return Disturbance(
            link_length=self.link_length,
            encoder_offset=self.encoder_offset,
            grasp_offset=self.grasp_offset,
            grasp_offset_angle=self.grasp_offset_angle,
            slip=self.slip,
        )

    def slipped(self, t: float) -> float:
        """How far the object has slipped at time t [m]."""
        return self.slip.distance(t) if self.slip else 0.0

    def wrench(self, t: float) -> Array | None:
        """The push at time t [s]."""
        return self.push.wrench(t) if self.push else None


class PlantModel(ABC):
    """A plant built for one problem.

    Attributes:
        signals: what the plant tells beside the state, by name, written by each step, recorded.
        measured: measured joint positions, shape (n,) [rad, m], where a run and each phase begin;
            None where joints follow their commands exactly.
        lost: which hand has lost the object and why, where the plant cannot go on; else empty.
    """

    ideal: bool = False
    """Whether a step is :meth:`State.advance` alone, so that many may be done at once."""

    def __init__(self) -> None:
        self.lost = ""
        self.signals: dict[str, Array] = {}
        self.measured: Array | None = None

    @property
    def hand_wrench(self) -> Array | None:
        """What the force sensors say now, ``State.hand_wrench``; None where there are none."""
        measured = self.signals.get("hand_wrench")
        return None if measured is None else measured.copy()

    @abstractmethod
    def step(self, state: State, command: Command) -> None:
        """Carry the command out for one dt: writes t, q, v and what is measured of the state.

        After a velocity command q is the commanded configuration and v the commanded velocity,
        :meth:`State.advance`, and q_measured is the measured one: limits, damping and the Baumgarte
        correction use the commands, not what a servo has made of them so far. After
        a torque command q and v are measured, and q_measured is None. Plants that know what the
        hands do to the object write hand_wrench.
        """

    def truth(self, state: State) -> State:
        """The true joints, object and loops, up to date; for an ideal plant the state itself."""
        return state

    @abstractmethod
    def resume(self, before: PlantModel) -> None:
        """Go on from where the previous phase's plant, of this type, stopped; other arms hold."""


@spec
class Plant(ABC):
    """A plug-in in ``plants/``: settings, and how to build the plant."""

    takes_torques: ClassVar[bool] = True
    """Whether torques can be commanded, and disturbances have an effect."""

    @abstractmethod
    def build(self, problem: ControlProblem, seed: int, disturbance: Disturbance) -> PlantModel:
        """Make the plant of the controller's problem, at rest at the chain's start; or CoopqpError.

        ``seed`` is that of everything random, the disturbance is unknown to the controller.
        """
