"""One NAO, one job, for every benchmark."""

from __future__ import annotations

import pytest

import coopqp
from coopqp.scenario.scenario import Scenario


@pytest.fixture(scope="session")
def scenario() -> Scenario:
    """The job that all systems do: NAO holds a box, a point goes to a point."""
    return coopqp.load("point_on_point")
