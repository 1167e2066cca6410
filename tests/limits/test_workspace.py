"""Planes that corners and hands must not pass."""

from __future__ import annotations

from functools import partial

import laws
import numpy as np
import pytest
from example_limits import TABLE, by_name, empty_rows, least
from laws import DT, LIMITS, run

from coopqp.base.errors import InvalidValueError, UnknownNameError
from coopqp.base.qp import names_of
from coopqp.controllers import QPController
from coopqp.limits import Workspace
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.tasks import JointCentering, PointOnPoint

problem = partial(laws.problem, secondary=(JointCentering(gain=0.5),))


@pytest.mark.parametrize("duration", [0.3, 2.0])
def test_a_box_pushed_through_a_table_stops_on_it(held_box: ClosedChain, duration: float) -> None:
    push = PointOnPoint(goal=(0.15, 0.03, -0.08), profile=Profile(duration=duration))
    done = run(QPController(), problem(held_box, push, limits=[*LIMITS, TABLE]), 250)
    state, lowest = State(held_box), []
    half = 0.5 * np.array(held_box.held.size)
    for q in done.q:
        state.q[:] = q
        state.update()
        lowest.append(state.p_WO[2] - np.abs(state.R_WO[2]) @ half)  # a box's support
    height = np.array(lowest) + 0.02
    assert height.min() >= -1e-6
    assert height[-1] < 1e-4
    assert min(least(TABLE, held_box, done), 0.0) == pytest.approx(
        min(height[1:].min(), 0.0), abs=1e-9
    )


def test_workspace_rows_are_the_rate_of_the_distances(
    held_box: ClosedChain, closed_loop_walk: object
) -> None:
    tilted = Workspace(
        normal=(0.3, -0.4, 1.2), through=(0.1, 0.2, -0.3), frames=("RHand", "LElbowRoll")
    )
    step, state, rows = 1e-6, State(held_box), empty_rows(held_box, tilted)
    for q in closed_loop_walk(held_box, 3):  # type: ignore[operator]
        state.q[:] = q
        state.update()
        tilted.bind(held_box, DT)(state, rows)
        for i in range(held_box.n):
            path = np.vstack([q, q, q])
            path[1, i] += step
            path[2, i] -= step
            margins = by_name(tilted.margins(held_box, path, np.zeros((2, held_box.n)), DT))
            slope = [(m[0] - m[1]) / (2 * step) for m in margins.values()]
            # Loops open a little here; the object's mean turn is linear to first order only.
            assert np.allclose(-rows.G[:, i], slope, atol=1e-5)


def test_workspace_refuses_what_it_cannot_watch(held_box: ClosedChain) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'RHand'"):
        Workspace(normal=(0, 0, 1), through=(0, 0, 0), frames=("RHnd",)).rows(held_box)
    with pytest.raises(InvalidValueError, match="overshoot"):
        Workspace(normal=(0, 0, 1), through=(0, 0, 0), gain=101.0).bind(held_box, DT)
    with pytest.raises(ValueError, match="points of the object or frames"):
        Workspace(normal=(0, 0, 1), through=(0, 0, 0), points=())


def test_points_given_replace_the_corners(held_box: ClosedChain) -> None:
    limit = Workspace(normal=(0, 0, 2), through=(0, 0, 0), points=((0.0, 0.0, -0.1),))
    assert names_of(limit.rows(held_box)) == ("limit.workspace.object[0]",)
    q = np.vstack([held_box.q_start] * 2)
    margins = by_name(limit.margins(held_box, q, np.zeros((1, held_box.n)), DT))
    height = State(held_box).p_WO[2] - 0.1
    assert margins["limit.workspace.object[0]"][0] == pytest.approx(height)
