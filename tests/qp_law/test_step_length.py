"""Steps that are too long for their linearisation are shortened."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import partial
from typing import Any

import laws
import numpy as np
import pytest
from conflicts import TURN, slightly_open
from laws import DT, LIMITS, PLAIN, STEP, run, ticks

from coopqp.controller import ControlProblem
from coopqp.metrics.relaxed_ticks import RelaxedTicks
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.solver import Budget, Status, causes_of
from coopqp.tasks import PointOnPoint

problem = partial(laws.problem, limits=LIMITS)


def long_steps(chain: ClosedChain, **settings: Any) -> ControlProblem:
    """Five ticks a second and a goal that is asked for at once."""
    behind = PointOnPoint(name="behind", goal=(0.1, 0.05, -0.05), profile=STEP)
    return problem(chain, behind, dt=0.2, **settings)


def test_step_that_would_open_the_loop_is_shortened(chain: ClosedChain) -> None:
    """At 0.2 s a tick the loops stay within 1 mm and 10 mrad after every step."""
    trace = run(PLAIN, long_steps(chain), 60)
    assert Counter(trace.status)["STEP_SHORTENED"] >= 3
    assert not trace.failures
    assert trace.loop_position.max() <= 1e-3
    assert trace.loop_orientation.max() <= 1e-2
    assert trace.task_error[-1] < 0.2 * trace.task_error[0]
    # Without the check the same steps tear the loop open.
    wide = Budget(loop_position=1.0, loop_orientation=3.0)
    assert run(PLAIN, long_steps(chain, budget=wide), 60).loop_position.max() > 5e-3


def test_step_is_shortened_by_no_more_than_it_must_be(chain: ClosedChain) -> None:
    """The direction stays; a longer step would not have fitted."""
    law = PLAIN.build(long_steps(chain))
    whole = PLAIN.build(long_steps(chain, budget=Budget(loop_position=1.0, loop_orientation=3.0)))
    state = law.start()
    command = law.tick(state)
    assert command.status is Status.STEP_SHORTENED
    share = np.linalg.norm(command.v) / np.linalg.norm(whole.tick(state).v)
    assert share < 1.0
    np.testing.assert_allclose(command.v, share * whole.command.v, rtol=1e-9)

    def opening(longer: float) -> float:
        after = State(chain, state.q + 0.2 * longer * command.v)
        return max(after.loop_position_error / 1e-3, after.loop_orientation_error / 1e-2)

    assert opening(1.0) <= 1.0 < opening(1.0 + 2.0 * 2.0**-20 / share)


@pytest.mark.parametrize("kappa", [100.0, 20.0, 2.0])
@pytest.mark.parametrize("gap", [2e-3, 8e-3])
def test_loop_beyond_its_budget_is_closed_again(
    gap: float, kappa: float, chain: ClosedChain
) -> None:
    """Steps that leave it open, but less so, are made."""
    here = tuple(State(chain).p_WO.tolist())
    law = PLAIN.build(
        problem(chain, PointOnPoint(name="hold", goal=here, profile=STEP), kappa=kappa)
    )
    state = law.start(slightly_open(chain, gap))
    before = state.loop_position_error
    for _ in ticks(law, state, round(4.0 / (kappa * DT)) + 1):
        pass
    assert state.loop_position_error < 0.05 * before


def test_relaxations_are_counted_by_what_was_relaxed(chain: ClosedChain) -> None:
    trace = run(PLAIN, replace(long_steps(chain), tasks=(replace(TURN, gain=5.0),)), 20)
    causes = [cause for status in trace.status for cause in causes_of(status)]
    expected = Counter(cause.name for cause in causes if cause.relaxed)
    assert RelaxedTicks().measure(trace) == dict(expected)
    assert set(expected) == {"TASKS_RELAXED", "STEP_SHORTENED"}
