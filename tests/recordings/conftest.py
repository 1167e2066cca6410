"""A run in phases, on a plant with sensors, under two laws, written as a report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest
from scenario_files import HEAD, NO_DRIFT, PHASES

from coopqp.execution.comparison import Comparison, compare
from coopqp.recordings import EXPORTS, export, read
from coopqp.report import files
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import load

NOISY = "plant: rigid_body\ndisturbance: {noise_position: 0.0001, grasp_offset: 0.002}\n"


@dataclass(frozen=True)
class Written:
    """A report, and qp's run in every format.

    Attributes:
        trace_csv: of the report.
        exported: by format.
        comparison: as it was in memory.
    """

    trace_csv: Path
    exported: dict[str, Path]
    comparison: Comparison


@pytest.fixture(scope="session")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    folder = tmp_path_factory.mktemp("recordings")
    given = folder / "given.yaml"
    given.write_text(HEAD + PHASES + NO_DRIFT + NOISY, encoding="utf-8")
    comparison = compare(load(given), controllers=["qp", "pseudoinverse"])
    files.write(comparison, folder)
    trace = folder / "trace.csv"
    scenario = load(folder / "scenario.yaml", Catalog())
    exported = {known.name: folder / f"qp.{known.name}" for known in EXPORTS}
    for name, path in exported.items():
        export(read(trace), scenario, name, "qp", path)
    return Written(trace, exported, comparison)
