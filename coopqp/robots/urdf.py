"""A robot from a URDF file."""

from __future__ import annotations

from pydantic import Field

from coopqp.base.errors import under
from coopqp.base.reading import FilePath
from coopqp.base.spec import spec
from coopqp.robot import Robot, RobotModel
from coopqp.robot_files.selection import Arms, JointLimits, Locked, robot_model
from coopqp.robot_files.urdf import read_urdf


@spec
class Urdf(Robot):
    """Any robot with a fixed base, from a URDF file."""

    path: FilePath
    """The file; relative to the scenario file's folder."""
    arms: Arms
    """Arms by name, each its tip's frame or {tip: frame, joints: [...]}."""
    free: tuple[str, ...] = ()
    """Joints that join in besides those of the arms."""
    locked: Locked = Field(default_factory=dict)
    """Joints kept still: names, or names with values [rad or m]; others that move no tip too."""
    joint_limits: dict[str, JointLimits] = Field(default_factory=dict)
    """Limits instead of the file's, by joint or pattern such as left_*."""
    package_dirs: tuple[FilePath, ...] = ()
    """Folders with the packages of package:// meshes, besides those above the file."""

    def build(self) -> RobotModel:
        with under("path"):
            description = read_urdf(self.path, self.package_dirs)
        return robot_model(
            description,
            arms=self.arms,
            free=self.free,
            locked=self.locked,
            joint_limits=self.joint_limits,
        )
