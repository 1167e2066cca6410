"""A robot from a URDF file."""

from coopqp.base.errors import under
from coopqp.base.reading import FilePath
from coopqp.base.spec import spec
from coopqp.robot_files.selection import DescribedRobot, Description
from coopqp.robot_files.urdf import read_urdf


@spec
class Urdf(DescribedRobot):
    """Any robot with a fixed base, from a URDF file."""

    path: FilePath
    """The file; relative to the scenario file's folder."""
    package_dirs: tuple[FilePath, ...] = ()
    """Folders with the packages of package:// meshes, besides those above the file."""

    def description(self) -> Description:
        with under("path"):
            return read_urdf(self.path, self.package_dirs)
