"""The robots: one file each, the YAML name is the file's name."""

from coopqp.robots.example_robot import ExampleRobot as ExampleRobot
from coopqp.robots.mdh_table import MdhTable as MdhTable
from coopqp.robots.mjcf import Mjcf as Mjcf
from coopqp.robots.nao_t14 import NaoT14 as NaoT14
from coopqp.robots.planar_pair import PlanarPair as PlanarPair
from coopqp.robots.several import Several as Several
from coopqp.robots.urdf import Urdf as Urdf
