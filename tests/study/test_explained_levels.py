"""Drawn runs in which hard or scaled tasks cannot hold beside soft ones: who is blamed for it.

What is true of a run is read from its trace: which tasks end outside their tolerances, which of
these comes first, and how much of its rate the worst hard or scaled task lacks.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from explained import explained, nao
from stress import goals
from stress.goals import BUILDERS, pick, random_aim

from coopqp.assessment import assess
from coopqp.base.spec import Array
from coopqp.controllers import QPController
from coopqp.execution.controller_run import run
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status, causes_of
from coopqp.study.explanation import RunExplanation, explain_run
from coopqp.task import Task, TaskStack
from coopqp.tasks import PointOnPlane, PointOnPoint
from coopqp.trace import Trace

ROBOTS = ("point_on_point", "planar_pair", "yeo_4_5")
KINDS = tuple(kind for kind in BUILDERS if kind != "relative_motion")
AT_LEAST = 0.02  # share of a rate that is worth telling
DRAWS = 16


@cache
def base(name: str) -> Scenario:
    given = load(name)
    return given.changed(controllers={"qp": QPController()}, secondary=(), source="")


def draw(seed: int) -> Scenario:
    """A hard or scaled task of any kind, often unreachable, beside one to three soft ones."""
    rng = np.random.default_rng([25, seed])
    given = base(ROBOTS[seed % len(ROBOTS)])
    chain, kind = given.chain, KINDS[seed // 2 % len(KINDS)]
    X = chain.object_pose(chain.q_start)

    def task(name: str, kind: str, **settings: Any) -> Task:
        aim = random_aim(rng, goals.anywhere(rng, X, 1.5 * chain.reach))
        profile = Profile(duration=float(rng.uniform(0.3, 1.0)))
        return BUILDERS[kind](aim, {"name": name, "profile": profile, **settings})

    firm = task("firm", kind, mode=pick(rng, ("hard", "scaled")))
    soft = [
        task(f"soft {i}", pick(rng, KINDS), priority=int(rng.integers(3)))
        for i in range(int(rng.integers(1, 4)))
    ]
    tasks = [*soft, firm]
    order = rng.permutation(len(tasks)).tolist()
    dt = float(pick(rng, (0.01, 0.02)))
    return given.changed(
        tasks=tuple(tasks[i] for i in order), dt=dt, kappa=np.inf, duration=3.0, limits=given.limits
    )


def lacking(scenario: Scenario, trace: Trace) -> dict[str, float]:
    """The share of its rate that each hard or scaled task lacks in the last tick."""
    problem, k = scenario.problem(), len(trace.v) - 1
    state, stack = State(problem.chain), TaskStack(problem.tasks, State(problem.chain))
    state.q[:], state.t, state.v[:] = trace.q[k], k * scenario.dt, trace.v[k - 1]
    state.update()
    stack.update(state)
    off: Array = stack.J @ trace.v[k] - stack.wanted
    return {
        task.name: float(np.linalg.norm(off[own]) / max(np.linalg.norm(stack.wanted[own]), 1e-6))
        for task, own in zip(problem.tasks, stack.slices, strict=True)
        if task.mode != "soft"
    }


@pytest.fixture(scope="module")
def drawn() -> list[tuple[Scenario, Trace, RunExplanation]]:
    scenarios = list(map(draw, range(DRAWS)))
    traces = [run(scenario, controller="qp", timed=False) for scenario in scenarios]
    return [(*one, explain_run(*one)) for one in zip(scenarios, traces, strict=True)]


@pytest.mark.full
def test_a_miss_is_blamed_on_no_task_that_comes_later(
    drawn: list[tuple[Scenario, Trace, RunExplanation]],
) -> None:
    firm = 0
    for scenario, trace, found in drawn:
        missed = assess(trace).missed
        if not missed:
            continue
        level = {task.name: task.level for task in scenario.tasks}
        first = missed[0].name.split(".")[0]
        assert level[found.missed[0].task.split(".")[0]] == level[first]
        assert all(level[name] <= level[first] for name in found.tasks), found.sentence
        assert first in found.sentence
        firm += first == "firm"
    assert firm > DRAWS // 3


def test_tasks_that_lack_something_at_the_end_are_named_with_how_much(
    drawn: list[tuple[Scenario, Trace, RunExplanation]],
) -> None:
    count = 0
    for scenario, trace, found in drawn:
        told, lacks = {task.task: task.missing for task in found.relaxed}, lacking(scenario, trace)
        assert [told[name] for name in told] == pytest.approx(
            [lacks[n] for n in told], abs=AT_LEAST
        )
        if Status.TASKS_RELAXED not in causes_of(trace.status[-1]):
            continue
        for name, lack in lacks.items():
            assert told.get(name, 0.0) == pytest.approx(lack, abs=AT_LEAST)
            assert 1.0 - trace.scale[-1] == pytest.approx(lack, abs=AT_LEAST)  # there is one
            count += lack > AT_LEAST
    assert count > DRAWS // 4


def test_a_scaled_task_that_hardly_moves_is_not_told_to_be_met() -> None:
    """A share of 1e-5 is OPTIMAL; the run ends in such a tick."""
    up = PointOnPlane(name="up", mode="hard", normal=(0, 0, 1), through=(0, 0, 0.1))
    fore = PointOnPlane(name="fore", mode="scaled", normal=(1, 0, 0), through=(0.3, 0, 0))
    side = PointOnPlane(name="side", normal=(0, 1, 0), through=(0, 0.02, 0))
    quick = [replace(task, profile=Profile(duration=1.0)) for task in (up, fore, side)]
    trace = run(nao(*quick, duration=6.0), controller="qp", timed=False)
    end = max(k for k, word in enumerate(trace.status) if word == "OPTIMAL")
    assert trace.scale[end] < 1e-3
    found = explained(nao(*quick, duration=0.01 * (end + 1)))
    assert found.relaxed
    assert "lacks more than 99 % of its rate at the end" in found.sentence


def relaxation_for(tasks: tuple[Task, ...]) -> str:
    reach = PointOnPoint(name="reach", goal=(0.12, 0.06, 0.03), mode="hard")
    return explained(nao(reach, *tasks, duration=6.0)).sentence


def test_what_would_do_for_a_hard_task_is_no_matter_of_soft_ones() -> None:
    """A soft height that contradicts the hard point; the same limits help the point."""
    height = PointOnPlane(name="height", normal=(0, 0, 1), through=(0.1, 0, 0.05), priority=2)
    alone, beside = relaxation_for(()), relaxation_for((height,))
    would = "to reach the goal, relax RShoulderRoll (upper) by 0.13 rad"
    assert would in alone
    assert would in beside
    assert "(tried: reached)" in alone
    assert "(tried: reached; height stops 20 mm short)" in beside


# Where hard tasks that cannot hold make the arms stand still


def held(seed: int) -> Scenario:
    """A hard task in reach that at times asks for more speed than there is."""
    rng = np.random.default_rng([77, seed])
    given = base(ROBOTS[seed % 2])
    chain = given.chain
    goal = chain.start_position + rng.uniform(-0.04, 0.04, 3) * (1, 1, given.name != "planar_pair")
    x, y, z = goal.tolist()
    kind: Any = pick(rng, ("quintic", "step"))
    task = PointOnPoint(
        name="firm", goal=(x, y, z), mode="hard", gain=10.0,
        profile=Profile(kind=kind, duration=float(rng.uniform(0.05, 0.15))),
    )  # fmt: skip
    return given.changed(tasks=(task,), on_infeasible=pick(rng, ("hold", "stop")), duration=2.0)


def changed_as(way: str, scenario: Scenario) -> Scenario:
    """The scenario after somebody has done what an explanation says."""
    (task,) = scenario.tasks
    if way == "on_infeasible: scale":
        return scenario.changed(on_infeasible="scale")
    if way == "mode: scaled":
        return scenario.changed(tasks=(replace(task, mode="scaled"),))
    times = float(way.removeprefix("profile.duration times "))
    assert task.way
    slower: Any = {"profile": replace(task.way, duration=times * task.way.duration)}
    return scenario.changed(tasks=(replace(task, **slower),))


def advised(sentence: str) -> Iterator[tuple[str, float]]:
    (ways,) = re.findall(r"; with (.*?) the goal is reached \(tried\)", sentence)
    for way in ways.split(" or "):
        words, time = re.fullmatch(r"(.*) \(in (.*) s\)", way).groups()  # type: ignore[union-attr]
        yield words, float(time)


def test_arms_that_hold_still_say_so_and_what_is_advised_reaches_the_goal() -> None:
    kinds = set[str]()
    for scenario in map(held, range(12)):
        trace = run(scenario, controller="qp", timed=False)
        relaxed = run(scenario.changed(on_infeasible="scale"), controller="qp", timed=False)
        if assess(trace).reached or not assess(relaxed).reached:
            continue
        count = sum(not causes_of(word)[0].usable for word in trace.status)
        found = explain_run(scenario, trace)
        said = f"stands still in {count} of {len(trace.v)} ticks, as on_infeasible is "
        assert f"{said}{scenario.on_infeasible} and 'firm' cannot be met in full" in found.sentence
        for way, time in advised(found.sentence):
            then = changed_as(way, scenario).changed(duration=time + scenario.dt)
            assert assess(run(then, controller="qp", timed=False)).reached, (way, time)
            kinds.add(way)
    assert {"on_infeasible: scale", "mode: scaled", "profile.duration times 4"} <= kinds


def test_hard_tasks_out_of_reach_are_told_what_scale_would_do() -> None:
    far = PointOnPoint(name="far", goal=(0.23, 0.0, 0.086), mode="hard")
    asked = nao(far, on_infeasible="hold")
    found = explained(asked)
    assert found.kind == "reach"
    rest = assess(run(asked.changed(on_infeasible="scale", duration=8.0), controller="qp"))
    assert (
        f"with on_infeasible: scale far stops {1e3 * rest.tasks[0].error:.3g} mm short (tried)"
        in (found.sentence)
    )
