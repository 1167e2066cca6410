"""Tables that cannot be."""

from __future__ import annotations

from typing import Any

import pytest

from coopqp.base.errors import InvalidValueError, UnknownNameError
from coopqp.robot_files.mdh import MdhRow
from coopqp.robots import MdhTable


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"name": "a", "gamma": 1, "gamma_deg": 1}, "not both"),
        ({"name": "a", "com": [0, 0, 1]}, "need a mass"),
        ({"name": "a", "sigma": "prismatic", "upper_deg": 3}, "a prismatic joint has no degrees"),
        ({"name": "a", "sigma": "helical"}, "'revolute', 'prismatic' or 'fixed'"),
        ({"name": "a", "velocity": 0}, "greater than 0"),
        ({"name": "a", "mass": 1, "inertia": [1, 0, 0, 1, 0, 3]}, "principal moments"),
    ],
)
def test_a_row_that_cannot_be_is_refused(row: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidValueError, match=message):
        MdhRow(**row)


def test_a_table_that_cannot_be_is_refused() -> None:
    row = MdhRow(name="a", antecedent="z")
    with pytest.raises(UnknownNameError, match="row a: unknown antecedent 'z'"):
        MdhTable(rows=(row,), arms={"x": "a"}).build()
