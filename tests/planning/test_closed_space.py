"""Closed configurations and ways between them, against pinocchio's kinematics and coal."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest
from scenario_files import needs_robots
from side_by_side import needs_kernel
from stress import arrangements
from variants import variants

from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.kernel import native
from coopqp.limits import SelfCollision
from coopqp.limits._keep_apart import distances_along
from coopqp.model.closed_chain import ClosedChain
from coopqp.planning.closed_path import lengths
from coopqp.planning.closed_space import Budget, ClosedSpace, along
from coopqp.scenario.loader import load
from coopqp.study.explanation.goal import Goal

pytestmark = [needs_kernel, needs_robots]

NAMES = ("point_on_point", "planar_pair", "two_so101", "three_ur", "tiago_torso", "baxter_tray")


def _space(name: str) -> ClosedSpace:
    return ClosedSpace(load(name).problem())


def _open(chain: ClosedChain, q: Array) -> float:
    return max(float(np.abs(chain.loop_error(row)).max()) for row in q)


@pytest.mark.parametrize("name", NAMES)
def test_what_is_called_closed_is_closed_and_inside_the_limits(name: str) -> None:
    space = _space(name)
    q = space.sample(np.random.default_rng(3), 200)
    closed = space.project(q)
    assert closed.sum() >= 20
    assert _open(space.chain, q[closed]) < 1e-8
    assert (q[closed] >= space.lower).all()
    assert (q[closed] <= space.upper).all()


@pytest.mark.parametrize("name", arrangements.names())
def test_loops_of_every_arrangement_are_closed_again(name: str) -> None:
    """Also where there are more rows than independent ones, as in planar and Bennett linkages."""
    chain = arrangements.chain(name, arrangements.grasps_of(name)[-1])
    base = load("planar_pair").problem()
    space = ClosedSpace(type(base)(**{**vars(base), "chain": chain, "tasks": (), "limits": ()}))
    walk = list(chain.closed_walk(3)) if chain.loops.closed else []
    q = np.array(walk or [chain.q_start])
    off = q + 1e-3 * np.random.default_rng(0).normal(size=q.shape)
    assert space.project(off).all()
    assert not chain.loops.closed or _open(chain, off) < 1e-6
    assert np.abs(off - q).max() < 0.05


def test_a_point_of_least_distance_is_found_near_the_manifold() -> None:
    """The step back is normal to the manifold: along the loops' Jacobian, as pinocchio has it."""
    space = _space("baxter_tray")
    q = space.chain.q_start[None].copy()
    space.project(q)
    off = q + 1e-4 * np.random.default_rng(5).normal(size=q.shape)
    back = off.copy()
    assert space.project(back).all()
    J = space.chain.loop_jacobian(q[0])
    step = (back - off)[0]
    along_rows = J.T @ np.linalg.lstsq(J.T, step, rcond=None)[0]
    np.testing.assert_allclose(step, along_rows, atol=1e-6)


def test_tasks_are_held() -> None:
    scenario = load("point_on_point")
    problem, t = scenario.problem(), scenario.duration
    space = ClosedSpace(problem, problem.tasks, t)
    q = space.sample(np.random.default_rng(1), 100)
    q = q[space.project(q)]
    goal = Goal(problem.chain, problem.tasks, t)
    assert len(q) > 10
    for row in q:
        goal.look(row)
        assert np.abs(goal.stack.e).max() < 1e-8


def test_what_is_free_is_so_by_coal() -> None:
    space = _space("two_so101")
    q = space.sample(np.random.default_rng(2), 200)
    q = q[space.project(q)]
    (limit,) = (x for x in load("two_so101").limits if isinstance(x, SelfCollision))
    pairs = limit.watched(space.chain)
    d = distances_along(space.chain, pairs, q).min(axis=1)
    clear = np.abs(d - 0.01) > 1e-6
    free = space.is_free(q)
    assert 0 < free.sum() < len(q)
    np.testing.assert_array_equal(free[clear], (d > 0.01)[clear])


@pytest.mark.parametrize("name", ["point_on_point", "two_so101", "shelves"])
def test_a_way_is_closed_free_and_inside_the_limits_between_its_points(name: str) -> None:
    space, goals = _goals(name)
    start = space.chain.q_start[None].copy()
    assert space.project(start).all()
    found = space.way(start, goals, Budget(seconds=60.0))
    assert np.abs(found[0] - start).max() < 1e-9
    assert np.abs(found[-1] - goals).max(axis=1).min() < 1e-9
    assert np.linalg.norm(np.diff(found, axis=0), axis=1).max() <= Budget().fine * 1.0001
    first = space.way(start, goals, Budget(seconds=60.0, shortcuts=0))
    assert lengths(found)[-1] <= lengths(first)[-1] + 1e-9
    assert _open(space.chain, along(found, 0.003)) < 1e-4
    assert space.is_free(found[1:]).all()
    assert (found >= space.lower).all()
    assert (found <= space.upper).all()


def _goals(name: str) -> tuple[ClosedSpace, Array]:
    scenario = load(name)
    problem = scenario.problem()
    goals = ClosedSpace(problem, problem.tasks, scenario.duration)
    q = goals.sample(np.random.default_rng(0), 400)
    q = q[goals.project(q)]
    q = q[goals.is_free(q)]
    return ClosedSpace(problem), q[np.argsort(np.linalg.norm(q - problem.chain.q_start, axis=1))][
        :8
    ]


def test_equal_seeds_give_equal_bits_on_every_variant_and_others_other_ways() -> None:
    ways = []
    for module in variants():
        with patch.object(native, "module", lambda module=module: module):
            space, goals = _goals("shelves")
            for seed in (1, 1, 2):
                q = space.chain.q_start[None]
                ways.append(space.way(q, goals, Budget(seconds=60.0, seed=seed)))
    for k in range(0, len(ways), 3):
        assert ways[k].tobytes() == ways[k + 1].tobytes() == ways[0].tobytes()
        assert ways[k].tobytes() != ways[k + 2].tobytes()


def test_without_time_nothing_is_found() -> None:
    space, goals = _goals("shelves")
    found = space.way(space.chain.q_start[None], goals, Budget(seconds=0.0))
    assert found.shape == (0, 14)


def test_a_search_ends_where_the_caller_raises() -> None:
    """As on Ctrl-C; the goal is behind a wall that nobody passes, so that the search goes on."""
    space, goals = _goals("shelves")

    def stop() -> None:
        raise KeyboardInterrupt

    space.others = lambda q: bool(np.abs(q - space.chain.q_start).max() < 0.3)
    budget = Budget(seconds=60.0, max_projections=10**9)
    with pytest.raises(KeyboardInterrupt):
        space.way(space.chain.q_start[None], goals, budget, stop)


def test_charts_lead_with_as_many_joints_as_there_are_freedoms() -> None:
    for name, free in (("point_on_point", 4), ("three_ur", 6), ("planar_pair", 3)):
        charts = _space(name).charts
        led = charts.sum(axis=1)
        assert set(led.tolist()) <= {0, free}
        assert (led == free).any()


def test_without_the_kernel_it_is_said_how_to_get_it() -> None:
    problem = load("planar_pair").problem()
    with (
        patch.object(native, "module", lambda: None),
        pytest.raises(CoopqpError, match="compiled kernel: the kernel is not built"),
    ):
        ClosedSpace(problem)


def test_tasks_that_follow_signals_cannot_be_held() -> None:
    problem = load("pr2_circle").problem()
    with pytest.raises(CoopqpError, match="needs a fixed goal"):
        ClosedSpace(problem, problem.tasks)
