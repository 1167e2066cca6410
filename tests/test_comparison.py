"""What the shipped comparisons must show: the QP keeps what the pseudoinverse laws break."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import pytest
from scenario_files import LOADABLE
from shipped_runs import comparison

import coopqp
from coopqp.controllers import QPController
from coopqp.scenario.loader import load, shipped

REACHABLE = ("point_on_point", "point_on_plane", "tilting_plane", "near_singular")


@cache
def of_the_qp(name: str) -> list[Mapping[str, Any]]:
    """Metrics of every controller of the scenario that solves a QP."""
    scenario = load(name)
    qps = [key for key, law in scenario.controllers.items() if isinstance(law, QPController)]
    found = list(coopqp.compare(scenario, controllers=qps).metrics.values())
    assert found
    assert all(metrics["solver"] for metrics in found)
    return found


#: Scenarios of ideal joints, where what is commanded happens.
KINEMATIC = [
    name
    for name in LOADABLE
    if not re.search(r"^plant: (?!kinematic)", shipped()[name].read_text(encoding="utf-8"), re.M)
]


@pytest.mark.parametrize("name", KINEMATIC)
def test_the_qp_never_leaves_a_limit(name: str) -> None:
    for metrics in of_the_qp(name):
        assert metrics["limit_violation_max"] <= 1e-9
        assert metrics["velocity_violation_max"] <= 1e-9
        assert metrics["failed_ticks"] == 0


@pytest.mark.parametrize("name", KINEMATIC)
def test_the_qp_keeps_the_loop_closed(name: str) -> None:
    for metrics in of_the_qp(name):
        assert metrics["loop_error_max"]["position"] <= 1e-4
        assert metrics["loop_error_max"]["orientation"] <= 1e-3


@pytest.mark.parametrize("name", REACHABLE)
def test_the_qp_reaches_reachable_goals(name: str) -> None:
    metrics = comparison(name).metrics["qp"]
    assert metrics["reached"]
    assert max(metrics["task_error"].values()) <= 5e-4


def test_under_stress_the_pseudoinverse_laws_leave_the_limits() -> None:
    metrics = comparison("joint_limit_stress").metrics
    assert metrics["pseudoinverse"]["limit_violation_max"] > 0.1
    assert metrics["pseudoinverse_null_space"]["limit_violation_max"] > 0.1
    assert metrics["qp"]["limit_margin_min"] >= 0.0


def test_near_the_singular_pose_only_the_pseudoinverse_blows_up() -> None:
    metrics = comparison("near_singular").metrics
    assert metrics["pseudoinverse"]["velocity_violation_max"] > 100.0
    assert metrics["damped_pseudoinverse"]["velocity_violation_max"] == 0.0
    assert metrics["qp"]["velocity_violation_max"] == 0.0


def test_a_verdict_names_the_joint_and_how_far() -> None:
    verdicts = comparison("joint_limit_stress").verdicts
    assert "RElbowRoll" in verdicts["pseudoinverse"]
    assert "beyond its limit" in verdicts["pseudoinverse"]
    assert "keeps every joint inside its limits" in verdicts["qp"]


def test_the_json_has_what_it_promises() -> None:
    data = comparison("point_on_point").as_json()
    assert data["scenario"] == "point_on_point"
    assert data["kappa"] == 100.0
    assert data["dt"] == 0.01
    qp = data["controllers"]["qp"]
    assert qp["solver"] == "daqp"
    assert data["controllers"]["pseudoinverse"]["solver"] is None
    assert set(qp["tick_us"]) == {"median", "p99", "max"}
    assert qp["ticks"] == 300
    assert qp["failures"] == []


def test_metrics_agree_with_the_trace() -> None:
    result = comparison("joint_limit_stress")
    trace, metrics = result.traces["pseudoinverse"], result.metrics["pseudoinverse"]
    margin = min((trace.q - trace.lower).min(), (trace.upper - trace.q).min())
    assert metrics["limit_margin_min"] == margin
    assert metrics["limit_violation_max"] == -margin
    goal = np.array(result.scenario.tasks[0].goal)  # type: ignore[attr-defined]
    assert metrics["task_error"]["reach"] == pytest.approx(
        np.linalg.norm(trace.position[-1] - goal), abs=1e-12
    )
