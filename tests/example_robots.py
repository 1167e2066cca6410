"""Every robot with settings of an example; files are written into a folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from nao_in_files import in_mjcf, in_table, in_urdf

from coopqp.robot import Robot
from coopqp.robots import ExampleRobot, NaoT14, PlanarPair, Several

BAXTER = {"right": "right_gripper", "left": "left_gripper"}

#: The last one needs coopqp[robots].
EXAMPLES: dict[str, Callable[[Path], Robot]] = {
    "nao_t14": lambda _: NaoT14(),
    "planar_pair": lambda _: PlanarPair(),
    "urdf": in_urdf,
    "mjcf": in_mjcf,
    "mdh_table": in_table,
    "several": lambda _: Several(
        robots={"a": {"robot": NaoT14()}, "b": {"robot": PlanarPair(), "position": (1.0, 0, 0)}}
    ),
    "example_robot": lambda _: ExampleRobot(name="baxter", arms=BAXTER),
}
