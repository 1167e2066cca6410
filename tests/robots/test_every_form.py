"""The same robot in every form: URDF, MJCF, a table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from nao_in_files import in_mjcf, in_table, in_urdf

from coopqp.execution.controller_run import run
from coopqp.robot import Robot
from coopqp.robots import NaoT14
from coopqp.scenario.loader import load

SAME = 1e-9  # runs of one robot in several forms, configurations [rad]


@pytest.mark.parametrize("form", [in_urdf, in_mjcf, in_table])
@pytest.mark.parametrize("controller", ["qp", "pseudoinverse_null_space"])
def test_nao_runs_the_same_in_every_form(
    tmp_path: Path, form: Callable[[Path], Robot], controller: str
) -> None:
    scenario = load("point_on_point")
    other = replace(scenario, robot=form(tmp_path))
    mine, theirs = run(scenario, controller=controller), run(other, controller=controller)
    assert mine.ticks == 300
    order = [theirs.joints.index(joint) for joint in mine.joints]  # URDF sorts its arms
    assert np.abs(theirs.q[:, order] - mine.q).max() < SAME
    assert np.abs(theirs.position - mine.position).max() < SAME


@pytest.mark.parametrize("form", [in_urdf, in_mjcf, in_table])
def test_nao_has_the_same_masses_and_limits_in_every_form(
    tmp_path: Path, form: Callable[[Path], Robot], rng: np.random.Generator
) -> None:
    mine, theirs = NaoT14().build().model, form(tmp_path).build().model
    at = [theirs.idx_vs[theirs.getJointId(name)] for name in list(mine.names)[1:]]
    q = rng.uniform(-1.0, 1.0, 10)
    q_theirs = np.zeros(10)
    q_theirs[at] = q
    M = pin.crba(theirs, theirs.createData(), q_theirs)[np.ix_(at, at)]
    np.testing.assert_allclose(M, pin.crba(mine, mine.createData(), q), rtol=0, atol=1e-14)
    for key in ("lowerPositionLimit", "upperPositionLimit", "velocityLimit", "effortLimit"):
        np.testing.assert_allclose(getattr(theirs, key)[at], getattr(mine, key), atol=1e-15)
