"""A way round for arms that are stuck, looked for beside the control loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.planning import Budget
from coopqp.planning.closed_space import ClosedSpace
from coopqp.planning.plan import Planner
from coopqp.scenario.scenario import Scenario
from coopqp.viewer.explainer import problem_of
from coopqp.viewer.messages import Snapshot, Way
from coopqp.viewer.steering import at_targets
from coopqp.viewer.worker import Peer

#: How long a way is looked for [s].
SECONDS = 5.0
#: How far from where the arms are a way may begin, first to last [rad, m], and tries for each.
NEAR, TRIES = (0.0, 0.001, 0.003, 0.01, 0.03), 64


def serve(peer: Peer, scenario: Scenario) -> None:
    """Answer until the player ends."""
    for snapshot in peer.messages():
        peer.send(found(scenario, snapshot))


def found(scenario: Scenario, snapshot: Snapshot) -> Way:
    """A way from where the arms are to where the tasks are met with their inputs at the targets."""
    try:
        problem = problem_of(scenario, snapshot)
        q = inside(problem, snapshot.q, scenario.seed)
        chain = problem.chain.handed_over(q, problem.chain.hold.released)
        tasks = tuple(at_targets(task, snapshot.targets) for task in problem.tasks)
        planner = Planner(replace(problem, chain=chain, tasks=tasks), snapshot.t)
        made = planner.plan(Budget(seconds=SECONDS, seed=scenario.seed))
    except Exception as error:  # noqa: BLE001 - code of plug-ins may raise; the page goes on
        return Way(f"no way round can be looked for: {error}")
    if not made.found:
        return Way(f"no way round was found in {SECONDS:g} s, which proves nothing")
    took = f"{sum(made.seconds.values()):.2g} s, {made.length:.3g} rad"
    words = f"a way round was found in {took}: Go round follows it"
    return Way(words, made.t, made.timed, made.object)


def inside(problem: ControlProblem, q: Array, seed: int) -> Array:
    """The nearest configuration found that is off the limits, on which those who are stuck lie."""
    space, rng = ClosedSpace(problem), np.random.default_rng(seed)
    for size in NEAR:
        near = q + size * rng.standard_normal((TRIES, len(q)))
        np.clip(near, space.lower, space.upper, out=near)
        near = near[space.project(near)]
        near = near[space.is_free(near)]
        if len(near):
            return np.asarray(near[np.linalg.norm(near - q, axis=1).argmin()], float)
    return q
