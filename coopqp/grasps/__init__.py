"""The grasps: one file each, the YAML name is the file's name."""

from coopqp.grasps.prismatic import Prismatic
from coopqp.grasps.revolute import Revolute
from coopqp.grasps.rigid import Rigid
from coopqp.grasps.spherical import Spherical

__all__ = ["Prismatic", "Revolute", "Rigid", "Spherical"]
