"""Joints that are measured, and phases: the kernel moves real arms as the plain law does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenario_files import HEAD, PHASES, TAIL, phased
from side_by_side import needs_kernel

from coopqp.controllers import QPController
from coopqp.execution.controller_run import run
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.trace import Trace

pytestmark = needs_kernel


def by_engine(scenario: Scenario) -> tuple[Trace, Trace]:
    """The same scenario with the kernel, and in Python."""
    kernel, python = (
        run(replace(scenario, controllers={"qp": QPController(engine=engine)}), controller="qp")
        for engine in ("kernel", "python")
    )
    return kernel, python


@pytest.mark.parametrize("plant", ["kinematic", "mujoco"])
def test_phases_are_gone_through_alike(plant: str, tmp_path: Path) -> None:
    """Hands let go and take hold again, on joints that do as told and on joints with masses."""
    if plant == "mujoco":
        pytest.importorskip("mujoco")
    kernel, python = by_engine(phased(tmp_path, HEAD + PHASES + TAIL + f"plant: {plant}\n"))
    assert kernel.compiled.mean() > 0.95
    assert kernel.status == python.status
    np.testing.assert_allclose(kernel.q, python.q, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(kernel.v, python.v, rtol=0.0, atol=1e-8)


def test_what_sensors_teach_is_learned_alike() -> None:
    """Encoders and links that are off: the loops' offset is observed between the kernel's ticks."""
    kernel, python = by_engine(replace(load("calibration_error"), duration=1.0))
    assert np.abs(kernel.loop_offset).max() > 1e-4
    assert kernel.compiled.all()
    np.testing.assert_allclose(kernel.loop_offset, python.loop_offset, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(kernel.q, python.q, rtol=0.0, atol=1e-9)
