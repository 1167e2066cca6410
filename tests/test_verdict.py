"""One sentence on a run: what it claims is what the trace, the plant and the physics say."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenario_files import phased

import coopqp
from coopqp.execution.comparison import Comparison, summarize
from coopqp.execution.controller_run import run
from coopqp.grasps import Rigid
from coopqp.limits import JointAcceleration, JointPosition, JointVelocity, Workspace
from coopqp.plant import Disturbance
from coopqp.plants import RigidBody
from coopqp.report import audit
from coopqp.report.cells import cells
from coopqp.robots import NaoT14
from coopqp.scenario.scenario import Scenario
from coopqp.signals import Waypoints
from coopqp.tasks import PointOnPoint, Posture, Twist
from coopqp.trace import Trace

HANDS = {"right": (0.7, -0.2, 1.2, 0.9, 0.1), "left": (0.7, 0.2, -1.2, -0.9, -0.1)}
BOTH = ("qp", "pseudoinverse")


def nao(*tasks: coopqp.Task, **settings: object) -> Scenario:
    """The scenario that strangers wrote: NAO, a box, one task."""
    like = coopqp.load("point_on_point")
    chosen = {name: like.controllers[name] for name in BOTH}
    given = {"robot": NaoT14(), "grasps": Rigid(), "start": HANDS, "plant": like.plant}
    return replace(like, tasks=tasks, secondary=(), controllers=chosen, **{**given, **settings})  # type: ignore[arg-type]


def judged(scenario: Scenario) -> Comparison:
    return coopqp.compare(scenario, controllers=BOTH)


def test_a_limit_of_the_phase_that_missed_is_named_and_no_other(tmp_path: Path) -> None:
    made = phased(tmp_path)
    trace = run(made, controller="qp")
    trace.task_error[60, 0] = 0.1  # of the first phase, where no joint was at a limit
    trace.q[-1, 0] = trace.upper[0]
    verdict = summarize(made, {"qp": trace}).verdicts["qp"]
    assert "off the goal of 'carry.reach'" in verdict
    assert "at the limit" not in verdict


def test_no_goal_is_reached_with_an_error_that_is_not_a_number(tmp_path: Path) -> None:
    made = phased(tmp_path)
    trace = run(made, controller="qp")
    trace.task_error[60, 0] = np.nan
    comparison = summarize(made, {"qp": trace})
    assert not comparison.metrics["qp"]["reached"]
    assert "eaches the goal" not in comparison.verdicts["qp"]


def test_a_twist_beyond_the_reach_is_a_singular_pose_and_an_object_torn_is_no_goal() -> None:
    """Case nod: the pseudoinverse was said to reach the goal with the loop open by 465 mm."""
    found = judged(
        nao(Twist(name="tele", velocity={"x": 0.02, "z": 0.0}), duration=5.0, kappa=100.0)
    )
    assert "near a singularity in that direction" in found.verdicts["qp"]
    assert "at the limit" not in found.verdicts["qp"]
    assert found.metrics["pseudoinverse"]["loop_error_max"]["position"] > 0.1
    assert not found.metrics["pseudoinverse"]["reached"]
    assert "eaches the goal" not in found.verdicts["pseudoinverse"]


@pytest.fixture(scope="module")
def walled() -> Comparison:
    """Case my4: a table keeps the box from its goal."""
    table = Workspace(name="table", normal=(0, 0, 1), through=(0, 0, -0.02))
    limits = (JointPosition(), JointVelocity(), table)
    reach = PointOnPoint(name="reach", goal=(0.19, 0.0, 0.0))
    return judged(nao(reach, limits=limits, duration=3.0, kappa=100.0))


def test_a_wall_that_stops_the_motion_is_named(walled: Comparison) -> None:
    said = "with table at the limit; 'coopqp explain' says why; keeps every limit"
    assert said in walled.verdicts["qp"]
    assert walled.metrics["qp"]["limits_audit"]


def test_who_goes_through_a_wall_is_told_by_how_much(walled: Comparison) -> None:
    trace = walled.traces["pseudoinverse"]
    (far,) = re.findall(r"goes (\d+) mm beyond the table, corner", walled.verdicts["pseudoinverse"])
    corners = np.array(np.meshgrid(*[(-s / 2, s / 2) for s in walled.scenario.held.size]))
    lowest = min(
        float((p[:, None] + R @ corners.reshape(3, -1))[2].min())
        for p, R in zip(trace.position, trace.rotation, strict=True)
    )
    assert float(far) == pytest.approx(-1e3 * (lowest + 0.02), abs=0.5)
    row = cells(trace, walled.metrics["pseudoinverse"])["limit"]
    assert row.bad
    assert any(line.startswith("table: ") for line in row.lines)


def test_a_wall_that_is_broken_from_the_start_is_told_and_nobodys_fault() -> None:
    sunk = Workspace(name="table", normal=(0, 0, 1), through=(0, 0, 0.04))
    limits = (JointPosition(), JointVelocity(), sunk)
    reach = PointOnPoint(name="reach", goal=(0.19, 0.0, 0.05))
    found = judged(nao(reach, limits=limits, duration=1.0, kappa=100.0))
    assert re.search(
        r"starts \d+ mm beyond the table, corner .* ends outside", found.verdicts["qp"]
    )
    assert "every limit" not in found.verdicts["qp"]
    assert cells(found.traces["qp"], found.metrics["qp"])["limit"].bad is None


def test_the_audit_has_one_line_for_a_wall(walled: Comparison) -> None:
    lines = [limit.name for limit in audit.limits_of(walled.traces["qp"])]
    assert lines.count("table") == 1
    assert lines.count("position of RElbowRoll") == 1
    assert "table (the table, corner " in audit.rows(walled.traces)


def test_acceleration_of_a_law_without_limits_is_told() -> None:
    limits = (JointPosition(), JointVelocity(), JointAcceleration(max=1.0))
    found = judged(nao(PointOnPoint(goal=(0.19, 0.0, 0.03), gain=20.0), limits=limits))
    assert "exceeds the acceleration of " in found.verdicts["pseudoinverse"]
    assert "exceeds" not in found.verdicts["qp"]


def test_a_motor_that_is_too_weak_is_told() -> None:
    reach = PointOnPoint(goal=(0.19, 0.0, 0.06))
    heavy = nao(reach, plant=RigidBody(), duration=0.5, disturbance=Disturbance(object_mass=60.0))
    trace = run(heavy, controller="qp")
    share = (trace.signals["saturated"] > 0.0).mean(axis=0)
    worst = int(share.argmax())
    assert share[worst] > 0.1
    said = summarize(heavy, {"qp": trace}).verdicts["qp"]
    assert f"saturates the motor of {trace.joints[worst]} in {100 * share[worst]:.0f} %" in said


def beginning_outside(trace: Trace, by: float) -> Trace:
    """As if the farthest place of some joint had been beyond its limit, at the start."""
    upper = trace.upper.copy()
    upper[0] = trace.q[0, 0] - by
    q = trace.q.copy()
    q[1:, 0] = np.minimum(q[1:, 0], upper[0] - 0.01)
    return replace(trace, q=q, upper=upper)


def test_what_was_outside_from_the_start_has_no_red_cross(walled: Comparison) -> None:
    trace = beginning_outside(walled.traces["qp"], 0.05)
    found = summarize(walled.scenario, {"qp": trace})
    assert cells(trace, found.metrics["qp"])["limit"].bad is None
    assert "starts with RShoulderPitch 0.05 rad beyond its limit" in found.verdicts["qp"]


@pytest.mark.parametrize(("by", "bad"), [(1e-6, False), (1e-3, True)])
def test_a_microradian_has_no_red_cross(walled: Comparison, by: float, bad: bool) -> None:
    trace = walled.traces["qp"]
    upper = trace.upper.copy()
    upper[1] = trace.q[:, 1].max() - by
    q = trace.q.copy()
    q[0, 1] = upper[1] - 0.1
    beyond = replace(trace, q=q, upper=upper)
    found = summarize(walled.scenario, {"qp": beyond})
    assert cells(beyond, found.metrics["qp"])["limit"].bad is bad
    assert ("beyond its limit" in found.verdicts["qp"]) is bad


def test_standing_still_says_why() -> None:
    trace = run(nao(PointOnPoint(goal=(0.19, 0.0, 0.06)), duration=0.1), controller="qp")
    cause = coopqp.Status.LOOP_BUDGET.value
    failures = tuple(coopqp.trace.Failure(k, cause) for k in range(trace.ticks))
    found = summarize(coopqp.load("point_on_point"), {"qp": replace(trace, failures=failures)})
    assert "holds still in 10 of 10 ticks: the loop budget is used up" in found.verdicts["qp"]


def test_nothing_is_reached_once_the_plant_broke_down() -> None:
    scenario = nao(PointOnPoint(goal=(0.19, 0.0, 0.06)), duration=0.1)
    trace = run(scenario, controller="qp")
    status = (*trace.status[:-1], coopqp.Status.PLANT_FAILED.name)
    found = summarize(scenario, {"qp": replace(trace, status=status)})
    assert not found.metrics["qp"]["reached"]
    assert "eaches the goal" not in found.verdicts["qp"]
    assert "keeps" not in found.verdicts["qp"]


def test_a_clock_without_phases_has_the_whole_run_for_its_way() -> None:
    """Of its first half, if the run is over then, nothing is said to be held back."""
    like = coopqp.load("point_on_point")
    q = like.chain.q_start.tolist()
    way = Waypoints(times=(0.0, 1.0), values=(q, q), clock="own")
    still = replace(like, tasks=(Posture(name="way", goal=way),), secondary=())
    for duration in (0.5, 1.5):
        trace = run(replace(still, duration=duration), controller="qp")
        assert "held back" not in summarize(still, {"qp": trace}).verdicts["qp"]
    trace.inputs["own"].value[:] = 0.3
    said = summarize(still, {"qp": trace}).verdicts["qp"]
    assert "the joints are held back at 0.30 of the 1.00 s;" in said
