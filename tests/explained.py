"""Runs that are explained, and what is true of them by pinocchio's frames and scipy."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import least_squares

from coopqp.base.spec import Array
from coopqp.execution.comparison import Comparison
from coopqp.execution.controller_run import run
from coopqp.model.closed_chain import ClosedChain
from coopqp.report import files
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.study.explanation import RunExplanation, explain_run, explained_phase
from coopqp.task import Task
from coopqp.tasks import PointOnPlane, PointOnPoint

ADVICE = Path(__file__).parent / "study" / "advice"
LOW = PointOnPlane(name="low", normal=(0, 0, 1), through=(0, 0, 0.03))
HIGH = PointOnPlane(name="high", normal=(0, 0, 1), through=(0, 0, 0.06))
REACH = PointOnPoint(name="reach", goal=(0.18, 0.01, 0.05))


def explained(scenario: Scenario, controller: str = "qp") -> RunExplanation:
    return explain_run(scenario, run(scenario, controller=controller))


def traced(comparison: Comparison, folder: Path) -> Path:
    """The trace of a comparison as a file, without the rest of its report."""
    path = folder / "trace.csv"
    files.write_one(path, files.trace_csv(comparison))
    return path


@pytest.fixture
def hurried_reruns(monkeypatch: pytest.MonkeyPatch) -> None:
    """An explanation tries more time: half a run more, where its default takes plants long."""
    monkeypatch.setattr(explained_phase, "TIMES", 0.5)
    monkeypatch.setattr(explained_phase, "MORE", 0.5)


def advice(name: str) -> Scenario:
    return load(ADVICE / f"{name}.yaml")


@cache
def of_case(name: str) -> RunExplanation:
    return explained(advice(name))


def nao(*tasks: Task, **settings: Any) -> Scenario:
    """NAO with a firm grasp, nothing but the tasks given."""
    given = {"duration": 2.0, **settings}
    return replace(load("point_on_point"), tasks=tasks, secondary=(), source="", **given)


def gap(chain: ClosedChain, q: Array) -> Array:
    """Loop error from pinocchio's frames."""
    data = chain.model.createData()
    pin.framesForwardKinematics(chain.model, data, q)
    X_0, X_1 = (data.oMf[frame] for frame in chain.frames)
    return np.concatenate(
        [X_1.translation - X_0.translation, pin.log3(X_1.rotation @ X_0.rotation.T)]
    )


def nearest(chain: ClosedChain, goal: tuple[float, float, float], starts: int = 2) -> Array:
    """From the nearest point that closed loops allow to a goal, limits left out; by scipy."""
    rng, best = np.random.default_rng(0), np.full(3, np.inf)

    def residual(q: Array) -> Array:
        return np.concatenate([goal - chain.object_pose(q).translation, 100.0 * gap(chain, q)])

    def slope(q: Array) -> Array:
        J = chain.object_jacobians(q)
        return np.vstack([-np.mean(J, axis=0)[:3], 100.0 * (J[1] - J[0])])

    for i in range(starts):
        q = chain.q_start + (rng.normal(scale=0.3, size=chain.n) if i else 0.0)
        way = least_squares(residual, q, slope, max_nfev=500).fun[:3]
        best = min(best, way, key=lambda w: float(np.linalg.norm(w)))
    return best
