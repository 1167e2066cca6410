"""The plants: one file each, the YAML name is the file's name."""

from coopqp.plants.kinematic import Kinematic as Kinematic
from coopqp.plants.mujoco import Mujoco as Mujoco
from coopqp.plants.quasi_static import QuasiStatic as QuasiStatic
from coopqp.plants.rigid_body import RigidBody as RigidBody
