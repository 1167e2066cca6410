"""What keeps the arms from their goals, and a way round it, computed beside the control loop.

The explainer builds a controller of its own, as the player's is, so as not to disturb the loop.
"""

from dataclasses import replace
from itertools import islice

import numpy as np

from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.execution.controller_run import controller_of
from coopqp.model.state import State, state_of
from coopqp.planning import Budget
from coopqp.planning.closed_space import ClosedSpace
from coopqp.planning.plan import Planner
from coopqp.qp_law.law import QPLaw
from coopqp.scenario.planned import Way
from coopqp.scenario.scenario import Scenario
from coopqp.study.explanation import at_bound, explain, explain_standing
from coopqp.study.tick_record import record_tick
from coopqp.viewer.messages import Explanation, Snapshot, WayRound
from coopqp.viewer.steering import at_targets, with_dials
from coopqp.viewer.worker import Peer

SECONDS = 5.0  # how long a way is looked for [s]
#: How far from where the arms are a way may begin, first to last [rad, m], and tries for each.
NEAR, TRIES = (0.0, 0.001, 0.003, 0.01, 0.03), 64


def serve(peer: Peer, scenario: Scenario) -> None:
    """Answer until the player ends."""
    built_for = None
    for snapshot in peer.messages():
        controller = snapshot.law, snapshot.dials, [q.tolist() for q in snapshot.starts]
        if controller != built_for:
            explainer, built_for = _Explainer(scenario, snapshot), controller
        peer.send(explainer.explain(snapshot))


def problem_of(scenario: Scenario, snapshot: Snapshot) -> ControlProblem:
    """What the controller of a snapshot was built for in its phase."""
    held = with_dials(scenario, snapshot.dials).held_by(snapshot.law)
    begun = dict(zip(held.first_ticks[1:], snapshot.starts, strict=False))
    return next(islice(held.problems(begun.__getitem__), len(snapshot.starts), None))


class _Explainer:
    def __init__(self, scenario: Scenario, snapshot: Snapshot) -> None:
        self._name, self._problem = snapshot.law, problem_of(scenario, snapshot)
        controller = controller_of(scenario, self._name)
        build = controller.plain if isinstance(controller, QPController) else controller.build
        self._law = build(self._problem)
        # A controller that keeps no limits is held back by none.
        limits = self._problem.limits if "limits" in controller.supports else ()
        self._bounded = replace(self._problem, limits=limits)

    def explain(self, snapshot: Snapshot) -> Explanation:
        """What keeps the arms from their goals; an error of plug-ins becomes the detail."""
        try:
            tasks = [at_targets(task, snapshot.targets) for task in self._problem.tasks]
            state = state_of(self._problem.chain, snapshot.state)
            standing = explain_standing(self._bounded, tasks, state.q, rests=snapshot.rests)
            active, detail = self._tick(state)
        except Exception as error:  # noqa: BLE001 - code of plug-ins may raise; the page goes on
            return Explanation(detail=f"cannot be explained: {type(error).__name__}: {error}")
        return Explanation(standing.blocked, standing.sentence, active, detail)

    def _tick(self, state: State) -> tuple[tuple[str, ...], str]:
        """Limits at their bound in the tick, and what it could not do."""
        if not isinstance(self._law, QPLaw):
            return (), ""
        try:
            record = record_tick(self._law, state, scenario="", controller=self._name, tick=0)
        except CoopqpError as error:
            return (), str(error)
        return tuple(row.label for row in at_bound(record)), explain(record).sentence


def serve_ways(peer: Peer, scenario: Scenario) -> None:
    """Answer until the player ends."""
    for snapshot in peer.messages():
        peer.send(way_round(scenario, snapshot))


def way_round(scenario: Scenario, snapshot: Snapshot) -> WayRound:
    """A way from where the arms are to where the tasks are met with their inputs at the targets."""
    try:
        problem = problem_of(scenario, snapshot)
        state = state_of(problem.chain, snapshot.state)
        q = inside(problem, state.q, scenario.seed)
        chain = problem.chain.handed_over(q, problem.chain.hold.released)
        tasks = tuple(at_targets(task, snapshot.targets) for task in problem.tasks)
        planner = Planner(replace(problem, chain=chain, tasks=tasks), state.t)
        made = planner.plan(Budget(seconds=SECONDS, seed=scenario.seed))
    except Exception as error:  # noqa: BLE001 - code of plug-ins may raise; the page goes on
        return WayRound(f"no way round can be looked for: {error}")
    if not made.success:
        return WayRound(f"no way round was found in {SECONDS:g} s, which proves nothing")
    took = f"{sum(made.seconds.values()):.2g} s, {made.length:.3g} rad"
    words = f"a way round was found in {took}: Go round follows it"
    return WayRound(words, Way(made.t, made.timed, made.object))


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
