"""Braking in time, and accelerations over a run."""

from __future__ import annotations

import math
from functools import partial

import laws
import numpy as np
import pytest
from example_limits import empty_rows
from laws import DT, LIMITS, run

from coopqp.base.errors import UnknownNameError
from coopqp.controllers import QPController
from coopqp.limit import Limit, LimitRows
from coopqp.limits import JointAcceleration, JointPosition
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.solver import Status
from coopqp.tasks import JointCentering, PointOnPoint

problem = partial(laws.problem, secondary=(JointCentering(gain=0.5),))


def bounds_alone(chain: ClosedChain, limit: Limit, state: State, dt: float) -> LimitRows:
    rows = LimitRows(-chain.velocity, chain.velocity.copy(), np.zeros((0, chain.n)), np.zeros(0))
    JointPosition().bind(chain, dt)(state, rows)
    limit.bind(chain, dt)(state, rows)
    return rows


@pytest.mark.parametrize(("a", "dt"), [(5.0, 0.01), (40.0, 0.01), (37.3, 0.004), (120.0, 0.02)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_full_speed_against_the_stop_brakes_in_time(
    held_box: ClosedChain, a: float, dt: float, side: float
) -> None:
    limit, state = JointAcceleration(max=a), State(held_box)
    end = held_box.upper if side > 0 else held_box.lower
    fastest = np.zeros(held_box.n)
    for _ in range(int(3.0 / dt)):
        rows = bounds_alone(held_box, limit, state, dt)
        assert (rows.lb <= rows.ub).all()
        v = rows.ub if side > 0 else rows.lb
        assert (np.abs(v - state.v) <= a * dt * (1 + 1e-9)).all()
        fastest = np.maximum(fastest, np.abs(v))
        state.v[:] = v
        state.q += v * dt
        assert (side * (end - state.q) >= -1e-12).all()
    assert (fastest > 1.5).all()  # they did run
    assert np.allclose(state.q, end, atol=1e-9)
    assert np.allclose(state.v, 0.0, atol=1e-7)


def test_the_braking_bound_is_the_closed_form_at_whole_ticks(held_box: ClosedChain) -> None:
    a, limit, state = 40.0, JointAcceleration(max=40.0), State(held_box)
    for ticks in range(1, 12):
        v = ticks * a * DT
        margin = v**2 / (2.0 * a) + v * DT / 2.0
        state.q[:], state.v[:] = held_box.upper - margin, v
        bound = -a * DT / 2.0 + math.sqrt((a * DT / 2.0) ** 2 + 2.0 * a * margin)
        rows = LimitRows(
            np.full(held_box.n, -99.0), np.full(held_box.n, 99.0),
            np.zeros((0, held_box.n)), np.zeros(0),
        )  # fmt: skip
        limit.bind(held_box, DT)(state, rows)
        assert np.allclose(rows.ub, bound)
        assert bound == pytest.approx(v)


def test_joints_may_have_accelerations_of_their_own(held_box: ClosedChain) -> None:
    limit = JointAcceleration(max=10.0, joints={"LWristYaw": 3.0})
    state, rows = State(held_box), empty_rows(held_box, limit)
    limit.bind(held_box, DT)(state, rows)
    slow = held_box.joint_names.index("LWristYaw")
    assert rows.ub[slow] == pytest.approx(0.03)
    assert np.delete(rows.ub, slow) == pytest.approx(0.1)
    with pytest.raises(UnknownNameError, match="did you mean 'LWristYaw'"):
        JointAcceleration(max=10.0, joints={"LWristYow": 3.0}).bind(held_box, DT)


def test_acceleration_gives_way_to_the_other_limits(held_box: ClosedChain) -> None:
    limit, state = JointAcceleration(max=1.0), State(held_box)
    state.q[:] = held_box.upper - 1e-4
    state.v[:] = 5.0  # too fast to stop in time
    rows = bounds_alone(held_box, limit, state, DT)
    assert (rows.lb <= rows.ub).all()
    assert (rows.ub * DT <= 1e-4 + 1e-12).all()
    assert JointAcceleration.sacrificed_first
    assert not JointPosition.sacrificed_first


def test_acceleration_holds_over_a_whole_run(held_box: ClosedChain) -> None:
    limit = JointAcceleration(max=20.0)
    reach = PointOnPoint(goal=(0.13, 0.05, -0.05), profile=Profile(duration=0.3))
    done = run(QPController(), problem(held_box, reach, limits=[*LIMITS, limit]), 200)
    assert not done.failures
    assert not any(Status[status].relaxed for status in done.status)
    change = np.diff(done.v, axis=0, prepend=np.zeros((1, held_box.n))) / DT
    assert np.abs(change).max() <= 20.0 + 1e-6
    assert np.abs(change).max() > 19.9
