"""Distances in the kernel: against coal, what is proved without it, and free configurations."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scenario_files import needs_robots
from side_by_side import laws, needs_kernel, why
from watched_bodies import OF_ROBOTS, driven, near_things, robots, self_collision, watching

from coopqp.kernel.free_space import FreeSpace, Told
from coopqp.limits import Obstacles, SelfCollision
from coopqp.limits._keep_apart import distances_along
from coopqp.scenario.loader import load
from tests.kernel.distances import OFF, adverse, known, of_cases, of_robot

pytestmark = [needs_kernel, needs_robots]


@pytest.mark.few(4)
@pytest.mark.parametrize("name", OF_ROBOTS)
def test_distances_are_coals(name: str) -> None:
    """All pairs of a shipped robot at random poses; at more by python -m tests.kernel.distances."""
    seen = of_robot(load(name).problem().chain, 10)
    assert seen.passes, str(seen)
    assert seen.unknown <= 1e-3 * seen.pairs


@pytest.mark.full
def test_no_shipped_robot_is_left_out() -> None:
    assert set(robots()) == set(OF_ROBOTS)


def test_adverse_cases_are_told_with_their_error() -> None:
    """Faces that are parallel but for rounding, a nanometre apart, round and flat bodies."""
    seen = of_cases(load("two_so101").problem().chain, adverse(3000, seed=1))
    assert seen.passes, str(seen)
    assert seen.inside == 0
    assert seen.unknown <= 3


def test_configurations_are_free_that_coal_calls_free() -> None:
    """Self-collision and things in the world at once, by two threads that share what is asked."""
    chain = load("two_so101").problem().chain
    limits: list[SelfCollision | Obstacles] = [self_collision(chain), near_things(chain)]
    space = FreeSpace(chain, [limit.program(chain, 0.01) for limit in limits])
    q = np.array(list(chain.sample(np.random.default_rng(0), 60)))
    left = np.hstack([
        distances_along(chain, limit.watched(chain), q) - limit.distance for limit in limits
    ]).min(axis=1)  # fmt: skip
    clear = np.abs(left) > OFF
    with ThreadPoolExecutor(2) as two:
        for free in two.map(space.is_free, [q] * 4):
            assert np.array_equal(free[clear], left[clear] > 0.0)
    assert 0 < np.count_nonzero(left > 0.0) < len(q)
    for row, least in zip(q, left, strict=True):
        d = known(space.measure(row))
        assert len(d) == sum(len(limit.watched(chain)) for limit in limits)
        assert np.isnan(d).any() or d.min() == pytest.approx(least + 0.01, abs=OFF)


def test_garbage_is_not_free() -> None:
    chain = load("two_so101").problem().chain
    space = FreeSpace(chain, [self_collision(chain).program(chain, 0.01)])
    q = np.tile(chain.q_start, (3, 1))
    q[1, 0], q[2, 3] = np.nan, np.inf
    assert space.is_free(q).tolist() == [True, False, False]
    assert np.isnan(known(space.measure(q[1]))).any()


@pytest.mark.parametrize("name", ["two_so101", "baxter_tray"])
def test_no_answer_brings_bodies_too_near(name: str) -> None:
    """Driven into themselves and things at full speed, whatever else bounds the joints."""
    problem = driven(name, 1)
    _, kernel = laws(problem)
    state, path = kernel.start(), []
    for _ in range(200):
        kernel.step(state)
        path.append(state.q.copy())
    limits = [one for one in problem.limits if isinstance(one, SelfCollision | Obstacles)]
    for limit in limits:
        d = distances_along(problem.chain, limit.watched(problem.chain), np.array(path))
        assert d.min() > limit.distance - 1e-3
    assert kernel.compiled


def test_bodies_in_each_other_are_left_to_coal() -> None:
    """How deep they are the kernel does not measure; the plain law decides such ticks."""
    problem = watching("two_so101", things=False)
    chain = problem.chain
    space = FreeSpace(chain, [limit.program(chain, problem.dt) for limit in problem.limits])
    samples = chain.sample(np.random.default_rng(0), 100)
    inside = next(q for q in samples if (space.measure(q)[:, 0] == Told.INSIDE).any())
    _, kernel = laws(problem)
    state = kernel.start()
    kernel.tick(state)
    assert kernel.compiled
    state.q[:] = inside
    kernel.tick(state)
    assert why(kernel) == "UNPROVEN"
    assert not kernel.compiled
