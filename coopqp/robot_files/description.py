"""What a file says of a whole robot, before arms are chosen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import pinocchio as pin

from coopqp.robot import Shape


@dataclass(frozen=True, kw_only=True)
class Follower:
    """A joint that follows another one: its value is ratio times the leader's plus offset.

    Without a leader (an empty name) it has one value for good.
    """

    leader: str
    ratio: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Description:
    """All that a file says of a robot.

    Attributes:
        name: of the robot.
        model: pinocchio model of all joints.
        followers: joints that follow others (mimic), by name.
        floating: joints that the model leaves out because they are free in space, each with the
            frames that they would move.
        shapes, collision_shapes, unseen, warnings: as in :class:`coopqp.robot.RobotModel`.
        places: file and line of joints, by name.
    """

    name: str
    model: pin.Model
    followers: Mapping[str, Follower] = field(default_factory=dict)
    floating: Mapping[str, frozenset[str]] = field(default_factory=dict)
    shapes: tuple[Shape, ...] = ()
    collision_shapes: tuple[Shape, ...] = ()
    unseen: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    places: Mapping[str, str] = field(default_factory=dict)

    @property
    def joint_names(self) -> list[str]:
        """Of the model's joints and of those left out."""
        return [*list(self.model.names)[1:], *self.floating]

    def joint(self, name: str) -> str:
        """``FILE:LINE: joint r1``, or without its place where it has none."""
        place = self.places.get(name)
        return f"{place}: joint {name}" if place else f"joint {name}"
