"""What a robot is to the loop: it says where its joints are, and takes where they shall go."""

from __future__ import annotations

from typing import Protocol

from numpy.typing import ArrayLike

from coopqp.checked import Array


class Robot(Protocol):
    """A driver of a robot; any class with these two methods."""

    def read(self) -> ArrayLike | None:
        """Where the joints are now, shape (n,) [rad, m]; None where the robot says nothing.

        In the order of the chain's joints; without the grasps' passive joints it is taken for the
        robot's own. It returns what came last and does not wait. Where that came before the tick
        before, None is the better answer, with ``silent_after`` of the loop: a joint may have gone
        farther in many ticks than in one.
        """

    def write(self, q: Array, v: Array) -> None:
        """Take a command.

        Args:
            q: where the joints shall be at the end of the period, shape (n,) [rad, m]; for robots
                that take positions.
            v: how fast they go there, shape (n,) [rad/s, m/s]; for robots that take velocities.
                Zero tells it to stand still.
        """
