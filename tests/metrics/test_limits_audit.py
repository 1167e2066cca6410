"""The audit against q and v of the trace."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from laws import DT, PLAIN, run

from coopqp.assessment.thresholds import AT_LIMIT
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.limits import JointAcceleration, JointPosition, JointVelocity, ObjectSpeed
from coopqp.metrics.limits_audit import LimitsAudit
from coopqp.model.state import State
from coopqp.scenario.loader import load
from coopqp.trace import Trace


@pytest.fixture(scope="module")
def blocked() -> tuple[ControlProblem, Trace]:
    """joint_limit_stress with every kind of limit."""
    limits = (
        JointPosition(margin=0.01),
        JointVelocity(scale=0.1),
        ObjectSpeed(linear=0.05),
        JointAcceleration(max=30.0, margin=0.01),
    )
    given = replace(load("joint_limit_stress").problem(), limits=limits)
    return given, run(PLAIN, given, 300)


def test_audit_is_what_the_trace_says(blocked: tuple[ControlProblem, Trace]) -> None:
    """Least margins and ticks at the bound, worked out again from q and v."""
    given, trace = blocked
    chain, audit = given.chain, LimitsAudit().measure(trace)
    margins: dict[str, Array] = {}
    change = np.diff(np.vstack([np.zeros(chain.n), trace.v]), axis=0) / DT
    for i, joint in enumerate(chain.joint_names):
        margins[f"limit.position[{joint}].lower"] = trace.q[1:, i] - chain.lower[i] - 0.01
        margins[f"limit.position[{joint}].upper"] = chain.upper[i] - 0.01 - trace.q[1:, i]
        for side, sign in (("lower", 1.0), ("upper", -1.0)):
            top = 0.1 * chain.velocity[i]
            margins[f"limit.velocity[{joint}].{side}"] = top + sign * trace.v[:, i]
            margins[f"limit.acceleration[{joint}].{side}"] = 30.0 + sign * change[:, i]
    speed = np.array(
        [State(chain, q).J_task[:3] @ v for q, v in zip(trace.q[:-1], trace.v, strict=True)]
    )
    for i, axis in enumerate("xyz"):
        margins[f"limit.object_speed.{axis}.upper"] = 0.05 - speed[:, i]
        margins[f"limit.object_speed.{axis}.lower"] = 0.05 + speed[:, i]
    braking = {name for name in audit if name.startswith("limit.braking")}
    assert set(audit) - braking == set(margins)
    for name, margin in margins.items():
        found = audit[name]
        assert found["margin_min"] == pytest.approx(margin.min(), abs=1e-12)
        sure = int((margin < AT_LIMIT - 1e-9).sum()), int((margin < AT_LIMIT + 1e-9).sum())
        assert sure[0] <= found["ticks_at_bound"] <= sure[1]
        assert found["saturated_share"] == found["ticks_at_bound"] / 300
    at_bound = {name for name in margins if audit[name]["ticks_at_bound"]}
    assert "limit.position[RElbowRoll].upper" in at_bound
    assert any(name.startswith("limit.object_speed") for name in at_bound)


def test_limits_that_are_never_given_up_have_no_negative_margin(
    blocked: tuple[ControlProblem, Trace],
) -> None:
    """Only where acceleration was given up may its margin be negative."""
    _, trace = blocked
    for row, margin in trace.margins.items():
        name = row.name
        kept = "acceleration" not in name and "braking" not in name
        ticks = np.array([kept or s != "ACCELERATION_GIVEN_UP" for s in trace.status])
        calm = ticks & np.append(True, ticks[:-1])
        assert margin[calm].min() >= -1e-8
