"""Every grasp with settings of an example."""

from __future__ import annotations

from coopqp.grasp import Grasp
from coopqp.grasps import PointContact, Prismatic, Revolute, Rigid, Spherical, SurfaceContact

EXAMPLES: dict[str, Grasp] = {
    "rigid": Rigid(),
    "hinge": Revolute(point=(0.0, 0.0, -0.05)),
    "hinge about the world's z": Revolute(axis=(0, 0, 1), axis_in="world"),
    "slide": Prismatic(),
    "ball": Spherical(),
    "pad": SurfaceContact(normal=(1, 0, 0)),
    "fingertip": PointContact(normal=(1, 0, 0), edges=12),
}
