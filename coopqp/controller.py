"""What a controller is: from a state to a command, once a tick."""

from __future__ import annotations

import copy
import math
import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, ClassVar, Literal, Protocol, get_args
from weakref import WeakSet

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, field_validator

from coopqp.base.errors import InvalidValueError, unknown_name
from coopqp.base.spec import Array, finite, overshoot, spec, taken_names, type_name, vector
from coopqp.base.wording import Location, culprit, dotted
from coopqp.limit import Limit, LimitRows
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.loop_observer import LoopObserver, Observer
from coopqp.model.notes import TELL_THEMSELVES, Why, note_of
from coopqp.model.profile import FASTEST
from coopqp.model.state import Memory, State
from coopqp.signal import Signal
from coopqp.solver import Budget, Solver, Status
from coopqp.task import Task, TaskRows, evaluate_all
from coopqp.trace import TickBatch


class InternalForceControl(Protocol):
    """Who decides about the loop offset along one direction, because hands press there."""

    along: Array
    """That direction among all loops, a unit vector, shape (6 L,)."""
    wanted: float
    """The force that they are to press with; NaN before it is known [N]."""
    memory_sizes: Mapping[str, int]
    """What a law must remember for it, see ``State.memory``."""

    note: str
    """A remark on the last tick."""

    def update(self, state: State) -> Status | None:
        """Move the loop offset along it; what is wrong with the force, None if nothing is."""


TELL_APART = "add 'name:' to tell them apart"

#: Ticks of one run; a day at 100 Hz.
MAX_TICKS = 10_000_000

OnInfeasible = Literal["scale", "hold", "stop"]

Features = frozenset[
    Literal["limits", "modes", "priorities", "secondary", "on_infeasible", "forces"]
]
"""Parts of a problem that a controller reads; what it does not name has no effect on it."""

NO_FEATURES: Features = frozenset()
ALL_FEATURES: Features = frozenset({"limits", "modes", "priorities", "secondary", "on_infeasible"})


@dataclass(frozen=True, kw_only=True)
class ControlProblem:
    """What a controller is built for; InvalidValueError with everything that cannot be asked."""

    chain: ClosedChain
    tasks: Sequence[Task]
    solver: Solver
    #: Tasks that ask for wrenches of the hands, for controllers that support forces.
    wrenches: Sequence[Task] = ()
    secondary: Sequence[Task] = ()  #: Objectives in the null space of the tasks.
    limits: Sequence[Limit] = ()  #: Hard bounds, for controllers that support them.
    dt: float = 0.01  #: Control period [s].
    #: Gain of the Baumgarte stabilisation, J_c v = -kappa e [1/s]; 1/dt when omitted, which removes
    #: the linearisation error of each step in the next, and 10 for torques; 0 is the paper's law.
    kappa: float = math.inf
    budget: Budget = field(default_factory=Budget)  #: Tolerances of a usable solution.
    #: What to do in a tick in which not everything can hold: "scale" meets hard and scaled tasks as
    #: nearly as possible, and where loops and limits alone clash corrects drift in part, then
    #: relaxes acceleration limits; "hold" stands still for the tick, but for joints outside their
    #: limits, which recover; "stop" from the next on.
    on_infeasible: OnInfeasible = "scale"
    #: Of the loop-closure offset, where joints are measured.
    observer: Observer = field(default_factory=Observer)

    @property
    def all_tasks(self) -> tuple[Task, ...]:
        """Tasks, wrenches and secondary objectives."""
        return (*self.tasks, *self.wrenches, *self.secondary)

    def __post_init__(self) -> None:
        if self.kappa == math.inf and self.dt > 0.0:
            object.__setattr__(self, "kappa", 1.0 / self.dt)
        tasks = (*self.tasks, *self.wrenches)
        found = list(problem_faults(self.dt, self.kappa, tasks, self.secondary))
        if any(task.way and task.way.kind == FASTEST for task in tasks):
            words = "fastest is found when a file is read; call coopqp.with_fastest_profiles"
            found.append((("profile",), f"{words} for other scenarios"))
        if self.on_infeasible not in get_args(OnInfeasible):
            known = unknown_name("choice", str(self.on_infeasible), get_args(OnInfeasible))
            found.append((("on_infeasible",), known))
        if found:
            lines = (f"{dotted(place)}: {message}" for place, message in found)
            raise InvalidValueError("\n".join(lines))


