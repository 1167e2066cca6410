"""The grasps: one file each, the YAML name is the file's name."""

from coopqp.grasps.rigid import Rigid

__all__ = ["Rigid"]
