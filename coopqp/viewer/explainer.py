"""What keeps the arms from their goals, computed beside the control loop.

It builds a controller of its own, as the player's is, so that it does not disturb the loop.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

from coopqp.base.errors import CoopqpError
from coopqp.controller import ControlProblem, Law
from coopqp.controllers import QPController
from coopqp.execution.controller_run import controller_of
from coopqp.model.state import State
from coopqp.qp_law.law import QPLaw
from coopqp.scenario.scenario import Scenario
from coopqp.signal import Trajectory
from coopqp.study.explanation import at_bound, explain, explain_standing
from coopqp.study.tick_record import record_tick
from coopqp.viewer.messages import Explanation, Snapshot
from coopqp.viewer.steering import at_targets, with_dials
from coopqp.viewer.worker import Peer


def serve(peer: Peer, scenario: Scenario) -> None:
    """Answer until the player ends."""
    explainer, built_for = None, None
    for snapshot in peer.messages():
        controller = snapshot.law, snapshot.dials, [q.tolist() for q in snapshot.starts]
        if explainer is None or controller != built_for:
            explainer, built_for = _Explainer(scenario, snapshot), controller
        peer.send(explainer.explain(snapshot))


def problem_of(scenario: Scenario, snapshot: Snapshot) -> ControlProblem:
    """What the controller of a snapshot was built for in its phase."""
    held = with_dials(scenario, snapshot.dials).held_by(snapshot.law)
    begun = dict(zip(held.first_ticks[1:], snapshot.starts, strict=False))
    return next(islice(held.problems(begun.__getitem__), len(snapshot.starts), None))


class _Explainer:
    """Explains the controller of a snapshot in its phase."""

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
            standing = explain_standing(self._bounded, tasks, snapshot.q, rests=snapshot.rests)
            active, detail = self._tick(snapshot)
        except Exception as error:  # noqa: BLE001 - code of plug-ins may raise; the page goes on
            return Explanation(detail=f"cannot be explained: {type(error).__name__}: {error}")
        return Explanation(standing.blocked, standing.sentence, active, detail)

    def _tick(self, snapshot: Snapshot) -> tuple[tuple[str, ...], str]:
        """Limits at their bound in the tick, and what it could not do."""
        if not isinstance(self._law, QPLaw):
            return (), ""
        try:
            state = _state(self._law, snapshot)
            record = record_tick(self._law, state, scenario="", controller=self._name, tick=0)
        except CoopqpError as error:
            return (), str(error)
        return tuple(row.words for row in at_bound(record)), explain(record).sentence


def _state(law: Law, snapshot: Snapshot) -> State:
    state = law.start()
    state.t, state.q[:], state.v[:] = snapshot.t, snapshot.q, snapshot.v
    state.memory.numbers[:], state.gap[:] = snapshot.memory, snapshot.gap
    state.corrected, state.q_measured = snapshot.corrected, snapshot.measured
    state.hand_wrench = snapshot.hand_wrench
    for name, (kind, value, rate) in snapshot.inputs.items():
        state.inputs[name] = Trajectory(kind, value)
        state.inputs[name].rate[:] = rate
    state.update()
    return state
