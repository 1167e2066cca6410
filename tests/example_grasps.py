"""Every grasp with settings of an example."""

from __future__ import annotations

from coopqp.grasp import Grasp
from coopqp.grasps import Prismatic, Revolute, Rigid, Spherical

EXAMPLES: dict[str, Grasp] = {
    "rigid": Rigid(),
    "hinge": Revolute(point=(0.0, 0.0, -0.05)),
    "hinge about the world's z": Revolute(axis=(0, 0, 1), axis_in="world"),
    "slide": Prismatic(),
    "ball": Spherical(),
}
