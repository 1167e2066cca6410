"""What a plant does that the controller was not told: a heavier object, a push, noise, delay.

And errors of the model that it was told: links a little longer, encoders a little off, the object
a little elsewhere in the hands. Their signs and directions are chance's, by the scenario's seed.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from coopqp.checked import Array, NonNegative, Positive, Vector3, spec


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
