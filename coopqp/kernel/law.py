"""A tick by the kernel, or by the plain law where the kernel has no verified answer.

The kernel does what the plain law does when all is well: the loops, hard and soft tasks, any number
of levels, bounds, inequality rows, the check and the look ahead. What has to be given up when not
everything can hold, the way back of joints that are outside, shortened steps: all that is written
once, in the plain law, which decides every tick that the kernel does not call optimal.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.controller import Command, ControlProblem, Law, Ticks
from coopqp.errors import InvalidValueError
from coopqp.kernel import native
from coopqp.kernel.flat import flat_bounds, flat_model, flat_settings, kept_rows
from coopqp.kernel.levels import Levels
from coopqp.limit import movers
from coopqp.memory import Memory
from coopqp.qp_law.law import QPLaw
from coopqp.solver import Status
from coopqp.state import State

OPTIMAL = 0  # what the compiled module calls it
ALL_WELL = (Status.OPTIMAL,)
#: What the compiled arrays hold: joints of two arms, joints that move several arms, loops.
MOST_LANES, MOST_SHARED, MOST_LOOPS = 64, 6, 16


class KernelLaw(Law):
    """The QP law, compiled.

    Args:
        problem: what to control.
        plain: the same law in Python, for ticks that the kernel leaves to it.
        damping: cost of |v|^2.
        error_damping: share of the damping that rules out any overshoot.

    Attributes:
        plain: as given.
    """

    engine = "kernel"

    def __init__(
        self, problem: ControlProblem, plain: QPLaw, damping: float, error_damping: float
    ) -> None:
        super().__init__(problem)
        self.plain, self.memory_sizes = plain, plain.memory_sizes
        chain, bounds = problem.chain, plain.bounds
        self._levels = levels = Levels(plain, State(chain))
        limits = [limit.bounds(chain, problem.dt) for limit in problem.limits]
        of_joints = [flat_bounds(limit) for limit in limits if limit is not None]
        self._fills_limits = len(of_joints) < len(limits)
        self._follows = bool(levels.followed)
        self._all_compiled = not (self._fills_limits or levels.filled)
        found = native.module()
        assert found is not None  # whoever builds this has asked why_not
        self._engine = found.Engine({
            "model": flat_model(chain),
            "kept": kept_rows(chain),
            "levels": levels.flat,
            "primitives": levels.primitives,
            "bounds": of_joints,
            "settings": flat_settings(problem, damping, error_damping, len(bounds.rows)),
        })  # fmt: skip
        self._engine.bind_command(self.command.v)
        if self._fills_limits:
            self._engine.bind_limits(bounds.lb, bounds.ub, bounds.G, bounds.h)
        for task in levels.filled:
            self._engine.bind_rows(*task.bound)
        for primitive, at in levels.followed:
            self._engine.bind_reference(primitive, at.c, at.RT, at.c_dot, at.omega)
        self._bound: tuple[Any, ...] = ()

    def tick(self, state: State) -> Command:
        """The command for the next dt; without a line of Python between where nothing needs it."""
        if self._alone(state) and self._ready(state) and self._followed(state):
            if self._engine.tick(state.t) == OPTIMAL:
                state.mark_stale()
                state.corrected = 1.0
                return self._optimal()
            self.compiled = False
        return super().tick(state)

    def decide(self, state: State) -> Command:
        """Fill what Python has to, and let the kernel decide; the plain law where it does not."""
        self.compiled = False
        if self._ready(state):
            if self._fills_limits:
                self.plain.bounds.update(state)
            self._levels.update(state)
            if self._engine.tick_with_rows(state.t) == OPTIMAL:
                return self._optimal()
        other, command = self.plain.decide(state), self.command
        command.v[:] = other.v
        command.scale, command.drift = other.scale, other.drift
        command.say(*other.causes)
        return command

    def run(self, state: State, ticks: int) -> Ticks:
        """Many ticks at once, the same as one by one, without the GIL.

        Where the kernel has no answer the plain law decides the tick, and the kernel goes on. Where
        Python fills rows or limits, tasks follow signals, or joints are measured, every tick is one
        of :meth:`tick`.
        """
        found = Ticks.room(ticks, self.problem.chain.n)
        done = 0
        while done < ticks:
            if not self._follows and self._alone(state) and self._ready(state):
                done += self._run(state, found, done)
            if done < ticks:
                self._step(state, found, done)
                done += 1
        found.q[ticks] = state.q
        state.update()
        return found

    def _run(self, state: State, found: Ticks, done: int) -> int:
        """As many as the kernel does in one go; how many."""
        rest, dt = len(found.v) - done, self.problem.dt
        q, v = found.q[done:], found.v[done:]
        made: int = max(self._engine.run(state.t, q, v, state.q, state.v, rest), 0)
        for _ in range(made):
            state.t += dt  # as tick by tick, to the last digit
        found.compiled[done : done + made] = True
        state.mark_stale()
        return made

    def _optimal(self) -> Command:
        self.compiled = True
        command = self.command
        command.scale = command.drift = 1.0
        command.causes, command.note = ALL_WELL, ""
        return command

    def _alone(self, state: State) -> bool:
        """Whether nothing of a tick is Python's: no rows, no sensors, no inputs to complain of."""
        inputs = state.inputs
        measured = state.q_measured is not None
        return self._all_compiled and not (measured or inputs.stale or inputs.refused)

    def _followed(self, state: State) -> bool:
        """Move what signals move; False where one raises, which :meth:`decide` then meets."""
        if self._follows:
            try:
                self._levels.follow(state)
            except KeyboardInterrupt:
                raise
            except BaseException:  # noqa: BLE001 - code of plug-ins may raise anything
                return False
        return True

    def _ready(self, state: State) -> bool:
        """Whether the kernel may decide at a state; it is shown arrays that it has not seen."""
        memory, bound = state.memory, self._bound
        if (
            len(bound) == 5
            and state is bound[0]
            and state.q is bound[1]
            and state.v is bound[2]
            and state.gap is bound[3]
            and memory is bound[4]
        ):
            return not self._waits()
        if not self._fits(state) or not _plain_numbers(state.q, state.v, state.gap):
            return False
        if memory.sizes != self.memory_sizes:
            state.memory = memory = Memory(self.memory_sizes)
        self._engine.bind_state(
            state.q, state.v, state.gap, *state.written(), memory["later pulls"], memory["pull"]
        )
        self._bound = (state, state.q, state.v, state.gap, memory)
        self._stopped, self._soft = memory["stopped"], memory["soft"]
        return not self._waits()

    def _waits(self) -> bool:
        """Whether the law stands still, or hard tasks were given up a moment ago."""
        return bool(self._stopped[0] or self._soft[0])


