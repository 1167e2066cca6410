"""The grasps: one file each, the YAML name is the file's name."""

from coopqp.grasps.point_contact import PointContact
from coopqp.grasps.prismatic import Prismatic
from coopqp.grasps.revolute import Revolute
from coopqp.grasps.rigid import Rigid
from coopqp.grasps.spherical import Spherical
from coopqp.grasps.surface_contact import SurfaceContact

__all__ = ["PointContact", "Prismatic", "Revolute", "Rigid", "Spherical", "SurfaceContact"]
