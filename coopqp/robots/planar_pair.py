"""Two arms of three joints in one plane: the smallest over-constrained pair.

All axes point up. Three of the six loop rows (z, rot_x, rot_y) follow from the others.
"""

import math
from typing import Any

from coopqp.base.spec import Lengths3, Positive, spec
from coopqp.robot import Arm, Robot, RobotModel
from coopqp.robot_files import mdh


@spec
class PlanarPair(Robot):
    """Two 3R arms in the horizontal plane, side by side; x forward, y left."""

    lengths: Lengths3 = (0.3, 0.25, 0.1)
    """Of the three links [m]."""
    distance: Positive = 0.4
    """Between the two bases [m]."""
    density: Positive = 1.5
    """Mass of a link per length [kg/m]."""
    range_deg: Positive = 150.0
    """Every joint goes this far both ways [degrees]."""
    velocity: Positive = 3.0
    """Of every joint [rad/s]."""
    effort: Positive = 20.0
    """Of every joint [N m]."""

    def build(self) -> RobotModel:
        """Six joints, right arm first, with tips "right_hand" and "left_hand"."""
        rows = [*self._arm("right", -1.0), *self._arm("left", 1.0)]
        tips = {
            f"{side}_hand": mdh.Tip(parent=f"{side}_3", offset=(self.lengths[2], 0.0, 0.0))
            for side in ("right", "left")
        }
        model = mdh.build_model("planar_pair", rows, tips)
        arms = tuple(Arm(name=side, tip=f"{side}_hand") for side in ("right", "left"))
        return RobotModel(name="planar_pair", model=model, arms=arms)

    def _arm(self, side: str, y: float) -> list[mdh.MdhRow]:
        # The base lies sideways: turn to it, go there, and turn back.
        aside = y * math.pi / 2
        parameters = (
            mdh.MdhParameters(gamma=aside, d=0.5 * self.distance, theta=-aside),
            mdh.MdhParameters(d=self.lengths[0]),
            mdh.MdhParameters(d=self.lengths[1]),
        )
        reach = math.radians(self.range_deg)
        return [
            mdh.MdhRow(
                name=f"{side}_{i + 1}",
                antecedent=f"{side}_{i}" if i else None,
                **vars(p),
                lower=-reach, upper=reach, velocity=self.velocity, effort=self.effort,
                **self._rod(length),
            )
            for i, (p, length) in enumerate(zip(parameters, self.lengths, strict=True))
        ]  # fmt: skip

    def _rod(self, length: float) -> dict[str, Any]:
        mass = self.density * length
        across, along = mass * length**2 / 12.0, 1e-3 * mass * length**2
        inertia = along, 0.0, 0.0, across, 0.0, across
        return {"mass": mass, "com": (0.5 * length, 0.0, 0.0), "inertia": inertia}
