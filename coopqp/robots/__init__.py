"""The robots: one file each, the YAML name is the file's name."""

from coopqp.robots.nao_t14 import NaoT14
from coopqp.robots.planar_pair import PlanarPair

__all__ = ["NaoT14", "PlanarPair"]
