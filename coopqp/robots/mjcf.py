"""A robot from a MuJoCo file (MJCF)."""

from coopqp.base.errors import under
from coopqp.base.reading import FilePath
from coopqp.base.spec import spec
from coopqp.robot_files.mjcf import read_mjcf
from coopqp.robot_files.selection import DescribedRobot, Description


@spec
class Mjcf(DescribedRobot):
    """Any robot with a fixed base, from a MuJoCo file (MJCF).

    MJCF knows no velocity limits: give them under joint_limits.
    """

    path: FilePath
    """The file; relative to the scenario file's folder."""

    def description(self) -> Description:
        with under("path"):
            return read_mjcf(self.path)
