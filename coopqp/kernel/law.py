"""A tick by the kernel, or by the plain law where the kernel has no verified answer.

The kernel does what the plain law does when limits leave all of the Baumgarte stabilisation: loops,
limits and the recovery of joints outside them, hard, scaled and soft tasks, any number of levels,
the check and the step verification. What is rarer is written once, in the plain law, which decides
every other tick: stabilisation in part, acceleration limits that are relaxed.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from coopqp.controller import Command, ControlProblem, InternalForceControl, Law
from coopqp.kernel.compiled import Bound, Compiled, Limits, Outcome, plain_numbers
from coopqp.kernel.flat import Group
from coopqp.model.loop_observer import LoopObserver
from coopqp.model.state import Memory, State
from coopqp.qp_law.equations import ALL_OF_IT
from coopqp.qp_law.law import QPLaw, memory_sizes
from coopqp.qp_law.priorities import Order
from coopqp.signal import InputValues
from coopqp.solver import Status
from coopqp.trace import TickBatch

#: Numbers, not members: a tick compares them.
OPTIMAL, SHORTENED = int(Outcome.OPTIMAL), int(Outcome.SHORTENED)
BUSY, UNUSUAL = int(Outcome.BUSY), int(Outcome.UNUSUAL)
INFEASIBLE, OPENS = int(Outcome.INFEASIBLE), int(Outcome.OPENS)
RELAXED, STANDS, COMES_BACK = map(int, (Outcome.RELAXED, Outcome.STANDS, Outcome.COMES_BACK))
ALL_WELL = {
    shortened + relaxed + back: (
        *((Status.STEP_SHORTENED,) if shortened else ()),
        *((Status.TASKS_RELAXED,) if relaxed else ()),
        *((Status.RECOVERING,) if back else ()),
    ) or (Status.OPTIMAL,)
    for shortened in (OPTIMAL, SHORTENED) for relaxed in (0, RELAXED) for back in (0, COMES_BACK)
}  # fmt: skip
#: Of a tick in which nothing may be relaxed.
RESTS = {
    STANDS: (Status.INFEASIBLE,),
    COMES_BACK + STANDS + OPTIMAL: (Status.RECOVERING, Status.INFEASIBLE),
    COMES_BACK + STANDS + SHORTENED: (
        Status.STEP_SHORTENED, Status.RECOVERING, Status.INFEASIBLE
    ),
    COMES_BACK + STANDS + OPENS: (Status.LOOP_BUDGET, Status.RECOVERING, Status.INFEASIBLE),
}  # fmt: skip
IN_A_RUN = {**ALL_WELL, **RESTS}
AT_ONCE = 1000  # ticks of a run without Python
NOTHING = (None,) * 5 + ((),)


class KernelLaw(Law):
    """The QP law, compiled.

    Args:
        damping: cost of |v|^2.
        error_damping: share of the damping that rules out any overshoot.
        squeezer: internal force control by measured forces, if any.

    Attributes:
        whole: the problem, compiled.
    """

    engine = "kernel"

    def __init__(
        self,
        problem: ControlProblem,
        damping: float,
        error_damping: float,
        squeezer: InternalForceControl | None = None,
    ) -> None:
        super().__init__(problem, squeezer=squeezer)
        self._order = order = Order(problem)
        self._limits = limits = Limits(problem, order.start)
        self._settings = limits, damping, error_damping, self.command.v
        first, *later = order.groups
        self.memory_sizes = memory_sizes(problem, 1 + len(later), squeezer)
        whole = [Group(first, order.hard, order.scaled), *(Group(tasks) for tasks in later)]
        self.whole = Compiled(problem, order.programs, whole, *self._settings)
        self.rows_in_python = self.whole.rows_in_python
        self._engine_step = self.whole.engine.step
        self._alone_at_all = self.whole.alone and squeezer is None
        self._runs = self._alone_at_all and not self.whole.follows and limits.q_measured is None
        self._relaxes = problem.on_infeasible == "scale"
        self._stops = problem.on_infeasible == "stop"
        self._dt = problem.dt
        self._exact = bool(order.hard or order.scaled)
        self._asked = False  # whether the kernel has been asked in this tick
        self._shown: tuple[Any, ...] = NOTHING

    @cached_property
    def plain(self) -> QPLaw:
        """The same law in Python, for ticks without an answer of the kernel; built on demand."""
        _, damping, error_damping, _ = self._settings
        return QPLaw(self.problem, damping, error_damping, self.squeezer, self._order)

    def prepare(self) -> KernelLaw:
        """Build now what only rare ticks need, so that none is slow; returns itself."""
        self.plain.prepare()
        return self

    def tick(self, state: State) -> Command:
        """The command for the next dt; by the kernel alone where possible."""
        self._asked = False
        if self._alone(state) and not self._stopped[0]:
            self._asked = True
            if self._decided_alone(state):
                state.jacobians_due = True
                state.corrected = 1.0
                if self.whole.outcome or state.inputs.stale or state.inputs.refused:
                    return self._told(state, self.command, [])
                return self.command
        return super().tick(state)

    def decide(self, state: State) -> Command:
        """Fill Python's rows and let the kernel decide; the plain law where it has no answer."""
        self.compiled = False
        if not self._asked and self._ready(state):
            if self._stopped[0]:
                self.command.v[:] = 0.0
                self._rests(STANDS)
                return self.command
            self._limits.update(state)
            if self._decides(state):
                return self.command
        with np.errstate(all="ignore"):
            other, command = self.plain.decide(state), self.command
        command.v[:] = other.v
        command.scale, command.drift = other.scale, other.drift
        command.say(*other.causes)
        return command

    def _decide(self, state: State) -> Command:
        """Without Python's rows there is nothing that numpy could warn of."""
        return self.decide(state) if self._alone_at_all else super()._decide(state)

    def _decided_alone(self, state: State) -> bool:
        """The same where a signal may raise; :meth:`decide` then handles the exception."""
        try:
            return self._decides(state, None if state.q_measured is None else self.observer)
        except KeyboardInterrupt:
            raise
        except BaseException:  # noqa: BLE001 - code of plug-ins may raise anything
            self._asked = False
            return False

    def _decides(self, state: State, observer: LoopObserver | None = None) -> bool:
        """Whether the kernel has an answer, which is the command then."""
        self.compiled, whole = False, self.whole
        outcome = whole.tick(state, observer)
        if outcome in ALL_WELL:
            self._say(ALL_WELL[outcome])
            self.command.scale = self.whole.engine.scale() if self._exact else 1.0
            return True
        if outcome == INFEASIBLE and not self._relaxes and self._rests(whole.engine.rest()):
            self._missed[:] = self._missing[:] = 0.0
            return True
        if observer and outcome != BUSY:
            whole.engine.forget_measured()
            self._asked = outcome != UNUSUAL
        return False

    def step(self, state: State) -> Command:
        """A tick and state.advance in one; by the kernel alone where possible."""
        inputs = state.inputs
        seen, q, v, gap, memory, bound = self._shown
        # As _alone and _ready, without their calls, which are 3 % of a tick.
        if (
            state is seen
            and state.q is q
            and state.v is v
            and state.gap is gap
            and state.memory is memory
            and state.q_measured is None
            and state.corrected >= ALL_OF_IT
            and self._runs
            and not (inputs.stale or inputs.refused)
        ):
            if bound and _others(inputs, bound):
                return super().step(state)
            outcome = self._engine_step(state.t)
            if outcome in ALL_WELL:
                state.t += self._dt
                state.jacobians_due = True
                state.corrected = 1.0
                command, self.compiled = self.command, True
                command.drift = command.scale = 1.0
                command.causes, command.told = ALL_WELL[outcome], ()
                if self._exact:
                    command.scale = self.whole.engine.scale()
                return self.with_why(state, command) if outcome else command
        return super().step(state)

    def _run_all(self, state: State, found: TickBatch) -> None:
        """Without the GIL, bit-equal to tick by tick.

        Where the kernel has no answer the plain law decides the tick, and the kernel goes on. Where
        Python fills rows, tasks follow signals, or joints are measured, each is a :meth:`tick`.
        """
        done, ticks = 0, len(found.v)
        while done < ticks:
            inputs = state.inputs
            outside = inputs.stale or inputs.refused or state.q_measured is not None
            if self._runs and not outside and self._alone(state):
                rest = min(ticks - done, AT_ONCE)  # in between signals are heard
                made = self._run(state, found, done, rest)
                done += made
                if made == rest:
                    continue
            if done < ticks:
                self._keep(state, found, done)
                done += 1

    def _run(self, state: State, found: TickBatch, done: int, ticks: int) -> int:
        """Number of ticks that the kernel has done in one go."""
        outcome, whole = np.zeros(ticks, np.uint8), state.corrected >= ALL_OF_IT
        room = found.q[done:], found.v[done:], outcome, found.scale[done:]
        remembered = state.memory.numbers, found.memory[done:]
        made: int = max(self.whole.engine.run(state.t, *room, *remembered, self._stops, whole), 0)
        found.causes[done : done + made] = map(IN_A_RUN.__getitem__, outcome[:made].tolist())
        for _ in range(made):
            state.t += self.problem.dt  # as tick by tick, to the last digit
        if made:
            found.compiled[done : done + made] = True
            state.jacobians_due = True
            state.corrected = 1.0
        return made

    def _say(self, causes: tuple[Status, ...]) -> None:
        self.compiled = True
        self.command.drift = 1.0
        self.command.causes, self.command.told = causes, ()

    def _rests(self, outcome: int) -> bool:
        """Whether the engine's answer for an infeasible tick, at rest or recovering, is usable."""
        if outcome not in RESTS:
            return False
        self._say(RESTS[outcome])
        self.command.scale = 0.0 if self._exact else 1.0
        self._stopped[0] = float(self._stops)
        return True

    def _alone(self, state: State) -> bool:
        """Whether the kernel may decide, without Python's rows or forces."""
        if self.squeezer or not self._alone_at_all:
            return False
        if state.q_measured is not None and not self.whole.measures(state, self.observer):
            return False
        return self._ready(state)

    def _ready(self, state: State) -> bool:
        """Whether the kernel may decide at a state; binds arrays that are new to it."""
        seen, q, v, gap, memory, bound = self._shown
        if (
            state is seen
            and state.q is q
            and state.v is v
            and state.gap is gap
            and state.memory is memory
            and not (bound and _others(state.inputs, bound))
        ):
            return True
        return self._shows(state)

    def _shows(self, state: State) -> bool:
        """Bind the arrays of a state; whether the kernel may decide at them."""
        memory = state.memory
        if not self._fits(state) or not plain_numbers(state.q, state.v, state.gap):
            return False
        if memory.sizes != self.memory_sizes:
            state.memory = memory = Memory(self.memory_sizes)
        self._shown = NOTHING
        bound = self.whole.bind(state, memory)
        if bound is None:
            return False
        self._shown = (state, state.q, state.v, state.gap, memory, bound)
        self._stopped = memory["stopped"]
        self._missed, self._missing = memory["missed"], memory["missing"]
        return True


def _others(inputs: InputValues, bound: Sequence[Bound]) -> bool:
    """Whether inputs have other arrays than those bound, :meth:`Compiled.bind`."""
    for name, trajectory, value, rate in bound:
        now = inputs.get(name)
        if now is not trajectory or (now and (now.value is not value or now.rate is not rate)):
            return True
    return False
