"""Every controller as it is without settings."""

from __future__ import annotations

import pytest
from example_settings import examples

from coopqp.controller import Controller

EXAMPLES: dict[str, Controller] = examples("controllers")
OF_VELOCITY = {name: c for name, c in EXAMPLES.items() if not c.commands_torques}

each_controller = pytest.mark.parametrize(
    "controller", OF_VELOCITY.values(), ids=OF_VELOCITY.keys()
)
