"""The scenario whose joints run into their limits, compared and written."""

from __future__ import annotations

from pathlib import Path

import pytest
from plate_study import plate_in

from coopqp.controllers import QPController
from coopqp.execution.comparison import Comparison, compare
from coopqp.qp_law.law import QPLaw
from coopqp.report import files
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario


@pytest.fixture(scope="session")
def scenario() -> Scenario:
    return load("joint_limit_stress")


@pytest.fixture(scope="session")
def compared(scenario: Scenario) -> Comparison:
    return compare(scenario, controllers=["qp", "pseudoinverse"])


@pytest.fixture(scope="session")
def trace_csv(compared: Comparison, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    files.write(compared, folder)
    return folder / "trace.csv"


@pytest.fixture(scope="session")
def law(scenario: Scenario) -> QPLaw:
    controller = scenario.controllers["qp"]
    assert isinstance(controller, QPController)
    return controller.plain(scenario.problem())


@pytest.fixture
def plate(tmp_path: Path) -> Path:
    """A folder with a study of eight variants of ten ticks."""
    return plate_in(tmp_path)