def not_finite(problem: ControlProblem, state: State) -> str:
    """Which tasks and limits, bound anew, give NaN or infinite values at a state; empty if none."""
    looks = [(f"task '{t.name}'", partial(_finite_rows, t)) for t in problem.all_tasks]
    looks += [
        (f"limit '{type_name(type(k))}'", partial(_usable_rows, k, problem.dt))
        for k in problem.limits
    ]
    found = []
    for name, look in looks:
        with suppress(Exception):  # code of plug-ins may raise anything; not asked here
            if bad := [key for key, good in look(state).items() if not good.all()]:
                found.append(f"{name} gives NaN or infinite values in {', '.join(bad)}")
    return "; ".join(found)


def _finite_rows(task: Task, state: State) -> dict[str, NDArray[np.bool_]]:
    chain, start = state.chain, State(state.chain)
    start.inputs = state.inputs.now()
    k, columns = len(task.rows(chain)), 6 * chain.holding if task.of_forces else chain.n
    J = np.eye(columns) if task.joint_space else np.zeros((k, columns))
    rows = TaskRows(np.zeros(k), J, np.zeros(k))
    evaluate_all([(task.bind(start), rows)], state)
    return {key: np.isfinite(getattr(rows, key)) for key in ("e", "J", "rate")}


def _usable_rows(limit: Limit, dt: float, state: State) -> dict[str, NDArray[np.bool_]]:
    """Bounds and h may be infinite on the side that is free."""
    chain, p, n = state.chain, len(limit.rows(state.chain)), state.chain.n
    free = np.full(n, -np.inf), np.full(n, np.inf)
    rows = LimitRows(*free, np.zeros((p, n)), np.full(p, np.inf))
    evaluate_all([(limit.bind(chain, dt), rows)], state)
    h, G = rows.h > -np.inf, np.isfinite(rows.G)
    return {"lb": rows.lb < np.inf, "ub": rows.ub > -np.inf, "G": G, "h": h}


def problem_faults(
    dt: float, kappa: float, tasks: Sequence[Task], secondary: Sequence[Task]
) -> Iterator[tuple[Location, str]]:
    """What no controller can be asked for: places such as tasks[0], and what is wrong there."""
    if wrong := period_fault(dt):
        yield ("dt",), wrong
        return
    if not kappa >= 0.0:
        yield ("kappa",), f"found {kappa}; needs at least 0"
    if kappa * dt > 1.0 + 1e-9:
        yield ("kappa",), f"found {kappa}; needs at most 1/dt = {1.0 / dt:g} 1/s"
    yield from _task_faults("tasks", tasks, dt)
    yield from _task_faults("secondary", secondary, dt)
    for i, task in enumerate(secondary):
        if task.of_forces or task.impedance is not None:
            yield ("secondary", i), f"'{task.name}' asks for a force; put it under tasks"
        if task.mode != "soft":
            words = f"'{task.name}' is {task.mode}, secondary objectives are soft"
            yield ("secondary", i), f"{words}; put it under tasks"


def period_fault(dt: float) -> str:
    """What is wrong with a control period [s]; empty if nothing is."""
    return "" if 0.0 < dt < np.inf else f"found {dt} s; needs a finite time, more than 0"


def _task_faults(key: str, tasks: Sequence[Task], dt: float) -> Iterator[tuple[Location, str]]:
    for i, taken in taken_names([task.name for task in tasks]):
        yield (key, i), f"{taken}; {TELL_APART}"
    for i, task in enumerate(tasks):
        if wrong := overshoot(task.gain, dt):
            yield (key, i), f"'{task.name}': {wrong}"


