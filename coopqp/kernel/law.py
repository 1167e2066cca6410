"""A tick by the kernel, or by the plain law where the kernel has no verified answer.

The kernel does what the plain law does when all is well: the loops, hard and soft tasks, any number
of levels, bounds, inequality rows, the check and the look ahead. What has to be given up when not
everything can hold, the way back of joints that are outside, shortened steps: all that is written
once, in the plain law, which decides every tick that the kernel does not call optimal.
"""

from __future__ import annotations

import numpy as np

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.controller import Command, ControlProblem, Law
from coopqp.errors import InvalidValueError
from coopqp.kernel import native
from coopqp.kernel.flat import flat_model, flat_settings, kept_rows
from coopqp.kernel.levels import Levels
from coopqp.limit import movers
from coopqp.qp_law.law import QPLaw
from coopqp.solver import Status
from coopqp.state import State

OPTIMAL = 0  # what the compiled module calls it
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
        decided: whether the kernel has decided the last tick.
    """

    engine = "kernel"

    def __init__(
        self, problem: ControlProblem, plain: QPLaw, damping: float, error_damping: float
    ) -> None:
        super().__init__(problem)
        self.plain, self.memory_sizes = plain, plain.memory_sizes
        self.decided = False
        self._levels, bounds = Levels(plain), plain.bounds
        found = native.module()
        assert found is not None  # whoever builds this has asked why_not
        self._engine = found.Engine({
            "model": flat_model(problem.chain),
            "kept": kept_rows(problem.chain),
            "levels": self._levels.flat,
            "settings": flat_settings(problem, damping, error_damping, len(bounds.rows)),
        })  # fmt: skip
        self._engine.bind_command(self.command.v)
        self._engine.bind_limits(bounds.lb, bounds.ub, bounds.G, bounds.h)
        for rows in self._levels.filled:
            block = rows.e, rows.J, rows.rate
            self._engine.bind_rows(*block, rows.level, rows.at, rows.joints, rows.weight, rows.gain)
        self._bound: tuple[Array, ...] = ()

    def decide(self, state: State) -> Command:
        """Let the kernel decide; the plain law where it does not."""
        memory = state.memory
        self.decided = False
        if not (memory["stopped"][0] or memory["soft"][0]):
            self._bind(state)
            self.plain.bounds.update(state)
            self._levels.update(state)
            if self._engine.update() == OPTIMAL and self._engine.solve() == OPTIMAL:
                self.decided = True
                command = self.command
                command.scale = command.drift = 1.0
                command.say(Status.OPTIMAL)
                return command
        self._take(self.plain.decide(state))
        return self.command

    def _take(self, other: Command) -> None:
        command = self.command
        command.v[:] = other.v
        command.scale, command.drift = other.scale, other.drift
        command.say(*other.causes)

    def _bind(self, state: State) -> None:
        """Show the kernel a state's arrays, if it has not seen these."""
        memory = state.memory.numbers
        arrays = (state.q, state.v, state.gap, memory)
        if len(self._bound) == len(arrays) and all(
            a is b for a, b in zip(arrays, self._bound, strict=True)
        ):
            return
        self._engine.bind_state(
            state.q, state.v, state.gap, np.zeros(3), np.zeros((3, 3)),
            np.zeros_like(state.loop_error), state.memory["later pulls"], state.memory["pull"],
        )  # fmt: skip
        self._bound = arrays


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
    return _too_large(chain)


def _too_large(chain: ClosedChain) -> str:
    """What of a chain the compiled arrays do not hold."""
    moved = movers(chain, [chain.model.frames[frame].parentJoint for frame in chain.frames])
    shared = moved.sum(axis=0) > 1.0
    first = np.count_nonzero(shared | (moved[0] > 0.0))
    others = (moved[1 : chain.holding] * ~shared).sum(axis=1)
    if first + others.max(initial=0.0) > MOST_LANES and chain.holding > 1:
        return f"two arms have more than {MOST_LANES} joints together"
    if np.count_nonzero(shared) > MOST_SHARED:
        return f"more than {MOST_SHARED} joints move several arms"
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
