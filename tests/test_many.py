"""Many motions at once are the motions one by one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from laws import UNREACHABLE
from own_task import Own

from coopqp import ClosedChain, State, TaskRows, run_many
from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.spec import Array
from coopqp.controllers import Pseudoinverse, QPController
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status
from coopqp.tasks import PointOnPoint

TICKS, MOTIONS = 60, 37
#: These take a hundred times as long.
IN_PYTHON, SLOW = ("python", "formula", "own"), 7


def to_the_front(state: State, rows: TaskRows) -> None:
    """In Python."""
    rows.e[0], rows.J[0] = state.p_WO[0] - 0.2, state.J_task[0]


def scenarios() -> Iterator[tuple[str, Scenario]]:
    """In C++ alone, with statuses of all kinds, in part and as a whole in Python."""
    given = load("point_on_point")
    hard = PointOnPoint(goal=UNREACHABLE, mode="hard")
    yield "kernel", given
    for what in ("scale", "hold", "stop"):
        yield what, replace(given, tasks=(hard,), on_infeasible=what)
    yield "three", load("three_ur")
    yield "own", replace(given, tasks=(Own(write=to_the_front),))
    yield "python", replace(given, controllers={"qp": QPController(engine="python")})
    yield "formula", replace(given, controllers={"qp": Pseudoinverse()})


def starts(chain: ClosedChain, count: int) -> Array:
    """With loops that are a little open, and some joints outside their limits."""
    rng = np.random.default_rng(1)
    return chain.q_start + 0.03 * rng.normal(size=(count, chain.n))


SCENARIOS = dict(scenarios())


@pytest.mark.few(3)
@pytest.mark.parametrize("name", list(SCENARIOS))
def test_motions_are_those_of_one_law(name: str) -> None:
    """Bit for bit, whatever the number of threads."""
    scenario = SCENARIOS[name]
    given = starts(scenario.chain, SLOW if name in IN_PYTHON else MOTIONS)
    found = [run_many(scenario, given, ticks=TICKS, threads=k) for k in (1, 2, 3)]
    for other in found[1:]:
        for of in ("q", "v", "outcomes", "compiled"):
            np.testing.assert_array_equal(getattr(found[0], of), getattr(other, of))
        assert other.causes == found[0].causes
    law, many, seen = scenario.controllers["qp"].build(scenario.problem()), found[0], set[Any]()
    for i, q in enumerate(given):
        alone = law.run(law.start(q), TICKS)
        np.testing.assert_array_equal(many.q[i], alone.q)
        np.testing.assert_array_equal(many.v[i], alone.v)
        np.testing.assert_array_equal(many.compiled[i], alone.compiled)
        assert [many.causes[k] for k in many.outcomes[i]] == alone.causes
        seen |= set(alone.causes)
    assert seen <= set(many.causes)
    assert len(set(many.causes)) == len(many.causes)
    said = [Status.TASKS_RELAXED in causes for causes in many.causes]
    assert many.share(Status.TASKS_RELAXED) == np.isin(many.outcomes, np.flatnonzero(said)).mean()


def test_nothing_is_run_from_nowhere_or_for_no_time() -> None:
    scenario = load("point_on_point")
    n = scenario.chain.n
    assert run_many(scenario, np.zeros((0, n))).q.shape == (0, scenario.ticks + 1, n)
    assert run_many(scenario, starts(scenario.chain, 3), ticks=0).v.shape == (3, 0, n)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"starts": np.zeros(10)}, "starts: found shape"),
        ({"starts": np.zeros((2, 9))}, "starts: found shape"),
        ({"starts": np.full((2, 10), np.nan)}, "starts: found"),
        ({"starts": "here"}, "starts: found 'here', needs numbers"),
        ({"starts": np.zeros((2, 10), complex)}, "starts: found array"),
        ({"ticks": 10**7, "starts": np.zeros((1000, 10))}, "they do not fit into memory"),
        ({"scenario": "point_on_point"}, "scenario: found 'point_on_point'; use coopqp.load"),
        ({"threads": 0}, "threads: found 0, needs a whole number"),
        ({"ticks": -1}, "ticks: found -1, needs a whole number"),
        ({"ticks": 1.5}, "ticks: found 1.5, needs a whole number"),
        ({"controller": "qq"}, "unknown controller 'qq'"),
        ({"controller": "torque_qp"}, "run_many: found torques"),
    ],
)
def test_what_it_cannot_do_is_said(given: dict[str, Any], words: str) -> None:
    with pytest.raises(CoopqpError, match=words):
        run_many(**{"scenario": load("point_on_point"), "starts": np.zeros((2, 10)), **given})


def test_phases_are_refused() -> None:
    scenario = load("regrasp")
    with pytest.raises(InvalidValueError, match="run_many: found phases"):
        run_many(scenario, scenario.chain.q_start[None])
