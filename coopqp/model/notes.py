"""Notes on ticks: which joints, loops, limits or tasks are behind the causes of a command."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from coopqp.base.spec import Array, real, type_name
from coopqp.base.wording import message_of, suppressed
from coopqp.model.state import State

#: Most joints, loops, limits or tasks that a note names; a limit is reached if so much is left
#: of it, in its unit.
MOST_NAMED, REACHED = 3, 1e-6


class Why:
    """Who is behind the causes of a tick, in words that are made when somebody reads them.

    It keeps what it needs of a tick of a :class:`coopqp.controller.Law`, and raises nothing.
    """

    def __init__(self, law: Any, state: State, command: Any) -> None:
        self._law, self._problem, self._chain = law, law.problem, state.chain
        self._names, self._text, self._stale = state.chain.joint_names, "", state.inputs.stale
        self._causes, self._tells_itself = command.causes, bool(command.messages)
        self._scale, self._drift, self._t = command.scale, command.drift, state.t
        arrays = map(np.array, (state.q, state.v, command.v, state.drift))
        self._q, self._before, self._v, self._open = arrays
        memory = state.memory
        self._lacks = [memory[key].copy() for key in ("missed", "missing") if key in memory.sizes]
        names = [cause.name for cause in command.causes]
        if "OVERWRITTEN" in names:
            self._moved_by = state.overwritten_by
        elif "NOT_MEASURED" in names:
            self._reading = _numbers(state.q_measured)

    def leave_out(self, cause: Any) -> None:
        """Say nothing of a cause that somebody else has told."""
        self._causes = tuple(each for each in self._causes if each is not cause)

    def __str__(self) -> str:
        if not self._text:
            with np.errstate(all="ignore"):
                self._text = "; ".join(filter(None, map(self._of, self._causes)))
        return self._text

    def _of(self, cause: Any) -> str:
        """The note of a :class:`coopqp.solver.Status`."""
        note = _NOTES.get(cause.name)
        if note is None or (self._tells_itself and cause.name in TELL_THEMSELVES):
            return ""
        text = ""
        with suppressed():  # margins of a user's limit may raise anything
            text = note(self)
        return str(text or cause.value)

    def _joints(self, sizes: Array, describe: Callable[[int], str]) -> str:
        """The joints of which something is more than zero, the worst first."""
        worst = [int(i) for i in np.argsort(-sizes)[:MOST_NAMED]]
        return ", ".join(describe(i) for i in worst if sizes[i] > 0.0 or i == worst[0])

    def _outside(self) -> str:
        chain, q = self._problem.chain, self._q
        below, above = chain.lower - q, q - chain.upper

        def describe(i: int) -> str:
            side, out = ("below", below[i]) if below[i] > above[i] else ("above", above[i])
            far = f"{out:.2g} {chain.joint_units[i]} {side}" if out > 0.0 else "at the end of"
            return f"{self._names[i]} is {far} its range"

        return self._joints(np.maximum(below, above), describe)

    def _loops(self) -> str:
        chain, loops = self._chain, self._open.reshape(-1, 2, 3)
        apart, turned = np.linalg.norm(loops, axis=2).T
        i = int(np.argmax(apart + turned))
        far = f"{1e3 * apart[i]:.1f} mm, {1e3 * turned[i]:.1f} mrad"
        return f"loop of {chain.arms[i + 1].name} is {far} open"

    def _limits(self, prefix: str = "", first: bool = False) -> str:
        """The limits that are reached after this tick; with ``first`` broken ones that may be."""
        problem, dt = self._problem, self._problem.dt
        v = np.array([self._before, self._v])
        q = self._q + dt * np.array([-self._before, 0.0 * self._v, self._v])
        found = dict[str, float]()
        for limit in problem.limits:
            if first <= limit.sacrificed_first:
                with suppressed():
                    margins = limit.margins(problem.chain, q, v, dt)
                    found |= {row.label: float(left[-1]) for row, left in margins.items()}
        reached = sorted((left, name) for name, left in found.items() if left <= REACHED)
        return prefix * bool(reached) + ", ".join(name for _, name in reached[:MOST_NAMED])

    def _infeasible(self) -> str:
        kept = "on_infeasible: scale would relax tasks, loop correction and accelerations"
        hard = [f" and hard '{task.name}'" for task in self._problem.tasks if task.mode == "hard"]
        clash = f"loops, limits{''.join(hard[:MOST_NAMED])} leave no motion"
        kept += ", mode: scaled may go on more slowly" if hard else ""
        return f"{clash}: {self._loops()}{self._limits(', held back by ')}; {kept}"

    def _tasks(self) -> str:
        tasks, chain = self._problem.tasks, self._problem.chain
        hard = [task for task in tasks if task.mode == "hard"]
        short = hard + [task for task in tasks if task.mode == "scaled"]
        if self._lacks:
            ends = np.cumsum([len(task.rows(chain)) for task in hard])
            rows = [part.any() for part in np.split(self._lacks[0], ends)[: len(hard)]]
            lack = [*rows, *(self._lacks[1] > 0.0)]
            short = [task for task, is_short in zip(short, lack, strict=True) if is_short] or short
        names = ", ".join(f"'{task.name}'" for task in short[:MOST_NAMED])
        how = f"at {100.0 * self._scale:.0f} % of the rate" if self._lacks else "made soft"
        return f"{names} {how}{self._limits(', held back by ')}"

    def _accelerated(self) -> str:
        i = int(np.argmax(np.abs(self._v - self._before)))
        way = f"{self._names[i]} changes by {self._v[i] - self._before[i]:+.2g} in a tick"
        return f"{self._limits(first=True) or way}; slow the references, or raise the limit"

    def _slipping(self) -> str:
        hands = [name for name, grasp in self._problem.chain.grasps.items() if grasp.contact]
        return f"hand of {', '.join(hands)}: more internal force, or slower"

    def _opened(self) -> str:
        budget = self._problem.budget
        allowed = f"{1e3 * budget.loop_position:g} mm, {1e3 * budget.loop_orientation:g} mrad"
        return f"{self._loops()}, of {allowed} of the budget: slow the references, or a smaller dt"

    def _slowed(self) -> str:
        corrected = f"{100.0 * self._drift:.0f} % is corrected"
        return f"{self._loops()}, {corrected}{self._limits(', held back by ')}"

    def _solver(self) -> str:
        if self._law.engine or hasattr(self._law, "solution"):
            return f"solver '{type_name(type(self._problem.solver))}': try another; {self._loops()}"
        return f"the matrices of loops and tasks cannot be decomposed here; {self._loops()}"

    def _numbers(self) -> str:
        bad = ~(np.isfinite(self._q) & np.isfinite(self._before))
        if bad.any():
            joints = self._joints(bad.astype(float), lambda i: self._names[i])
            return f"no finite q or v of {joints}"
        if not math.isfinite(self._t):
            return f"the state's time is {self._t}"
        names = ", ".join(f"'{task.name}'" for task in self._problem.all_tasks[:MOST_NAMED])
        return f"numbers too large at {names}"

    def _strange(self) -> str:
        chain = self._problem.chain
        needs = f"needs {chain.n} of {len(chain.arms)} arms, {', '.join(chain.joint_names[:2])} ..."
        return f"found {len(self._q)} joints of {len(self._chain.arms)} arms, {needs}"

    def _overwritten(self) -> str:
        return self._joints(
            np.abs(self._moved_by), lambda i: f"{self._names[i]} by {self._moved_by[i]:+.2g}"
        )

    def _silent(self) -> str:
        return f"nothing new at {', '.join(self._stale)}; see its sender"

    def _unmeasured(self) -> str:
        reading = self._reading
        if isinstance(reading, str):
            return f"q_measured: {reading}"
        if reading.shape != self._q.shape:
            return f"q_measured: found shape {reading.shape}, needs {self._q.shape}"
        return self._chain.unusable(reading)


def _numbers(found: Any) -> Array | str:
    """A copy of numbers; what is wrong with what is none."""
    try:
        return real(found)
    except ValueError as error:
        return message_of(error) or "needs numbers"


#: What Why has words for; the others are the loop's and the plants', which have their own.
_NOTES: dict[str, Callable[[Why], str]] = {
    **dict.fromkeys(
        ("INACCURATE", "UNBOUNDED", "ITERATION_LIMIT", "SOLVER_ERROR", "SOLVER_FAILED",
         "EQUALITY_RESIDUAL", "BOUND_RESIDUAL"), Why._solver,
    ),
    "RECOVERING": Why._outside, "INFEASIBLE": Why._infeasible, "TASKS_RELAXED": Why._tasks,
    "ACCELERATION_GIVEN_UP": Why._accelerated, "CONTACT_GIVEN_UP": Why._slipping,
    "DRIFT_SLOWED": Why._slowed, "STEP_SHORTENED": Why._opened, "LOOP_BUDGET": Why._opened,
    "NOT_FINITE": Why._numbers, "WRONG_STATE": Why._strange, "OVERWRITTEN": Why._overwritten,
    "NOT_MEASURED": Why._unmeasured, "INPUT_STALE": Why._silent,
}  # fmt: skip
#: Of these the tick itself may have said more.
TELL_THEMSELVES = {"NOT_FINITE", "SOLVER_ERROR", "INACCURATE"}


def note_of(messages: tuple[str | Why, ...]) -> str:
    """The note of a tick's messages; it may be asked for later than the tick."""
    return "; ".join(dict.fromkeys(filter(None, map(str, messages))))