class Command:
    """What a controller wants, in preallocated arrays.

    Attributes:
        v: joint velocity for the next dt, shape (n,) [rad/s, m/s]; zero when torques are commanded.
        tau: joint torques for the next dt, shape (n,) [N m]; None when velocities are commanded.
        causes: status of the tick, and what else was relaxed in it. Where the first is not usable,
            v = 0, or torques only hold.
        scale: least share of its rate at which a hard or scaled task runs; 1 where there are none.
        drift: share of the Baumgarte correction that is done.
        messages: of the note: texts, such as what a task raised, and a :class:`Why`.
        grippers: of the loop for robots: "open" or "close" by arm; those that hold are closed.
    """

    def __init__(self, n: int, *, torques: bool = False) -> None:
        self.v = np.zeros(n)
        self.tau = np.zeros(n) if torques else None
        self.causes: tuple[Status, ...] = (Status.OPTIMAL,)
        self.scale = self.drift = 1.0
        self.messages: tuple[str | Why, ...] = ()
        self.grippers: Mapping[str, str] = {}

    @property
    def note(self) -> str:
        """Which joints, loops, limits, tasks or inputs are behind the causes; empty if OPTIMAL."""
        return note_of(self.messages)

    @note.setter
    def note(self, text: str) -> None:
        self.messages = (text,) if text else ()

    @property
    def remark(self) -> str:
        """The part of the note that is no :class:`Why`, such as what a task raised."""
        return "; ".join(part for part in self.messages if isinstance(part, str))

    @property
    def status(self) -> Status:
        """The first of the causes."""
        return self.causes[0]

    def say(self, *causes: Status) -> None:
        """Set all that is true of this tick, the gravest first."""
        self.causes = causes

    def add(self, status: Status, *messages: str) -> None:
        """Add what else is true of this tick, after what is graver."""
        self.causes = *(c for c in self.causes if c is not Status.OPTIMAL), status
        self.messages = (*self.messages, *messages)

    def __repr__(self) -> str:
        what = f"v={self.v}" if self.tau is None else f"tau={self.tau}"
        return f"Command({self.status.name}, {what})"

    def copy(self) -> Command:
        other = copy.copy(self)
        other.v, other.tau = self.v.copy(), None if self.tau is None else self.tau.copy()
        return other


ALL_WELL = (Status.OPTIMAL,)
LAWS: WeakSet[Law] = WeakSet()


def _free_turns() -> None:
    """Threads that were in the middle of a tick do not live on in a forked process."""
    for law in LAWS:
        law._turn = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_free_turns)


