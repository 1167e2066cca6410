"""Figs. 4 to 8: what the null-space term does about joint limits, by its criterion."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import coopqp
from coopqp.assessment import assess
from coopqp.base.rank import null_space
from coopqp.base.spec import Array
from coopqp.metrics.limit_criterion import LimitCriterion, limit_criterion
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.scenario.scenario import Scenario
from coopqp.task import Task
from coopqp.tasks import JointCentering, JointLimitBarrier
from coopqp.trace import Trace


@cache
def figures() -> Scenario:
    return coopqp.load("joint_limit_avoidance")


def null_space_law(scenario: Scenario, *secondary: Task) -> Trace:
    return coopqp.run(replace(scenario, secondary=secondary), controller="pseudoinverse_null_space")


def violation(trace: Trace) -> float:
    """Of the worst position limit [rad]; negative inside."""
    return float(np.maximum(trace.lower - trace.q, trace.q - trace.upper).max())


def test_the_null_space_term_keeps_joints_inside_that_the_pseudoinverse_lets_out() -> None:
    """The message of Figs. 4 to 8, with a criterion that grows towards the limits."""
    plain = coopqp.run(figures(), controller="pseudoinverse")
    kept = null_space_law(figures(), *figures().secondary)
    assert violation(plain) > 0.05
    assert violation(kept) < -0.05
    assert max(assess(plain).errors[0], assess(kept).errors[0]) < 1e-5
    with_, without = limit_criterion(kept)["nearest"], limit_criterion(plain)["nearest"]
    assert with_.max() < 0.95 < 1.05 < without.max()
    speed = np.abs(kept.v / kept.velocity).max()
    assert speed < 0.2  # it is no violent motion that does it


def test_a_quadratic_criterion_falls_with_its_gain_while_the_violation_grows() -> None:
    """Not a fault of the law: the least sum lies beyond the limit, where a shoulder gains more."""
    traces = [null_space_law(figures(), JointCentering(gain=gain)) for gain in (0.5, 5.0, 50.0)]
    ends = [limit_criterion(trace)["quadratic"][-1] for trace in traces]
    assert (np.diff(ends) < 0.0).all()
    assert (np.diff([violation(trace) for trace in traces]) > 0.02).all()


def test_least_quadratic_sum_along_the_self_motion_is_beyond_the_limits() -> None:
    """On point_on_point: the one self-motion at the goal is inside the limits for a few mrad."""
    scenario = coopqp.load("point_on_point")
    chain, goal = scenario.chain, np.array([0.13, 0.05, 0.03])
    end = coopqp.run(scenario, controller="weighted_least_norm").q[-1]
    span, middle = chain.upper - chain.lower, 0.5 * (chain.upper + chain.lower)
    way = np.vstack([self_motion(chain, end, goal, -1)[:0:-1], self_motion(chain, end, goal, 1)])
    phi = np.sum(((way - middle) / span) ** 2, axis=1)
    outside = np.maximum(chain.lower - way, way - chain.upper).max(axis=1)
    assert outside[np.argmin(phi)] == pytest.approx(0.299, abs=0.01)
    assert 0 < np.sum(outside <= 0.0) <= 5
    least_inside = phi[outside <= 0.0].min()
    assert least_inside > 1.03 * phi.min()


def self_motion(chain: ClosedChain, q: Array, goal: Array, side: int) -> Array:
    """Configurations 2 mrad apart that hold the object's origin at a point, one way."""
    state, found = State(chain, q), []
    before: Array | None = None
    for _ in range(700):
        found.append(state.q.copy())
        along = null_space(np.vstack([state.J_task[:3], state.J_rel]))[:, 0]
        turn = side * along[0] if before is None else along @ before
        before = along if turn > 0.0 else -along
        state.q += 2e-3 * before
        for _ in range(2):
            state.update()
            J = np.vstack([state.J_task[:3], state.J_rel])
            off = np.concatenate([state.p_WO - goal, state.loop_error])
            state.q -= np.linalg.lstsq(J, off)[0]
        state.update()
    return np.array(found)


def test_barrier_never_speeds_a_joint_up_without_end(chain: ClosedChain) -> None:
    """Its slope is bounded, so a start far outside the limits asks for no violent motion."""
    scenario = replace(figures(), duration=0.5)
    outside = replace(scenario, start={"right": [0.7, 1.5, 1.2, 0.9, 0.1], "left": [0.7] * 5})
    trace = null_space_law(outside, JointLimitBarrier(gain=5.0))
    assert np.isfinite(trace.q).all()
    most = 5.0 * 0.95 / (1.0 - 0.95**2) / (chain.upper - chain.lower).min()
    assert np.abs(trace.v).max() < 2.0 * np.sqrt(chain.n) * most


def test_criterion_over_time_is_one_at_a_limit_and_zero_in_the_middle() -> None:
    trace = coopqp.run(replace(figures(), duration=0.1), controller="pseudoinverse")
    middle = 0.5 * (trace.lower + trace.upper)
    q = np.tile(middle, (len(trace.t), 1))
    q[3, 2] = trace.upper[2]
    q[4, 5] = trace.lower[5] - 0.5 * (trace.upper - trace.lower)[5]
    found = limit_criterion(replace(trace, q=q))
    assert found["nearest"].shape == found["quadratic"].shape == trace.t.shape
    np.testing.assert_allclose(found["nearest"][[0, 3, 4]], [0.0, 1.0, 2.0], atol=1e-12)
    np.testing.assert_allclose(found["quadratic"][[0, 3, 4]], [0.0, 0.25, 1.0], atol=1e-12)
    measured = LimitCriterion().measure(replace(trace, q=q))
    assert measured["nearest_max"] == pytest.approx(2.0)
