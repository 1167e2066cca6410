"""A robot from the user's own table of modified Denavit-Hartenberg parameters.

Columns after Khalil and Kleinfinger (1986), the paper's eq. (2): see :mod:`coopqp.robot_files.mdh`.
"""

from typing import Annotated

from pydantic import Field

from coopqp.base.spec import spec
from coopqp.robot_files import mdh
from coopqp.robot_files.selection import DescribedRobot, Description


@spec
class MdhTable(DescribedRobot):
    """A robot from its table after Khalil and Kleinfinger (modified Denavit-Hartenberg)."""

    rows: Annotated[tuple[mdh.MdhRow, ...], Field(min_length=1)]
    """The table, arm by arm, each row after its antecedent."""
    tips: dict[str, mdh.Tip] = Field(default_factory=dict)
    """Frames of the hands, by name: {parent: row, offset: [m]}."""

    def description(self) -> Description:
        model = mdh.build_model("mdh_table", self.rows, self.tips)
        return Description(name=model.name, model=model)