class Law(ABC):
    """A controller built for one problem.

    Attributes:
        command: of the last tick.
        compiled: whether the kernel has decided the last tick.
        force_control: internal force control by measured forces; None where there is none.
        observer: of the loop-closure offset, from measured joints.
    """

    rows_in_python: tuple[str, ...] = ()
    """Tasks and limits of which Python fills rows that the kernel decides on."""
    outcomes: ClassVar[Sequence[tuple[Status, ...]]] = ()
    """What indices of :meth:`run_starts` mean."""
    rows_us: float = 0.0
    """What that took in the last tick [us]."""
    engine: ClassVar[str | None] = None
    """What solves its QP: "kernel" or "python"; None for laws without one."""
    memory_sizes: Mapping[str, int] = {}
    """What the law must remember between ticks, and how many numbers; see ``State.memory``."""

    def __init__(
        self,
        problem: ControlProblem,
        *,
        torques: bool = False,
        gives_way: bool = False,
        force_control: InternalForceControl | None = None,
    ) -> None:
        yields = [task.name for task in problem.tasks if task.impedance is not None]
        if yields and not gives_way:
            raise InvalidValueError(
                f"task '{yields[0]}' asks for an impedance, which this controller does not have; "
                "use torque_qp, with plant: rigid_body or plant: mujoco"
            )
        self.problem, self.force_control = problem, force_control
        self.compiled = False
        self.command = Command(problem.chain.n, torques=torques)
        self._served: State | None = None
        self.observer = LoopObserver(problem.chain, problem.dt, problem.observer)
        self._turn = threading.RLock()
        LAWS.add(self)

    def start(
        self,
        q: ArrayLike | None = None,
        *,
        q_measured: ArrayLike | None = None,
        hand_wrench: Array | None = None,
    ) -> State:
        """The first state, at q (n,) or the chain's start, with room for the law's memory.

        ``q_measured`` are measured joint positions, instead of q; the loop error there is taken for
        the model's bias (``State.loop_offset``). ``hand_wrench`` is that of the state.
        """
        state = State(self.problem.chain, q, memory=Memory(self.memory_sizes))
        state.hand_wrench = hand_wrench
        if q_measured is not None:
            n = self.problem.chain.n
            state.q[:] = finite("q_measured", vector("q_measured", q_measured, n))
            state.q_measured = state.q.copy()
            self.observer.begin(state)
        return state

    def tick(self, state: State) -> Command:
        """The command for the next dt, from t, q, v and memory of a state; first its kinematics.

        Threads take turns. The command's arrays are reused in the next tick of the same state.
        """
        with self._turn:
            self._serve(state)
            return self._tick_in_turn(state)

    def _tick_in_turn(self, state: State) -> Command:
        self.command.messages = ()
        if not self._fits(state):
            return self.with_why(state, self.refuse(Status.WRONG_STATE))
        if not math.isfinite(math.hypot(*state.q.tolist(), *state.v.tolist(), state.t)):
            return self.with_why(state, self.refuse(Status.NOT_FINITE))
        if state.memory.sizes != self.memory_sizes:
            state.memory = Memory(self.memory_sizes)
        state.update()
        command, wrong = self._observe_and_decide(state)
        if state.overwritten:
            wrong.append(Status.OVERWRITTEN)
        return self._with_faults(state, command, wrong)

    def _with_faults(self, state: State, command: Command, wrong: list[Status]) -> Command:
        """The command with what was wrong, also of what came from outside."""
        if state.inputs.stale:
            wrong.append(Status.INPUT_STALE)
        if state.inputs.refused:
            wrong.append(Status.INPUT_REFUSED)
        if command.status.name in TELL_THEMSELVES and not command.note:
            with np.errstate(all="ignore"):
                command.note = not_finite(self.problem, state)
        if wrong:
            own = self.force_control.note if self.force_control else "", self.observer.note
            command.messages = tuple(filter(None, (command.note, *own, *state.inputs.refused)))
            command.say(*(c for c in command.causes if c is not Status.OPTIMAL), *wrong)
        state.corrected = command.drift
        return command if command.causes == ALL_WELL else self.with_why(state, command)

    def _serve(self, state: State) -> None:
        """Leave the last command to whoever ticks another state."""
        if state is not self._served:
            self._served = state
            self.command = Command(len(self.command.v), torques=self.command.tau is not None)

    def with_why(self, state: State, command: Command) -> Command:
        """The command of a tick that is not optimal, with who is behind its causes."""
        command.messages = (*command.messages, Why(self, state, command))
        return command

    def run(self, state: State, ticks: int) -> TickBatch:
        """Many ticks on ideal joints, without inputs from outside; ``state`` is written.

        Threads take turns. InvalidValueError: ``ticks`` is no whole number, 0 to ``MAX_TICKS``.
        """
        if type(ticks) is not int or not 0 <= ticks <= MAX_TICKS:
            needs = f"needs a whole number, 0 to {MAX_TICKS}"
            raise InvalidValueError(f"ticks: found {ticks!r}, {needs}")
        with self._turn:
            self._serve(state)
            if state.memory.sizes != self.memory_sizes:
                state.memory = Memory(self.memory_sizes)
            found = TickBatch.empty(ticks, self.problem.chain.n, len(state.memory.numbers))
            self._run_all(state, found)
            found.q[ticks] = state.q
            state.update()
        return found

    def run_starts(
        self, starts: Array, q: Array, v: Array, outcomes: NDArray[np.uint8]
    ) -> NDArray[np.int32]:
        """Motions from starts (M, n), as far as they can be done without Python.

        Written are q, shape (M, T + 1, n), v (M, T, n) and an index of ``outcomes`` a tick (M, T).
        Returns how many ticks of each were done, shape (M,); -1 for those not begun.
        """
        return np.full(len(starts), -1, np.int32)

    def _run_all(self, state: State, found: TickBatch) -> None:
        """All ticks of a run; laws that can do several at once override it."""
        for k in range(len(found.v)):
            self._keep(state, found, k)

    def _keep(self, state: State, found: TickBatch, k: int) -> None:
        """One of them, by the tick: whatever a law has instead has been tried."""
        found.q[k], found.memory[k] = state.q, state.memory.numbers
        command = Law.step(self, state)
        found.v[k], found.causes[k], found.compiled[k] = command.v, command.causes, self.compiled
        found.scale[k] = command.scale
        if command.messages and command.remark:
            found.notes[k] = command.remark

    def step(self, state: State) -> Command:
        """A tick and :meth:`coopqp.model.state.State.advance`: ideal joints for dt."""
        with self._turn:
            command = self.tick(state)
            state.advance(command.v, self.problem.dt)
        return command

    def _observe_and_decide(self, state: State) -> tuple[Command, list[Status]]:
        """What :meth:`decide` says, and what was not measured; to stand still where code raises."""
        wrong, pressed = list[Status](), self.force_control
        try:
            if pressed and (fault := pressed.update(state)):
                wrong.append(fault)
            if not self.observer.update(state, pressed.along if pressed else None):
                wrong.append(Status.NOT_MEASURED)
            if self.observer.at_bound:
                wrong.append(Status.OFFSET_AT_BOUND)
            return self._decide_quietly(state), wrong
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 - code of plug-ins may raise anything
            command = self.refuse(Status.RAISED, culprit(error, self._plugins()))
            self.hold_still(state)
            return command, wrong

    def _decide_quietly(self, state: State) -> Command:
        """Whatever a user has set for numpy, a tick warns nobody."""
        with np.errstate(all="ignore"):
            return self.decide(state)

    def _fits(self, state: State) -> bool:
        n, m = self.problem.chain.n, 6 * (len(self.problem.chain.arms) - 1)
        fit = len(state.loop_offset) == m and len(state.observer_state) == 2 + m
        return fit and state.q.shape == state.v.shape == (n,)

    def refuse(self, why: Status, note: str = "") -> Command:
        """Stand still where nothing can be decided."""
        command = self.command
        command.v[:] = 0.0
        if command.tau is not None:
            command.tau[:] = 0.0
        command.say(why)
        command.note = note
        return command

    def settle(self) -> Command:
        """The velocity that a closed formula has written, if all of it are finite numbers."""
        if not np.isfinite(self.command.v).all():
            return self.refuse(Status.NOT_FINITE)
        self.command.say(Status.OPTIMAL)
        return self.command

    def hold_still(self, state: State) -> None:
        """Write torques that keep the arms where they are; for laws in velocities zero does."""
        return

    def _plugins(self) -> list[tuple[str, object]]:
        """Whose code a tick runs, with words for each."""
        problem = self.problem
        tasks = [(f"task '{task.name}'", task) for task in problem.all_tasks]
        follows = ((words, value) for words, task in tasks for value in vars(task).values())
        signals = (pair for pair in follows if isinstance(pair[1], Signal))
        limits = ((f"limit '{type_name(type(limit))}'", limit) for limit in problem.limits)
        solver = (f"solver '{type_name(type(problem.solver))}'", problem.solver)
        return [*tasks, *signals, *limits, solver]

    @abstractmethod
    def decide(self, state: State) -> Command:
        """The command at an up-to-date state; raises and prints nothing, reuses its arrays."""


@spec
class Controller(ABC):
    """A plug-in in ``controllers/``: settings, and how to build the law."""

    uses_solver: ClassVar[bool] = False
    """Whether it solves a QP, so that the scenario's solver matters."""
    supports: ClassVar[Features] = NO_FEATURES
    """What of the problem beside its tasks it reads. Who supports limits promises to keep them."""

    @property
    def commands_torques(self) -> bool:
        """Whether it commands torques, which only plants with masses take."""
        return False

    name: Annotated[str, Field(validate_default=True)] = ""
    """Your name for it in tables; its type's name if omitted."""

    @field_validator("name")
    @classmethod
    def _type_name_if_empty(cls, name: str) -> str:
        return name or type_name(cls)

    @abstractmethod
    def build(self, problem: ControlProblem) -> Law:
        """Prepare what is constant; CoopqpError where the controller cannot serve this problem."""

    def unprepared(self, problem: ControlProblem) -> Law:
        """The same, but what only rare ticks need waits for them: for many short runs."""
        return self.build(problem)
