"""One program of the kernel: levels of tasks and limits, and who fills what of it each tick."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

import numpy as np

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.kernel import native
from coopqp.kernel.flat import flat_model, flat_settings, kept_rows
from coopqp.kernel.levels import Group, Levels
from coopqp.kernel.limits import Limits
from coopqp.model.state import Memory, State
from coopqp.program import Programs
from coopqp.qp_law.equations import ALL_OF_IT
from coopqp.signal import Trajectory


class Outcome(IntEnum):
    """What became of a tick of the kernel; ``core/shared.hpp`` is made from it.

    RELAXED is added to an answer where hard or scaled tasks are not met in full, COMES_BACK where
    joints are on their way back from outside their limits, STANDS where nothing moves.
    """

    BUSY = -1
    OPTIMAL = 0
    INACCURATE = 1  # feasible, but the certificate is short of digits
    INFEASIBLE = 2  # the first level's constraints leave nothing, as is proved
    ITERATIONS = 3  # the active set changed too often
    NOT_FINITE = 4  # the state or the answer has NaN or infinite values
    EQUALITY = 5  # the answer breaks the loop closure
    BOUND = 6  # the answer breaks a limit
    SINGULAR = 7  # loop or hard rows that are independent in general are not so here
    OPENS = 8  # hardly a step leaves the loops within their budget
    OUTSIDE = 9  # a joint is outside its limits; no way back does all of the drift correction
    SHORTENED = 10  # optimal, but for the length of the step
    UNPROVEN = 11  # no answer was found, and no proof that there is none
    CLASHING = 12  # the first level's constraints leave nothing, by less than they may give way
    RELAXED = 16
    STANDS = 32
    COMES_BACK = 64


class Compiled:
    """Tasks and limits that the kernel decides by.

    Args:
        problem: what to control.
        programs: of tasks, from the state from which references set out.
        groups: its tasks, a level each.
        limits: its limits; whoever owns them updates them.
        damping: cost of |v|^2.
        error_damping: share of the damping that rules out any overshoot.
        v: where velocities are written, shape (n,).

    Attributes:
        engine: of the compiled module.
        alone: whether nothing is Python's but the signals that tasks follow.
        rows_in_python: names of tasks and limits that Python fills.
        follows: whether there are such signals, beside the places that inputs give.
        outcome: of the last tick, one of :class:`Outcome`.
    """

    def __init__(
        self,
        problem: ControlProblem,
        programs: Programs,
        groups: Sequence[Group],
        limits: Limits,
        damping: float,
        error_damping: float,
        v: Array,
    ) -> None:
        chain, filled = problem.chain, limits.filled
        self._levels = levels = Levels(groups, programs)
        self.alone = levels.compiled and limits.compiled
        self.rows_in_python = (*levels.in_python, *limits.in_python)
        self.outcome = int(Outcome.BUSY)
        found = native.module()
        assert found is not None  # whoever builds this has asked coopqp.kernel.law.why_not
        self.engine = found.Engine({
            "model": flat_model(chain),
            "kept": kept_rows(chain),
            "levels": levels.flat,
            "primitives": levels.primitives,
            "joint_limits": limits.joints,
            "twist_limits": limits.twist,
            "settings": flat_settings(problem, damping, error_damping, limits.rows),
        })  # fmt: skip
        self.engine.bind_command(v)
        if limits.q_measured is not None:
            self.engine.bind_measured(limits.q_measured)
        if filled is not None:
            self.engine.bind_limits(filled.lb, filled.ub, filled.G, filled.h)
        for task in levels.filled:
            self.engine.bind_rows(*task.bound)
        for primitive, at in levels.followed:
            self.engine.bind_reference(primitive, at.c, at.RT, at.c_dot, at.omega)
        self.follows = bool(levels.followed)
        self._heard: list[tuple[str, Array | None, Array | None]] = []

    def bind(self, state: State, memory: Memory) -> bool:
        """Show it the arrays of a state; False where an input is no place."""
        names = "later pulls", "missed", "missing", "scaled pull", "recovery", "swing", "stopped"
        self.engine.bind_state({**state.written(), **{name: memory[name] for name in names}})
        before, self._heard = self._heard, []
        for _, at in self._levels.arriving:
            for name, value, rate in before:
                if name == at.arrives and value is not None and rate is not None:
                    at.c[:], at.c_dot[:] = value, rate  # where it stays if the input has gone
        for primitive, at in self._levels.arriving:
            value, rate = arrays = _heard(state, at.arrives)
            if value is None or rate is None:
                arrays = at.c, at.c_dot
            elif not (value.shape == rate.shape == at.c.shape and plain_numbers(value, rate)):
                return False
            self.engine.bind_reference(primitive, arrays[0], at.RT, arrays[1], at.omega)
            self._heard.append((at.arrives, value, rate))
        return True

    def heard(
        self, state: State
    ) -> tuple[tuple[str, Trajectory | None, Array | None, Array | None], ...]:
        """Inputs and the arrays of theirs that it was shown."""
        inputs = state.inputs
        return tuple((name, inputs.get(name), value, rate) for name, value, rate in self._heard)

    def tick(self, state: State) -> int:
        """Decide, and return what became of it: INFEASIBLE only where that is proved.

        Where Python fills rows, the state's kinematics and the limits must be up to date.

        Args:
            state: of the tick, bound before.
        """
        all_corrected = state.corrected >= ALL_OF_IT
        if self.alone:
            if self.follows:
                self._levels.follow(state)
            self.outcome = self.engine.tick(state.t, all_corrected)
        else:
            self._levels.update(state)
            self.outcome = self.engine.tick_with_rows(state.t, all_corrected)
        return self.outcome


def plain_numbers(*arrays: Array) -> bool:
    """Whether arrays are as the kernel reads and writes them."""
    return all(a.dtype == np.float64 and a.flags.carray for a in arrays)


def _heard(state: State, name: str) -> tuple[Array | None, Array | None]:
    """Where an input is and how it moves; None where there is none."""
    now = state.inputs.get(name)
    return (None, None) if now is None else (now.value, now.rate)
