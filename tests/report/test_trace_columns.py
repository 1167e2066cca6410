"""References and margins in trace.csv."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import pytest
from explained import traced
from scenario_files import cut

import coopqp
from coopqp.execution.comparison import Comparison
from coopqp.recordings.column import unit_of
from coopqp.report import files
from coopqp.study.trace_file import recorded_tick


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return coopqp.compare(coopqp.load("point_on_point"), controllers=["qp", "pseudoinverse"])


@pytest.fixture(scope="module")
def rows(comparison: Comparison) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(files.trace_csv(comparison))))


def test_references_are_the_quintic_in_closed_form(
    comparison: Comparison, rows: list[dict[str, str]]
) -> None:
    trace = comparison.traces["qp"]
    goal, s = np.array([0.13, 0.05, 0.03]), np.minimum(trace.t / 2.0, 1.0)[:, None]
    share, speed = s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / 2.0
    way = goal - trace.position[0]
    own = [row for row in rows if row["controller"] == "qp"]
    e = np.array([[float(row[f"e[reach.{axis}]"]) for axis in "xyz"] for row in own])
    rate = np.array([[float(row[f"rate[reach.{axis}]"]) for axis in "xyz"] for row in own])
    np.testing.assert_allclose(
        trace.position - e, trace.position[0] + share * way, rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(rate, speed * way, rtol=0, atol=1e-12)


def test_margins_are_those_to_the_nearest_limit(
    comparison: Comparison, rows: list[dict[str, str]]
) -> None:
    for name, trace in comparison.traces.items():
        own = [row for row in rows if row["controller"] == name][:-1]
        after, v = trace.q[1:], np.abs(trace.v)
        sides = np.minimum(after - trace.lower, trace.upper - after)
        found = [float(row["margin[position].rad"]) for row in own]
        np.testing.assert_allclose(found, sides.min(axis=1), atol=1e-12)
        where = [row["nearest[position].rad"].split()[0] for row in own]
        assert where == [trace.joints[i] for i in sides.argmin(axis=1)]
        speeds = [float(row["margin[velocity].rad/s"]) for row in own]
        np.testing.assert_allclose(speeds, (trace.velocity - v).min(axis=1), atol=1e-12)
    assert min(float(row["margin[position].rad"] or "inf") for row in rows) < -0.1


def test_a_trace_without_these_columns_can_still_be_explained(
    comparison: Comparison, tmp_path: Path
) -> None:
    """As an earlier version wrote it."""
    new = traced(comparison, tmp_path)
    added = ("e[", "rate[", "margin[", "nearest[")
    with new.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    kept = [name for name in rows[0] if not name.startswith(added)]
    old = tmp_path / "old.csv"
    with old.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, kept, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    scenario = comparison.scenario
    assert recorded_tick(old, scenario, "qp", 100) == recorded_tick(new, scenario, "qp", 100)


def test_forces_of_the_hands_are_told_with_their_units() -> None:
    """The hands bear the weight, whichever arm is told first."""
    held = coopqp.compare(cut(coopqp.load("nao_presses"), 60))
    (trace,) = held.traces.values()
    rows = list(csv.DictReader(io.StringIO(files.trace_csv(held))))
    last, unit = rows[-2], unit_of(held.scenario)
    arms = [arm.name for arm in held.scenario.robot_model.arms]
    lift = sum(float(last[f"hand_wrench[{arm}].fz"]) for arm in arms)
    assert lift == pytest.approx(held.scenario.chain.held.mass * 9.81, rel=0.05)
    for i, arm in enumerate(arms):
        across = float(last[f"tangential_force[{arm}]"])
        assert across / float(last[f"normal_force[{arm}]"]) / 0.5 == pytest.approx(
            float(last[f"friction_use[{arm}]"]), rel=0.02
        )
        assert float(last[f"hand_point[{arm}].y"]) == trace.signals["hand_point"][-1, 3 * i + 1]
    assert last["held"] == "1.0"
    assert rows[-1]["held"] == ""  # the end has no tick
    units = [f"hand_wrench[{arms[0]}].fx", f"hand_wrench[{arms[0]}].tx", f"slip[{arms[0]}]", "held"]
    assert [unit(column) for column in units] == ["N", "N m", "m", "1"]
