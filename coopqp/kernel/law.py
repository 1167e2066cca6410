"""A tick by the kernel, or by the plain law where the kernel has no verified answer.

The kernel does what the plain law does when limits leave all of the Baumgarte stabilisation: loops,
limits and the recovery of joints outside them, hard, scaled and soft tasks, any number of levels,
the check and the step verification. What is rarer is written once, in the plain law, which decides
every other tick: stabilisation in part, acceleration limits that are relaxed.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from coopqp.base.spec import Array
from coopqp.controller import Command, ControlProblem, InternalForceControl, Law
from coopqp.kernel.compiled import Compiled, Limits, Outcome, plain_numbers
from coopqp.kernel.flat import Group
from coopqp.model.loop_observer import LoopObserver
from coopqp.model.state import Memory, State
from coopqp.qp_law.equations import ALL_OF_IT
from coopqp.qp_law.law import QPLaw, memory_sizes
from coopqp.qp_law.priorities import Order
from coopqp.solver import Status
from coopqp.task import Programs
from coopqp.trace import TickBatch

#: Numbers, not members: a tick compares them.
OPTIMAL, SHORTENED = int(Outcome.OPTIMAL), int(Outcome.SHORTENED)
BUSY, UNUSUAL = int(Outcome.BUSY), int(Outcome.UNUSUAL)
INFEASIBLE, OPENS = int(Outcome.INFEASIBLE), int(Outcome.OPENS)
RELAXED, STANDS = int(Outcome.RELAXED), int(Outcome.STANDS)
COMES_BACK, DOUBTFUL = int(Outcome.COMES_BACK), int(Outcome.DOUBTFUL)
ALL_WELL = {
    shortened + relaxed + back + doubtful: (
        *((Status.STEP_SHORTENED,) if shortened else ()),
        *((Status.TASKS_RELAXED,) if relaxed else ()),
        *((Status.RECOVERING,) if back and not relaxed else ()),
        *((Status.INACCURATE,) if doubtful else ()),
        *((Status.RECOVERING,) if back and relaxed else ()),
    ) or (Status.OPTIMAL,)
    for shortened in (OPTIMAL, SHORTENED) for relaxed in (0, RELAXED) for back in (0, COMES_BACK)
    for doubtful in (0, DOUBTFUL)
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
#: Attributes of a state whose objects the kernel is bound to.
BOUND_TO = "q", "v", "loop_offset", "observer_state", "memory", "inputs"


class KernelLaw(Law):
    """The QP law, compiled; ``whole`` is the problem.

    ``damping`` is the cost of |v|^2, ``error_damping`` the share of it that rules out any
    overshoot.
    """

    engine = "kernel"
    outcomes = tuple(IN_A_RUN.get(outcome, ()) for outcome in range(1 + max(IN_A_RUN)))

    def __init__(
        self,
        problem: ControlProblem,
        damping: float,
        error_damping: float,
        force_control: InternalForceControl | None = None,
    ) -> None:
        super().__init__(problem, force_control=force_control)
        self._order = order = Order(problem)
        self._limits = limits = Limits(problem, order.start)
        self._settings = limits, damping, error_damping
        first, *later = order.groups
        self.memory_sizes = memory_sizes(problem, 1 + len(later), force_control)
        whole = [Group(first, order.hard, order.scaled), *(Group(tasks) for tasks in later)]
        self.whole = Compiled(problem, Programs(order.start), whole, *self._settings)
        self.rows_in_python = self.whole.rows_in_python
        self._steps = self.whole.alone and force_control is None and limits.q_measured is None
        self._runs = self._steps and not self.whole.follows
        self._relaxes = problem.on_infeasible == "scale"
        self._stops = problem.on_infeasible == "stop"
        self._exact = bool(order.hard or order.scaled)
        # To take turns is 5 % of a tick; where the engine keeps the GIL it steps this or nothing.
        alone = self._runs and not self.whole.engine.unlocks()
        self._stepper = self.whole.engine if alone else None
        if KernelLaw.step is Law.step:  # which then is compiled, for what is not rare
            self.whole.engine.give_step(KernelLaw)
        self._asked = False  # whether the kernel has been asked in this tick
        self._raised: BaseException | None = None  # by code of plug-ins meanwhile
        self._raised_in_step: BaseException | None = None  # for the tick that says it

    @cached_property
    def plain(self) -> QPLaw:
        """The same law in Python, for ticks without an answer of the kernel; built on demand."""
        _, damping, error_damping = self._settings
        return QPLaw(self.problem, damping, error_damping, self.force_control, self._order)

    def prepare(self) -> KernelLaw:
        """Build now what only rare ticks need, so that none is slow; returns itself."""
        self.plain.prepare()
        return self

    def _tick_in_turn(self, state: State) -> Command:
        """Without pinocchio where possible."""
        self._asked, self._raised, self._raised_in_step = False, self._raised_in_step, None
        if not self._raised and self._alone(state) and not self._stopped[0]:
            self._asked = True
            if self._decided_alone(state):
                state.jacobians_due = self.whole.alone
                state.corrected = 1.0
                if self.whole.outcome or state.inputs.stale or state.inputs.refused:
                    return self._with_faults(state, self.command, [])
                return self.command
        return super()._tick_in_turn(state)

    def decide(self, state: State) -> Command:
        """Fill Python's rows and let the kernel decide; the plain law where it has no answer."""
        self.compiled = False
        if self._raised:
            raise self._raised
        if not self._asked and self._ready(state):
            if self._stopped[0]:
                self.command.v[:] = 0.0
                self._rests(STANDS)
                return self.command
            if self._decides(state):
                return self.command
        with np.errstate(all="ignore"):
            other, command = self.plain.decide(state), self.command
        command.v[:] = other.v
        command.scale, command.drift = other.scale, other.drift
        command.say(*other.causes)
        return command

    def _decide_quietly(self, state: State) -> Command:
        """Whatever of a tick is Python's looks after numpy's warnings itself."""
        return self.decide(state)

    def _decided_alone(self, state: State) -> bool:
        """The same where tasks may raise; :meth:`decide` then handles the exception."""
        try:
            return self._decides(state, None if state.q_measured is None else self.observer)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 - code of plug-ins may raise anything
            self._raised = error
            return False

    def _decides(self, state: State, observer: LoopObserver | None = None) -> bool:
        """Whether the kernel has an answer, which is the command then."""
        self.compiled, whole = False, self.whole
        outcome = whole.tick(state, observer)
        if outcome in ALL_WELL:
            self._say(ALL_WELL[outcome])
            self.command.scale = self.whole.engine.scale()
            self.rows_us = self.whole.rows_us
            return True
        if outcome == INFEASIBLE and not self._relaxes and self._rests(whole.engine.rest()):
            self._missed[:] = self._missing[:] = 0.0
            return True
        if observer and outcome != BUSY:
            whole.engine.forget_measured()
            self._asked = outcome != UNUSUAL
        return False

    def _step_in_turn(self, state: State) -> Command:
        """A step of a law whose engine does not step alone, or lets go of the GIL meanwhile."""
        with self._turn:
            outcome = BUSY
            if self._steps:
                try:
                    self.whole.follow(state)
                except KeyboardInterrupt:
                    raise
                except BaseException as error:  # noqa: BLE001 - code of plug-ins may raise anything
                    self._raised_in_step = error
                else:
                    outcome = self.whole.engine.step(state)
            return self._stepped(state, outcome)

    def _stepped(self, state: State, outcome: int) -> Command:
        """The command of a step of the engine, which has said all that is so of an optimal one."""
        if outcome not in ALL_WELL:
            return Law.step(self, state)
        self.compiled, command = True, self.command
        if outcome == OPTIMAL:
            return command
        command.causes = ALL_WELL[outcome]
        return self.with_why(state, command)

    def run_starts(
        self, starts: Array, q: Array, v: Array, outcomes: NDArray[np.uint8]
    ) -> NDArray[np.int32]:
        """Without the GIL, bit-equal to :meth:`run`."""
        with self._turn:
            state, done = self.start(), np.full(len(starts), -1, np.int32)
            self._serve(state)
            if self._runs and self._alone(state):
                into = q, v, outcomes, state.memory.numbers, done
                self.whole.engine.run_starts(state.t, starts, *into, self._stops)
            return done

    def _run_all(self, state: State, found: TickBatch) -> None:
        """Without the GIL, bit-equal to ticks; the plain law where the kernel has no answer."""
        done, ticks = 0, len(found.v)
        while done < ticks:
            outside = state.inputs.stale or state.inputs.refused or state.q_measured is not None
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
        self.command.causes, self.command.messages = causes, ()

    def _rests(self, outcome: int) -> bool:
        """Whether the engine's answer for an infeasible tick, at rest or recovering, is usable."""
        if outcome not in RESTS:
            return False
        self._say(RESTS[outcome])
        self.command.scale = 0.0 if self._exact else 1.0
        self._stopped[0] = float(self._stops)
        return True

    def _alone(self, state: State) -> bool:
        """Whether the kernel may decide: no forces are measured, and no joints beside own rows."""
        if self.force_control:
            return False
        whole = self.whole
        reads = state.q_measured is None or (whole.alone and whole.measures(state, self.observer))
        return reads and self._ready(state)

    def _ready(self, state: State) -> bool:
        """Whether the kernel may decide at a state; binds arrays that are new to it."""
        return self.whole.engine.is_bound(state) or self._shows(state)

    def _serve(self, state: State) -> None:
        if state is not self._served:
            self.whole.engine.let_go()
        super()._serve(state)

    def _shows(self, state: State) -> bool:
        """Bind the arrays of a state; whether the kernel may decide at them."""
        memory, numbers = state.memory, (state.q, state.v, state.loop_offset, state.observer_state)
        if not (self._fits(state) and plain_numbers(*numbers)):
            return False
        if memory.sizes != self.memory_sizes:
            state.memory = memory = Memory(self.memory_sizes)
        engine, own, sent = self.whole.engine, vars(state), vars(state.inputs)
        engine.let_go()
        arriving = self.whole.bind(state, memory, self.command.v)
        if arriving is None:
            return False
        same = [*((own, name, own[name]) for name in BOUND_TO), *arriving]
        usual = [(own, "q_measured", None), (sent, "stale", ()), (sent, "refused", ())]
        optimal = {"causes": ALL_WELL[OPTIMAL], "messages": (), "drift": 1.0, "scale": 1.0}
        said = [(vars(self.command), *pair) for pair in optimal.items()]
        engine.bind_owner(state, self.command, same, usual, said)
        self._stopped = memory["stopped"]
        self._missed, self._missing = memory["missed"], memory["missing"]
        return True
