"""A robot by name from the package example-robot-data, such as Baxter, TIAGo, PR2 or Panda.

The package holds files alone: nothing of it is run, and meshes are not read.
"""

from __future__ import annotations

from collections import Counter
from functools import lru_cache
from importlib import metadata
from pathlib import Path

from pydantic import Field

from coopqp.base.errors import MissingDependencyError, UnknownNameError
from coopqp.base.spec import spec
from coopqp.robot import Robot, RobotModel
from coopqp.robot_files.selection import Arms, Description, JointLimits, Locked, robot_model
from coopqp.robot_files.urdf import read_urdf

PACKAGE = "example-robot-data"
FOLDER = "cmeel.prefix/share/example-robot-data/robots"


@spec
class ExampleRobot(Robot):
    """A robot by name from the package example-robot-data (coopqp[robots])."""

    name: str
    """Of its URDF file without .urdf, such as baxter, tiago_dual, pr2, panda or ur5_robot."""
    arms: Arms
    """Arms by name, each its tip's frame or {tip: frame, joints: [...]}."""
    free: tuple[str, ...] = ()
    """Joints that join in besides those of the arms."""
    locked: Locked = Field(default_factory=dict)
    """Joints kept still: names, or names with values [rad or m]; others that move no tip too."""
    joint_limits: dict[str, JointLimits] = Field(default_factory=dict)
    """Limits instead of the file's, by joint or pattern such as left_*."""

    def build(self) -> RobotModel:
        known = robots()
        if self.name not in known:
            raise UnknownNameError("example robot", self.name, known).at("name")
        return robot_model(
            _described(known[self.name]),
            arms=self.arms,
            free=self.free,
            locked=self.locked,
            joint_limits=self.joint_limits,
        )


@lru_cache(maxsize=16)
def _described(file: Path) -> Description:
    """What a file says; the files of an installed package do not change."""
    return read_urdf(file)


def robots() -> dict[str, Path]:
    """The package's URDF files by name, or by folder and name; or MissingDependencyError."""
    try:
        folder = Path(str(metadata.distribution(PACKAGE).locate_file(FOLDER)))
    except metadata.PackageNotFoundError:
        raise MissingDependencyError("robot 'example_robot'", "robots") from None
    return _listed(folder)


@lru_cache(maxsize=1)
def _listed(folder: Path) -> dict[str, Path]:
    files = sorted(folder.glob("*/*/*.urdf"))
    count = Counter(file.stem for file in files)
    return {
        file.stem if count[file.stem] == 1 else f"{file.parts[-3]}/{file.stem}": file
        for file in files
    }
