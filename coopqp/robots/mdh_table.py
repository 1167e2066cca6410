"""A robot from the user's own table of modified Denavit-Hartenberg parameters.

Columns after Khalil and Kleinfinger (1986), the paper's eq. (2): see :mod:`coopqp.robot_files.mdh`.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from coopqp.base.spec import spec
from coopqp.robot import Robot, RobotModel
from coopqp.robot_files import mdh
from coopqp.robot_files.selection import Arms, Description, Locked, robot_model


@spec
class MdhTable(Robot):
    """A robot from its table after Khalil and Kleinfinger (modified Denavit-Hartenberg)."""

    rows: Annotated[tuple[mdh.MdhRow, ...], Field(min_length=1)]
    """The table, arm by arm, each row after its antecedent."""
    arms: Arms
    """Arms by name, each its tip (a row or one of tips) or {tip: frame, joints: [...]}."""
    tips: dict[str, mdh.Tip] = Field(default_factory=dict)
    """Frames of the hands, by name: {parent: row, offset: [m]}."""
    free: tuple[str, ...] = ()
    """Joints that join in besides those of the arms."""
    locked: Locked = Field(default_factory=dict)
    """Joints kept still: names, or names with values [rad or m]; others that move no tip too."""

    def build(self) -> RobotModel:
        model = mdh.build_model("mdh_table", self.rows, self.tips)
        return robot_model(
            Description(name=model.name, model=model),
            arms=self.arms,
            free=self.free,
            locked=self.locked,
        )
