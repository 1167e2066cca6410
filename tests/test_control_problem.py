"""Problems that make no sense are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from laws import DT, NEAR, problem

from coopqp.base.errors import InvalidValueError
from coopqp.model.closed_chain import ClosedChain
from coopqp.tasks import JointCentering, PointOnPoint


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"dt": 0.0}, "dt"),
        ({"dt": np.nan}, "dt"),
        ({"kappa": -1.0}, "kappa"),
        ({"kappa": 1.1 / DT}, "kappa"),
        ({"secondary": [JointCentering(name="centre", mode="hard")]}, ", secondary"),
        ({"secondary": [JointCentering(name="centre", gain=101.0)]}, "centre"),
    ],
)
def test_problem_that_makes_no_sense_is_refused(
    settings: dict[str, Any], named: str, chain: ClosedChain
) -> None:
    with pytest.raises(InvalidValueError, match=named):
        problem(chain, PointOnPoint(goal=NEAR), **{"kappa": 0.0, **settings})


def test_gain_that_overshoots_in_one_tick_is_refused(chain: ClosedChain) -> None:
    with pytest.raises(InvalidValueError, match="reach"):
        problem(chain, PointOnPoint(goal=NEAR, name="reach", gain=101.0))