def _plain_numbers(*arrays: Array) -> bool:
    """Whether arrays are as the kernel reads them."""
    return all(a.dtype == np.float64 and a.flags.c_contiguous for a in arrays)


def why_not(problem: ControlProblem) -> str:
    """Why the kernel cannot do a problem; empty where it can."""
    chain = problem.chain
    if native.module() is None:
        return native.MISSING
    if not problem.solver.kernel_instead:
        return "the scenario asks for another solver"
    if any(task.mode == "scaled" for task in problem.tasks):
        return "a task is scaled"
    if chain.loops.varying:
        return "which loop rows depend on others changes with the pose"
    if flat_model(chain) is None:
        return "a joint is neither a hinge nor a slide"
    if chain.n <= len(chain.loops.kept):
        return "the loops leave no motion"
    return _unfit(chain)


def _unfit(chain: ClosedChain) -> str:
    """What of a chain the compiled arrays do not hold, loop by loop."""
    moved = movers(chain, [chain.model.frames[frame].parentJoint for frame in chain.frames])
    shared = moved.sum(axis=0) > 1.0
    first = np.count_nonzero(shared | (moved[0] > 0.0))
    others = (moved[1 : chain.holding] * ~shared).sum(axis=1)
    widest = max(first, 6 + np.count_nonzero(shared)) + others.max(initial=0.0)
    if widest > MOST_LANES and chain.holding > 1:
        return f"two arms have more than {MOST_LANES} joints together"
    if np.count_nonzero(shared) > MOST_SHARED:
        return f"more than {MOST_SHARED} joints move several arms"
    carry, kept = int(first), kept_rows(chain).reshape(-1, 6).sum(axis=1)
    for own, rows in zip(others, kept, strict=True):
        left = int(carry + own - rows)
        if left < 0:
            return "a loop has fewer joints than rows"
        carry = min(left, 6 + int(np.count_nonzero(shared)))
    if chain.holding - 1 > MOST_LOOPS:
        return f"there are more than {MOST_LOOPS} loops"
    return ""


def required(problem: ControlProblem) -> None:
    """Refuse what the kernel cannot do.

    Raises:
        InvalidValueError: with the reason.
    """
    if reason := why_not(problem):
        raise InvalidValueError(f"engine: kernel cannot do this: {reason}; use engine: auto")
