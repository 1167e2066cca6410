"""What a plant does that the controller was not told: a heavier object, a push, noise, delay."""

from __future__ import annotations

from typing import Annotated

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


@spec
class Disturbance:
    """All that the controller does not know; for dynamic plants."""

    object_mass: Positive = 1.0
    """Mass and inertia of the real object over those of the model."""
    push: Push | None = None
    """On the object."""
    noise_position: NonNegative = 0.0
    """Standard deviation of each measured joint position [rad, m]."""
    noise_velocity: NonNegative = 0.0
    """Standard deviation of each measured joint velocity [rad/s, m/s]."""
    delay: Annotated[int, Field(ge=0, le=1000)] = 0
    """Ticks that a command is late."""

    @property
    def none(self) -> bool:
        """Whether nothing is disturbed."""
        return self == Disturbance()

    def wrench(self, t: float) -> Array | None:
        """The push at time t [s]."""
        return self.push.wrench(t) if self.push else None
