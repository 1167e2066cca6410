"""Laws in closed form, compiled: ``core/resolved_rate.hpp`` has the formula."""

from dataclasses import replace
from typing import Any

from coopqp.controller import Command, ControlProblem, Law
from coopqp.kernel.compiled import Compiled, Limits, Outcome, plain_numbers
from coopqp.kernel.flat import Group, why_not
from coopqp.model.state import Memory, State
from coopqp.qp_law.law import memory_sizes
from coopqp.solver import Status
from coopqp.task import Programs, Task

OPTIMAL = int(Outcome.OPTIMAL)


class FormulaLaw(Law):
    """A law whose ``decide`` has a closed formula; the kernel computes it where it can.

    It cannot where tasks have rows in Python or follow inputs, and where rows are nearly dependent:
    then ranks are decided in Python, by singular values.

    Args:
        damping: of damped least squares [m/rad]; 0 for none.
        weighted: whether joints that move towards a limit move less.
        null_space: whether secondary objectives enter as Z.
    """

    def __init__(
        self,
        problem: ControlProblem,
        *,
        damping: float = 0.0,
        weighted: bool = False,
        null_space: bool = False,
    ) -> None:
        super().__init__(problem)
        secondary = tuple(problem.secondary) if null_space else ()
        weight = sum(float(task.weight) for task in secondary)
        self._numbers = damping, weighted, 1.0 / max(weight, 1e-300) if weight else 0.0
        self._whole = _compiled(problem, secondary)
        self._shown: tuple[Any, ...] = (None,) * 5

    def _tick_in_turn(self, state: State) -> Command:
        inputs = state.inputs
        sensed = state.q_measured is not None or inputs.stale or inputs.refused
        self.compiled = bool(self._whole and not sensed and self._solves(self._whole, state))
        if not self.compiled:
            return super()._tick_in_turn(state)
        state.joints_due, state.jacobians_due, state.corrected = True, False, 1.0
        command = self.command
        command.messages = ()
        command.say(Status.OPTIMAL)
        return command

    def _solves(self, whole: Compiled, state: State) -> bool:
        now = state, state.q, state.v, state.loop_offset, self.command
        if any(a is not b for a, b in zip(now, self._shown, strict=True)):
            self._shown = (None,) * 5
            if not (self._fits(state) and plain_numbers(state.q, state.v, state.loop_offset)):
                return False
            memory = Memory(memory_sizes(self.problem, 2))
            if whole.bind(state, memory, self.command.v) is None:
                return False
            self._shown = now
        try:
            whole.follow(state)
        except KeyboardInterrupt:
            raise
        except BaseException:  # noqa: BLE001 - a signal may be the user's; decide meets it again
            return False
        return bool(whole.engine.resolve(state.t, *self._numbers) == OPTIMAL)


def _compiled(problem: ControlProblem, secondary: tuple[Task, ...]) -> Compiled | None:
    """Tasks, and objectives of all joints in the null space; None where Python must fill some."""
    if why_not(problem):
        return None
    free, start = replace(problem, limits=()), State(problem.chain)
    groups = Group(problem.tasks), Group(secondary)
    whole = Compiled(free, Programs(start), groups, Limits(free, start), 1.0, 0.0)
    return whole if whole.in_closed_form else None
