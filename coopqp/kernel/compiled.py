"""One program of the kernel: levels of tasks and limits, and who fills what of it each tick."""

import time
from collections.abc import Sequence
from enum import IntEnum
from typing import Any

import numpy as np

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.kernel import native
from coopqp.kernel.flat import (
    Flat,
    Group,
    Levels,
    flat_distances,
    flat_joint_limit,
    flat_model,
    flat_settings,
    flat_twist_limit,
    kept_rows,
)
from coopqp.limit import Bounded, DistanceBounds, JointBounds, TwistBounds
from coopqp.model.loop_observer import LoopObserver
from coopqp.model.state import Memory, State
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.equations import ALL_OF_IT
from coopqp.signal import InputValues
from coopqp.task import Programs


class Limits:
    """The limits of a problem: those that the kernel knows as numbers, and those Python fills.

    A limit that Python fills may have rows beside the kernel's. One without rows may depend on the
    bounds that the others left; then Python fills all of them.

    Attributes:
        joints: bounds on joints as numbers, in the order in which they tighten.
        twist: rows on the object's twist as numbers; they come first.
        filled: the others, if there are any; their rows come after these.
        rows: their number.
        distances: pairs of bodies as numbers; as many rows as are needed come last.
        q_measured: shape (n,), NaN where nothing is measured; None where no limit reads it.
    """

    def __init__(self, problem: ControlProblem, start: State) -> None:
        chain, dt, limits = problem.chain, problem.dt, problem.limits
        programs = [limit.program(chain, dt) for limit in limits]
        known = list(zip(limits, programs, strict=True))
        if any(program is None and not limit.rows(chain) for limit, program in known):
            known = [(limit, None) for limit in limits]
        self.joints: list[Flat] = []
        self.twist: list[Flat] = []
        self.distances: list[Flat] = []
        self.filled: Bounds | None = None
        self.q_measured: Array | None = None
        self.rows = 0
        for _, program in known:
            if isinstance(program, JointBounds):
                self.joints.append(flat_joint_limit(program))
                if program.of is Bounded.LEAD:
                    self.q_measured = np.full(chain.n, np.nan)
            elif isinstance(program, TwistBounds):
                self.twist.append(flat_twist_limit(program, self.rows))
                self.rows += program.rows
            elif isinstance(program, DistanceBounds):
                self.distances.append(flat_distances(chain, program))
        if any(program is None for _, program in known):
            # With constant bounds on v, which say how far limits in space must look ahead.
            filled = [limit for limit, program in known if program is None or limit.constant]
            self.filled = Bounds(filled, start, dt)
            self.rows += len(self.filled.rows)

    @property
    def in_python(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(x.owner for x in (self.filled.rows if self.filled else ())))

    def update(self, state: State) -> None:
        if self.filled is not None:
            self.filled.update(state)
        if self.q_measured is not None:
            self.q_measured[:] = np.nan if (reading := state.reading) is None else reading


