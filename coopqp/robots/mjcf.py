"""A robot from a MuJoCo file (MJCF).

MJCF knows no velocity limits: give them under joint_limits.
"""

from __future__ import annotations

from pydantic import Field

from coopqp.base.errors import under
from coopqp.base.reading import FilePath
from coopqp.base.spec import spec
from coopqp.robot import Robot, RobotModel
from coopqp.robot_files.mjcf import read_mjcf
from coopqp.robot_files.selection import Arms, JointLimits, Locked, robot_model


@spec
class Mjcf(Robot):
    """Any robot with a fixed base, from a MuJoCo file (MJCF)."""

    path: FilePath
    """The file; relative to the scenario file's folder."""
    arms: Arms
    """Arms by name, each its tip's frame (body, site, joint) or {tip: frame, joints: [...]}."""
    free: tuple[str, ...] = ()
    """Joints that join in besides those of the arms."""
    locked: Locked = Field(default_factory=dict)
    """Joints kept still: names, or names with values [rad or m]; others that move no tip too."""
    joint_limits: dict[str, JointLimits] = Field(default_factory=dict)
    """Limits instead of the file's, by joint or pattern such as left_*; MJCF has no velocities."""

    def build(self) -> RobotModel:
        with under("path"):
            description = read_mjcf(self.path)
        return robot_model(
            description,
            arms=self.arms,
            free=self.free,
            locked=self.locked,
            joint_limits=self.joint_limits,
        )
