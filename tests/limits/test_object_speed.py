"""The object's speed along the world's axes."""

from __future__ import annotations

import itertools
from functools import partial

import laws
import numpy as np
import pinocchio as pin
import pytest
from example_limits import empty_rows, least
from laws import DT, run

from coopqp.base.spec import Pose as PoseSpec
from coopqp.controllers import QPController
from coopqp.limits import ObjectSpeed
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.tasks import JointCentering, Pose

problem = partial(laws.problem, secondary=(JointCentering(gain=0.5),))


def test_the_object_keeps_its_speed(held_box: ClosedChain) -> None:
    limit = ObjectSpeed(linear=0.06, angular=0.3)
    goal = PoseSpec(position=(0.14, 0.04, 0.1), rpy=(0.3, 0.2, 0.3))
    done = run(
        QPController(),
        problem(held_box, Pose(goal=goal, profile=Profile(duration=0.2)), limits=[limit]),
        150,
    )
    state, places, turns = State(held_box), [], []
    for q in done.q:
        state.q[:] = q
        state.update()
        places.append(state.p_WO.copy())
        turns.append(state.R_WO.copy())
    speed = np.abs(np.diff(places, axis=0)) / DT
    spin = np.abs([pin.log3(b @ a.T) for a, b in itertools.pairwise(turns)]) / DT
    # The mean over a tick differs from the velocity at its start by the curvature of the path.
    assert 0.0599 < speed.max() < 0.0625
    assert 0.299 < spin.max() < 0.31
    assert least(limit, held_box, done) > -1e-6


def test_one_kind_of_speed_has_six_rows(held_box: ClosedChain) -> None:
    assert len(ObjectSpeed(angular=1.0).rows(held_box)) == 6
    state, limit = State(held_box), ObjectSpeed(angular=1.0)
    rows = empty_rows(held_box, limit)
    limit.bind(held_box, DT)(state, rows)
    assert np.array_equal(rows.G, np.vstack([state.J_task[3:], -state.J_task[3:]]))
    with pytest.raises(ValueError, match="needs linear"):
        ObjectSpeed()
