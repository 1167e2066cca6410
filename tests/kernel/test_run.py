"""Many ticks at once are those that are made one by one."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from chains import Walk
from laws import LIMITS, NEAR, UNREACHABLE, problem
from side_by_side import needs_kernel
from stress.draw import LAW as STRESSED
from stress.draw import draw

from coopqp.base.spec import Array
from coopqp.controllers import QPController
from coopqp.kernel.law import KernelLaw
from coopqp.model.closed_chain import ClosedChain
from coopqp.tasks import JointCentering, PointOnPoint

pytestmark = needs_kernel

TICKS = 300


def law_for(chain: ClosedChain, goal: tuple[float, float, float]) -> KernelLaw:
    """To a point, with joint centring."""
    reach = PointOnPoint(name="reach", goal=goal)
    given = problem(chain, reach, limits=LIMITS, secondary=[JointCentering(gain=0.5)])
    law = QPController(engine="kernel").build(given)
    assert isinstance(law, KernelLaw)
    return law


@pytest.mark.parametrize("goal", [NEAR, UNREACHABLE])
@pytest.mark.parametrize("outside", [0.0, 0.05])
def test_a_run_is_its_ticks(
    goal: tuple[float, float, float], outside: float, chain: ClosedChain
) -> None:
    """Bit for bit; also where a joint comes back from outside."""
    law, q_start = law_for(chain, goal), chain.q_start.copy()
    q_start[0] += outside * 50.0
    state, again = law.start(q_start), law.start(q_start)
    found = law.run(state, TICKS)
    for k in range(TICKS):
        np.testing.assert_array_equal(found.q[k], again.q)
        command = law.tick(again)
        np.testing.assert_array_equal(found.v[k], command.v)
        assert (found.causes[k], found.compiled[k]) == (command.causes, law.compiled)
        again.advance(command.v, law.problem.dt)
    np.testing.assert_array_equal(state.q, again.q)
    assert state.t == again.t


@pytest.mark.parametrize("seed", [7, 32, 72, 90, 268])
def test_a_drawn_run_is_its_ticks(seed: int) -> None:
    """Hard tasks that are given up, ticks that stand still, steps that are shortened.

    Where all robots are installed, seed 32 draws an arm that moves relative to the other.
    """
    given = draw(seed).problem
    law, other = STRESSED.unprepared(given), STRESSED.build(given)
    state, again = law.start(), other.start()
    found = law.run(state, TICKS)
    for k in range(TICKS):
        command = other.tick(again)
        np.testing.assert_array_equal(found.v[k], command.v)
        assert (found.causes[k], found.compiled[k]) == (command.causes, other.compiled)
        again.advance(command.v, given.dt)
    np.testing.assert_array_equal(state.memory.numbers, again.memory.numbers)


def test_two_threads_give_the_bits_of_one(chain: ClosedChain, closed_loop_walk: Walk) -> None:
    starts = closed_loop_walk(chain, 4)

    def end(q: Array) -> Array:
        law = law_for(chain, NEAR)
        return law.run(law.start(q), TICKS).q[-1]

    alone = [end(q) for q in starts]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(end, starts))
    np.testing.assert_array_equal(alone, together)


@pytest.mark.parametrize("goal", [NEAR, UNREACHABLE])
def test_a_step_is_a_tick_and_an_advance(
    goal: tuple[float, float, float], chain: ClosedChain
) -> None:
    law = law_for(chain, goal)
    state, again = law.start(), law.start()
    for _ in range(TICKS):
        command = law.tick(again)
        again.advance(command.v, law.problem.dt)
        v, causes = command.v.copy(), command.causes
        command = law.step(state)
        np.testing.assert_array_equal(command.v, v)
        assert command.causes == causes
    np.testing.assert_array_equal(state.q, again.q)
    np.testing.assert_array_equal(state.v, again.v)
    assert (state.t, state.overwritten) == (again.t, False)
