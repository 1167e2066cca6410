"""Objects that no body can be."""

from __future__ import annotations

import math

import pytest

from coopqp.base.errors import InvalidValueError
from coopqp.model.grasp_configuration import HeldObject


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mass": -0.2}, "greater than or equal to 0"),
        ({"mass": math.nan}, "finite"),
        ({"inertia": (1e-3, 0, 0, 1e-3, 0, 3e-3)}, "impossible"),
        ({"inertia": (1e-3, 0, 0, -1e-3, 0, 1e-3)}, "impossible"),
        ({"inertia": (1e-3, 5e-3, 0, 1e-3, 0, 1e-3)}, "impossible"),
        ({"inertia": (1e-3, 0, 0, 1e-3)}, "needs 6 numbers"),
        ({"com": (0.0, 0.0)}, "needs 3 numbers"),
    ],
)
def test_object_that_no_body_can_be(values: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidValueError, match=message) as caught:
        HeldObject(**values)
    assert len(str(caught.value).splitlines()) == 1
