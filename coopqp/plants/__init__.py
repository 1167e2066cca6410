"""The plants: one file each, the YAML name is the file's name."""

from coopqp.plants.kinematic import Kinematic

__all__ = ["Kinematic"]
