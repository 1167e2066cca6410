"""Every controller that commands velocities."""

from __future__ import annotations

import pytest

from coopqp.controller import Controller
from coopqp.controllers import (
    DampedPseudoinverse,
    Pseudoinverse,
    PseudoinverseNullSpace,
    QPController,
)

CONTROLLERS: dict[str, Controller] = {
    "qp": QPController(),
    "pseudoinverse": Pseudoinverse(),
    "null space": PseudoinverseNullSpace(),
    "damped": DampedPseudoinverse(),
}
each_controller = pytest.mark.parametrize(
    "controller", CONTROLLERS.values(), ids=CONTROLLERS.keys()
)
