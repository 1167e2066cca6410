"""The robots: one file each, the YAML name is the file's name."""

from coopqp.robots.example_robot import ExampleRobot
from coopqp.robots.mdh_table import MdhTable
from coopqp.robots.mjcf import Mjcf
from coopqp.robots.nao_t14 import NaoT14
from coopqp.robots.planar_pair import PlanarPair
from coopqp.robots.several import Several
from coopqp.robots.urdf import Urdf

__all__ = ["ExampleRobot", "MdhTable", "Mjcf", "NaoT14", "PlanarPair", "Several", "Urdf"]
