"""The plants: one file each, the YAML name is the file's name."""

from coopqp.plants.kinematic import Kinematic
from coopqp.plants.mujoco import Mujoco
from coopqp.plants.quasi_static import QuasiStatic
from coopqp.plants.rigid_body import RigidBody

__all__ = ["Kinematic", "Mujoco", "QuasiStatic", "RigidBody"]