class Outcome(IntEnum):
    """What became of a tick of the kernel; ``core/shared.hpp`` is made from it.

    RELAXED is added to an answer where hard or scaled tasks are not met in full, COMES_BACK where
    joints recover from outside their limits, DOUBTFUL where the last digits of what was given move
    it, STANDS where nothing moves.
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
    OUTSIDE = 9  # a joint is outside its limits; no recovery keeps all of the loop stabilisation
    SHORTENED = 10  # optimal, but for the length of the step
    UNPROVEN = 11  # no answer was found, and no proof that there is none
    CLASHING = 12  # the first level's constraints leave nothing, by less than they may give way
    UNUSUAL = 13  # what the joints measured is for Python to judge; nothing is learnt
    RELAXED = 16
    STANDS = 32
    COMES_BACK = 64
    DOUBTFUL = 128


#: A dictionary, a key, and what is there; None where nothing is.
Entry = tuple[dict[str, Any], str, object]


class Compiled:
    """Tasks and limits that the kernel decides by.

    Args:
        programs: of tasks, from the state where their references start.
        groups: tasks, a level each.
        damping: cost of |v|^2.
        error_damping: share of the damping that rules out any overshoot.

    Attributes:
        alone: whether Python only evaluates the signals that tasks follow.
        rows_in_python: names of tasks and limits that Python fills.
        rows_us: what that took in the last tick [us].
        follows: whether there are such signals, other than places that inputs give.
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
    ) -> None:
        chain, filled = problem.chain, limits.filled
        self._limits, self.rows_us = limits, 0.0
        self._levels = levels = Levels(groups, programs)
        self.alone = levels.compiled and filled is None
        self.rows_in_python = (*levels.in_python, *limits.in_python)
        self.outcome = int(Outcome.BUSY)
        found = native.module()
        assert found is not None  # whoever builds this has asked coopqp.kernel.flat.why_not
        self.engine = found.Engine({
            "model": chain.once(flat_model),
            "kept": kept_rows(chain),
            "levels": levels.flat,
            "primitives": levels.primitives,
            "joint_limits": limits.joints,
            "twist_limits": limits.twist,
            "distances": limits.distances,
            "settings": flat_settings(problem, damping, error_damping, limits.rows),
        })  # fmt: skip
        if limits.q_measured is not None:
            self.engine.bind_measured(limits.q_measured)
        if filled is not None:
            self.engine.bind_limits(filled.lb, filled.ub, filled.G, filled.h)
        for block in levels.bound:
            self.engine.bind_rows(*block)
        for primitive, at in levels.followed:
            self.engine.bind_reference(primitive, at.c, at.RT, at.c_dot, at.omega)
        self.follows = bool(levels.followed)
        self._leads = limits if limits.q_measured is not None else None
        self._measured: tuple[Any, ...] = None, None
        self._shape = (chain.n,)
        self._heard: list[tuple[str, Array | None, Array | None]] = []

    def bind(self, state: State, memory: Memory, v: Array) -> list[Entry] | None:
        """Bind the arrays of a state, and v (n,) for the answer; returns where inputs have theirs.

        None where one is no place, or a thread is in the middle of a tick.
        """
        names = "later pulls", "missed", "missing", "scaled pull", "recovery", "chatter", "stopped"
        remembered = {name: memory[name] for name in names}
        remembered |= {"memory": memory.numbers, "command": v}
        if not self.engine.bind_state({**state.written(), **remembered}):
            return None
        before, self._heard = self._heard, []
        for _, at in self._levels.arriving:
            for name, value, rate in before:
                if name == at.arrives and value is not None and rate is not None:
                    at.c[:], at.c_dot[:] = value, rate  # where it stays if the input has gone
        for primitive, at in self._levels.arriving:
            now = state.inputs.get(at.arrives)
            value, rate = arrays = (None, None) if now is None else (now.value, now.rate)
            if value is None or rate is None:
                arrays = at.c, at.c_dot
            elif not (value.shape == rate.shape == at.c.shape and plain_numbers(value, rate)):
                return None
            self.engine.bind_reference(primitive, arrays[0], at.RT, arrays[1], at.omega)
            self._heard.append((at.arrives, value, rate))
        return _arrays_of(state.inputs, self._heard)

    @property
    def in_closed_form(self) -> bool:
        """Whether a first level of rows and a second one of all joints are the kernel's."""
        first, second = self._levels.flat
        apart = not first["joint_weight"] and not len(second["gain"])
        return self.alone and apart and not self._levels.arriving

    def follow(self, state: State) -> None:
        """Move references that follow signals."""
        if self.follows:
            self._levels.follow(state)

    def tick(self, state: State, observer: LoopObserver | None = None) -> int:
        """Decide at a bound state, and return the outcome: INFEASIBLE only where that is proved.

        Where Python fills rows, the state's kinematics become the kernel's. With an observer it
        learns from the measured joints first; ``engine.forget_measured`` takes that back where
        there is no answer.
        """
        engine, all_corrected = self.engine, state.corrected >= ALL_OF_IT
        if not self.alone:
            self.outcome = engine.place(state.t) or self._tick_with_rows(state, all_corrected)
            return self.outcome
        self.follow(state)
        if self._leads:
            self._leads.update(state)
        if observer:
            self.outcome = engine.tick_measured(state.t, all_corrected, observer.begins(state))
        else:
            self.outcome = engine.tick(state.t, all_corrected)
        return self.outcome

    def _tick_with_rows(self, state: State, all_corrected: bool) -> int:
        before = time.perf_counter_ns()
        state.jacobians_due, state.joints_due = False, True
        with np.errstate(all="ignore"):
            self._limits.update(state)
            self._levels.update(state)
        self.rows_us = 1e-3 * (time.perf_counter_ns() - before)
        return int(self.engine.tick_with_rows(state.t, all_corrected))

    def measures(self, state: State, observer: LoopObserver) -> bool:
        """Whether the kernel can read what a state has measured; binds it."""
        reading, seen = self._measured
        if state.q_measured is reading and observer is seen:
            return True
        given: Any = state.q_measured
        if type(observer) is not LoopObserver or type(given) is not np.ndarray:
            return False
        if given.shape != self._shape or not plain_numbers(given):
            return False
        self.engine.bind_reading(given)
        if observer is not seen:
            self.engine.bind_observer(observer.flat())
        self._measured = given, observer
        return True


def _arrays_of(
    inputs: InputValues, heard: Sequence[tuple[str, Array | None, Array | None]]
) -> list[Entry]:
    """Where inputs have the arrays that are heard."""
    found = list[Entry]()
    for name, value, rate in heard:
        now = inputs.get(name)
        found.append((inputs, name, now))
        if now is not None:
            found += (vars(now), "value", value), (vars(now), "rate", rate)
    return found


def plain_numbers(*arrays: Array) -> bool:
    """Whether arrays have the layout that the kernel reads and writes."""
    return all(a.dtype == np.float64 and a.flags.carray for a in arrays)
