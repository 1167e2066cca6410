"""A robot by name from the package example-robot-data, such as Baxter, TIAGo, PR2 or Panda.

The package holds files alone: nothing of it is run, and meshes are not read.
"""

from collections import Counter
from functools import lru_cache
from importlib import metadata
from pathlib import Path

from coopqp.base.errors import UnknownNameError, needs
from coopqp.base.spec import spec
from coopqp.robot_files.selection import DescribedRobot, Description
from coopqp.robot_files.urdf import read_urdf

PACKAGE = "example-robot-data"
FOLDER = "cmeel.prefix/share/example-robot-data/robots"


@spec
class ExampleRobot(DescribedRobot):
    """A robot by name from the package example-robot-data (coopqp[robots])."""

    name: str
    """Of its URDF file without .urdf, such as baxter, tiago_dual, pr2, panda or ur5_robot."""

    def description(self) -> Description:
        known = robots()
        if self.name not in known:
            raise UnknownNameError("example robot", self.name, known).at("name")
        return _described(known[self.name])


#: The files of an installed package do not change.
_described = lru_cache(maxsize=16)(read_urdf)


def robots() -> dict[str, Path]:
    """The package's URDF files by name, or by folder and name; or MissingDependencyError."""
    with needs("robot 'example_robot'", "robots"):
        folder = Path(str(metadata.distribution(PACKAGE).locate_file(FOLDER)))
    return _listed(folder)


@lru_cache(maxsize=1)
def _listed(folder: Path) -> dict[str, Path]:
    files = sorted(folder.glob("*/*/*.urdf"))
    count = Counter(file.stem for file in files)
    return {
        file.stem if count[file.stem] == 1 else f"{file.parts[-3]}/{file.stem}": file
        for file in files
    }
