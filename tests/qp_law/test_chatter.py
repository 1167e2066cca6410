"""Joints that oscillate are damped more; a step that needs more than there is becomes shorter."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Literal

import laws
import numpy as np
import pytest
from laws import DT, LIMITS, NEAR, STEP

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.grasps import Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import Memory, State
from coopqp.qp_law.equations import (
    FADES_AFTER,
    FADES_IN,
    FIRM,
    LETS_GO,
    MOST_DAMPING,
    held_pull,
    note_chatter,
)
from coopqp.robots import PlanarPair
from coopqp.tasks import JointCentering, Orientation, PointOnPlane, PointOnPoint

problem = partial(laws.problem, limits=LIMITS)
both_engines = pytest.mark.parametrize("engine", ["python", "auto"])


def centred(chain: ClosedChain) -> ControlProblem:
    """A plane to reach, and joints to centre in what that leaves."""
    goal = PointOnPlane(name="near", normal=(0, 0, 1), through=NEAR, profile=STEP)
    return problem(chain, goal, secondary=[JointCentering(name="centre", gain=5.0)])


def after(chatter: float, velocities: Sequence[tuple[float, float]], chain: ClosedChain) -> float:
    """What is remembered when the first two joints go at these velocities, tick by tick."""
    state = State(chain, memory=Memory({"chatter": 1 + chain.n}))
    state.memory["chatter"][0] = chatter
    for pair in velocities:
        v = np.zeros(chain.n)
        v[:2] = pair
        note_chatter(state, v, DT)
        state.v[:] = v
    return float(state.memory["chatter"][0])


def test_damping_grows_by_half_up_to_sixteen_times(chain: ClosedChain) -> None:
    back_and_forth = [(0.1, 0.0), (-0.1, 0.0)] * 8
    assert [after(0.0, back_and_forth[: k + 3], chain) for k in range(3)] == [0.5, 1.25, 2.375]
    assert after(0.0, back_and_forth, chain) == 15.0


def test_chatter_beside_a_joint_that_goes_on_much_faster_is_seen(chain: ClosedChain) -> None:
    assert after(0.0, [(0.001, 1.0), (-0.001, 1.0), (0.001, 1.0)], chain) == 0.5


@pytest.mark.parametrize("half", [2, 13, 25])
def test_joint_that_reverses_again_and_again_is_damped_more(half: int, chain: ClosedChain) -> None:
    swing = [(0.002, 0.0) if k % (2 * half) < half else (-0.002, 0.0) for k in range(24 * half)]
    assert after(0.0, swing, chain) > 0.05


@pytest.mark.parametrize(
    "velocities",
    [
        [(0.1, 0.0), (0.1, 0.0)],  # goes on
        [(0.1, 0.0), (0.0, 0.0), (-0.1, 0.0)],  # stands in between
        [*[(0.1, 0.0)] * 9, *[(-0.1, 0.0)] * 9, *[(0.1, 0.0)] * 9, (-0.1, 0.0)],  # turns thrice
        [
            (0.1, 0.0) if k % 60 < 30 else (-0.1, 0.0) for k in range(240)
        ],  # swings as it is asked to
        [(0.00019, 0.0), (-0.00019, 0.0), (0.00019, 0.0)],  # slowly
        [(0.1, 0.1), (-0.1, 0.1), (-0.1, -0.1)],  # one joint after the other
    ],
)
def test_what_is_no_chatter_lets_it_fade(
    velocities: list[tuple[float, float]], chain: ClosedChain
) -> None:
    assert after(0.0, velocities, chain) == 0.0
    rates = np.array([max(map(abs, pair)) / FADES_IN for pair in velocities])
    by_travel, in_time = (np.prod(1.0 + DT * more) for more in (rates, rates + 1.0 / FADES_AFTER))
    grown = 1.0 + after(1.0, velocities, chain)
    assert max(2.0 / in_time, 1.0) - 1e-12 < grown < max(2.0 / by_travel, 1.0) + 1e-12


@pytest.mark.parametrize("swings", [0, 2])
def test_damping_fades_in_time_while_no_joint_has_reversed_of_late(
    swings: int, chain: ClosedChain
) -> None:
    swing = [(0.1, 0.0), (-0.1, 0.0)] * swings
    grown, later = (1.0 + after(9.0, swing + [(-0.1, 0.0)] * k, chain) for k in (1, 21))
    rate = 0.1 / FADES_IN + (0.0 if swings else 1.0 / FADES_AFTER)
    assert later == pytest.approx(grown / (1.0 + DT * rate) ** 20)


def test_arms_at_rest_keep_their_damping(chain: ClosedChain) -> None:
    assert after(3.0, [(0.0, 0.0)] * 100, chain) == 3.0


def commanded(law: QPController, chain: ClosedChain, memory: str, value: float) -> Array:
    """The command of a first tick that remembers something."""
    return ticked(law, centred(chain), memory, value)


def ticked(
    law: QPController, asked: ControlProblem, memory: str, value: float | list[float]
) -> Array:
    """Likewise, of any problem."""
    built = law.build(asked)
    state = built.start()
    state.memory[memory][:] = value
    return built.tick(state).v.copy()


@both_engines
def test_chatter_is_damped_as_by_a_larger_error_damping(
    engine: Literal["python", "auto"], chain: ClosedChain
) -> None:
    near = PointOnPlane(name="near", normal=(0, 0, 1), through=NEAR, profile=STEP)
    asked, law = problem(chain, near), QPController(engine=engine)
    calmer = ticked(QPController(engine=engine, error_damping=1.5), asked, "chatter", 0.0)
    damped = ticked(law, asked, "chatter", [2.0, *[0.0] * chain.n])
    np.testing.assert_allclose(damped, calmer, rtol=0.0, atol=1e-12)
    assert np.linalg.norm(damped - ticked(law, asked, "chatter", 0.0)) > 1e-6


@both_engines
def test_joint_objective_that_chatters_is_slower(
    engine: Literal["python", "auto"], chain: ClosedChain
) -> None:
    alone = problem(chain, secondary=[JointCentering(name="centre", gain=0.5)])
    law = QPController(engine=engine)
    fast, slow = (ticked(law, alone, "chatter", [s, *[0.0] * chain.n]) for s in (0.0, 2.0))
    np.testing.assert_allclose(slow, fast / 3.0, rtol=1e-5, atol=1e-12)
    assert np.linalg.norm(fast) > 1e-3


@both_engines
def test_step_that_needs_more_damping_than_there_is_is_shortened(
    engine: Literal["python", "auto"], chain: ClosedChain
) -> None:
    """Along the way to where the most damping leads, by what of the damping there is."""
    most = MOST_DAMPING / (0.5 * DT)  # pull at which damping is as large as it gets
    law = QPController(engine=engine)
    whole, half, none = (commanded(law, chain, "later pulls", k * most) for k in (1.0, 2.0, 1e9))
    np.testing.assert_allclose(half - none, 0.5 * (whole - none), rtol=1e-6, atol=1e-12)
    assert np.linalg.norm(whole - none) > 1e-7


def test_pull_that_passes_through_zero_is_let_go_slowly() -> None:
    assert held_pull(0.0, 1e6) == LETS_GO * 1e6
    assert held_pull(2e6, 1e6) == 2e6
    assert held_pull(0.0, FIRM) == 0.0


@pytest.mark.few(3)
@both_engines
@pytest.mark.parametrize("mode", ["hard", "soft"])
@pytest.mark.parametrize("turns", [True, False])
def test_arms_that_lie_stretched_come_to_rest(
    engine: Literal["python", "auto"], mode: Literal["hard", "soft"], turns: bool
) -> None:
    """A later level takes a direction over gradually that a stretched pose hides from a task.

    All at once it would leave the pose in one tick and be brought back in the next, for ever, at
    1e-4 to 1e-3 rad/s.
    """
    reach = PointOnPoint(name="reach", goal=(0.646, 0.0, 0.0), profile=STEP, mode=mode)
    turn = Orientation(name="turn", rpy_deg=(0.0, 0.0, 10.0), profile=STEP, priority=1)
    q = np.radians([-20, 70, -50, 20, -70, 50])
    planar = ClosedChain.attach(PlanarPair().build(), q, Rigid(), HeldObject())
    given = problem(planar, reach, *([turn] if turns else []), secondary=[JointCentering(gain=0.5)])
    law = QPController(engine=engine).build(given)
    assert np.abs(law.run(law.start(), 800).v[-200:]).max() < 1e-9
