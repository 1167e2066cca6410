"""What keeps the arms from their goals, found beside the control loop.

It has a law of its own, built as the player's is, so that nothing it does is felt there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice

from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem, Law
from coopqp.controllers import QPController
from coopqp.execution.controller_run import controller_of
from coopqp.model.state import State
from coopqp.qp_law.law import QPLaw
from coopqp.scenario.scenario import Scenario
from coopqp.signal import Trajectory
from coopqp.study.explanation import at_bound, explain, explain_standing
from coopqp.study.tick_record import record_tick
from coopqp.viewer.beside import Line
from coopqp.viewer.dials import turned
from coopqp.viewer.live import at_targets
from coopqp.viewer.messages import Look, Placed, Told


def serve(line: Line, scenario: Scenario) -> None:
    """Answer until the player ends."""
    own: _Own | None = None
    for thing in line.things():
        if isinstance(thing, Placed):
            own = _Own(scenario, thing)
        elif isinstance(thing, Look) and own:
            line.send(own.told(thing))


class _Own:
    """The law of its own."""

    def __init__(self, scenario: Scenario, placed: Placed) -> None:
        self._name = placed.law
        held = turned(scenario, placed.dials).held_by(placed.law)
        chosen = controller_of(held, placed.law)
        self._problem = _problem(held, placed.starts)
        ticks = chosen.plain if isinstance(chosen, QPController) else chosen.build
        self._law = ticks(self._problem)
        # A law that keeps no limits is held back by none.
        heeded = self._problem.limits if "limits" in chosen.supports else ()
        self._bounded = replace(self._problem, limits=heeded)

    def told(self, look: Look) -> Told:
        """What keeps the arms from their goals at an instant; says so where that raises."""
        try:
            tasks = [at_targets(task, look.targets) for task in self._problem.tasks]
            standing = explain_standing(self._bounded, tasks, look.q, rests=look.rests)
            active, detail = self._tick(look)
        except Exception as error:  # noqa: BLE001 - code of plug-ins may raise; the page goes on
            return Told(False, "", (), f"cannot be explained: {type(error).__name__}: {error}")
        return Told(standing.blocked, standing.sentence, active, detail)

    def _tick(self, look: Look) -> tuple[tuple[str, ...], str]:
        """Limits at their bound in the tick, and what it could not do."""
        if not isinstance(self._law, QPLaw):
            return (), ""
        try:
            state = _state(self._law, look)
            record = record_tick(self._law, state, scenario="", controller=self._name, tick=0)
        except CoopqpError as error:
            return (), str(error)
        return tuple(row.words for row in at_bound(record)), explain(record).sentence


def _problem(scenario: Scenario, starts: Sequence[Array]) -> ControlProblem:
    """That of the phase that is on."""
    begun = dict(zip(scenario.first_ticks[1:], starts, strict=False))
    return next(islice(scenario.problems(begun.__getitem__), len(starts), None))


def _state(law: Law, look: Look) -> State:
    state = law.start()
    state.t, state.q[:], state.v[:] = look.t, look.q, look.v
    state.memory.numbers[:] = look.memory
    state.gap[:] = look.gap
    state.corrected, state.q_measured = look.corrected, look.measured
    state.hand_wrench = look.hand_wrench
    for name, (kind, value, rate) in look.inputs.items():
        state.inputs[name] = Trajectory(kind, value)
        state.inputs[name].rate[:] = rate
    state.update()
    return state
