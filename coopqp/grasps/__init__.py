"""The grasps: one file each, the YAML name is the file's name."""

from coopqp.grasps.point_contact import PointContact as PointContact
from coopqp.grasps.prismatic import Prismatic as Prismatic
from coopqp.grasps.revolute import Revolute as Revolute
from coopqp.grasps.rigid import Rigid as Rigid
from coopqp.grasps.spherical import Spherical as Spherical
from coopqp.grasps.surface_contact import SurfaceContact as SurfaceContact
