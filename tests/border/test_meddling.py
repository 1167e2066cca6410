"""Plug-ins that write to the state they are shown, or of which numpy would warn."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from laws import NEAR, problem
from online_loops import follows, go, simulated
from own_task import Own

from coopqp.base.spec import Array, spec
from coopqp.controller import Controller, Law
from coopqp.controllers import Pseudoinverse, QPController
from coopqp.limit import Limit, LimitRows, Tighten
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.signal import InputValues, Instant, Kind, Signal, Trajectory
from coopqp.solver import Status
from coopqp.solvers import Osqp
from coopqp.task import Evaluate, Task, TaskRows
from coopqp.tasks import PointOnPoint

LATE = 0.03
"""From here on a plug-in meddles [s]."""


def _set(name: str, value: Any) -> Callable[[Any], None]:
    def write(state: Any) -> None:
        setattr(state, name, value)

    return write


def _fill(name: str, value: float) -> Callable[[Any], None]:
    def write(state: Any) -> None:
        getattr(state, name)[...] = value

    return write


def _writeable(name: str) -> Callable[[Any], None]:
    def write(state: Any) -> None:
        getattr(state, name).flags.writeable = True
        getattr(state, name)[...] = np.nan

    return write


def _add(state: Any) -> None:
    state.q += 0.1


def _resize(state: Any) -> None:
    state.q.resize(3, refcheck=False)


def _memory(state: Any) -> None:
    state.memory.numbers[...] = np.nan


def _lower(state: Any) -> None:
    state.chain.lower[...] = 5.0


def _stopped(state: Any) -> None:
    state.memory["stopped"][0] = 1.0


def _update(state: Any) -> None:
    state.advance(np.ones(len(state.q)), 0.1)


ARRAYS = (
    "q", "v", "loop_offset", "p_WO", "R_WO", "loop_error", "drift", "closed_error", "q_measured",
    "J_ext", "J_task", "J_rel", "J_joints", "J_loop", "e_loop",
)  # fmt: skip
WRITES: dict[str, Callable[[Any], None]] = {
    **{f"{name} nan": _fill(name, np.nan) for name in ARRAYS},
    **{f"{name} writeable": _writeable(name) for name in ARRAYS if name != "q_measured"},
    **{f"another {x}": _set(x, np.zeros(3)) for x in (*ARRAYS, "memory", "inputs", "chain")},
    "another t": _set("t", np.nan),
    "another share": _set("corrected", 0.0),
    "farther": _add,
    "resized": _resize,
    "memory": _memory,
    "limits of the chain": _lower,
    "stopped": _stopped,
    "advanced": _update,
}
#: Which is no fault, as long as it is not kept so.
READ_ONLY: dict[str, Callable[[Any], None]] = {"read only": lambda state: state.q.setflags(write=0)}


@spec
class Meddling(Task):
    """Writes to the state late."""

    how: str

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """One row."""
        return ("z",)

    def bind(self, start: State) -> Evaluate:
        """Nothing to keep."""

        def evaluate(state: State, rows: TaskRows) -> None:
            rows.e[0], rows.J[0] = state.p_WO[2] - 0.05, state.J_task[2]
            if state.t > LATE:
                (WRITES | READ_ONLY)[self.how](state)

        return evaluate


@spec
class MeddlingLimit(Limit):
    """The same."""

    how: str

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        """Nothing is tightened."""

        def tighten(state: State, rows: LimitRows) -> None:
            if state.t > LATE:
                WRITES[self.how](state)

        return tighten


class _Writing(Trajectory):
    moves = True
    how = ""

    def update(self, at: Instant) -> None:
        if at.t > LATE:
            WRITES[self.how](at)


@spec
class MeddlingSignal(Signal):
    """The same."""

    how: str

    def bind(self, kind: Kind, start: Instant, here: Array | None) -> Trajectory:
        """It stays where it is."""
        found = _Writing(kind, kind.read(NEAR))
        found.how = self.how
        return found


LAWS: dict[str, tuple[Controller, dict[str, Any]]] = {
    "kernel": (QPController(), {}),
    "plain": (QPController(), {"solver": Osqp()}),
    "closed form": (Pseudoinverse(), {}),
}


def _law(chain: ClosedChain, law: str, by: str, how: str) -> Law:
    controller, more = LAWS[law]
    limits: tuple[Limit, ...] = (JointPosition(), JointVelocity())
    tasks: tuple[Task, ...] = (PointOnPoint(goal=NEAR),)
    if by == "task":
        tasks = (PointOnPoint(goal=NEAR), Meddling(name="mine", how=how))
    if by == "limit":
        limits = (*limits, MeddlingLimit(how=how))
    if by == "signal":
        tasks = (PointOnPoint(name="mine", goal=MeddlingSignal(how=how)),)
    return controller.build(problem(chain, *tasks, limits=limits, **more))


def _owned(state: State) -> tuple[Any, ...]:
    """What may not be another after a tick."""
    return state.q, state.v, state.loop_offset, state.t, state.inputs, state.chain, state.memory


BY = [(law, by) for law in LAWS for by in ("task", "limit", "signal")]
BY.remove(("closed form", "limit"))  # it reads none


@pytest.mark.few(4)
@pytest.mark.parametrize(("law", "by"), BY)
def test_what_a_plug_in_writes_to_the_state_is_named_and_undone(
    chain: ClosedChain, law: str, by: str
) -> None:
    lower = chain.lower.copy()
    for how in WRITES:
        _check_undone(chain, law, by, how)
    np.testing.assert_array_equal(chain.lower, lower)


def _check_undone(chain: ClosedChain, law: str, by: str, how: str) -> None:
    built = _law(chain, law, by, how)
    state = built.start()
    for _ in range(6):
        state.q_measured = state.q.copy()
        q, v, own = state.q.copy(), state.v.copy(), _owned(state)
        command = built.tick(state)
        assert (np.abs(command.v) <= chain.velocity + 1e-9).all()
        np.testing.assert_array_equal(state.q, q)
        np.testing.assert_array_equal(state.v, v)
        assert all(a is b for a, b in zip(_owned(state), own, strict=True))
        assert np.isfinite(state.loop_offset).all()
        assert np.isfinite(state.memory.numbers).all()
        if state.t > LATE:
            assert command.causes[0] is Status.RAISED, how
            assert not command.v.any()
            assert "test_meddling.py:" in command.note
            refused = ("state.q cannot be replaced", "cannot assign to field 'q'")
            assert how != "another q" or any(words in command.note for words in refused)
        else:
            assert command.status is Status.OPTIMAL
        state.advance(command.v, 0.01)
    assert how != "stopped" or law == "closed form" or not state.memory["stopped"][0]


def test_a_state_that_a_task_makes_read_only_is_put_right(chain: ClosedChain) -> None:
    built = _law(chain, "plain", "task", "read only")
    state = built.start()
    for _ in range(6):
        assert built.tick(state).status is Status.OPTIMAL
        state.advance(built.command.v, 0.01)
    assert state.q.flags.writeable


@pytest.mark.parametrize("writes", ["value", "rate", "another", "forgotten"])
def test_what_a_task_writes_to_inputs_is_named_and_undone(writes: str) -> None:
    scenario = follows()
    tasks = (*scenario.tasks, MeddlingInput(name="mine", writes=writes))
    loop, robot = simulated(replace(scenario, tasks=tasks))
    go(loop, robot, 20, {"target": [0.15, 0.01, 0.05]})
    channel = loop.state.inputs["target"]
    assert loop.status is Status.RAISED
    assert loop.note.startswith("task 'mine': ")
    assert np.isfinite(channel.value).all()
    assert np.isfinite(channel.rate).all()
    assert np.abs(channel.rate).max() > 0.0  # it goes on its way


@spec
class MeddlingInput(Task):
    """Writes to inputs, late."""

    writes: str

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """One row."""
        return ("z",)

    def bind(self, start: State) -> Evaluate:
        """Nothing to keep."""

        def evaluate(state: State, rows: TaskRows) -> None:
            rows.e[0], rows.J[0] = 0.0, state.J_task[2]
            if state.t < LATE:
                return
            of: Any = state.inputs["target"]
            if self.writes == "another":
                state.inputs = InputValues()
            elif self.writes == "forgotten":
                state.inputs.clear()
            else:
                getattr(of, self.writes)[:] = np.nan

        return evaluate


def warn(state: State, rows: TaskRows) -> None:
    """Divide by zero, overflow, and take roots of negative numbers."""
    rows.e[0], rows.J[0] = state.p_WO[2] - 0.05, state.J_task[2]
    nothing, much = np.zeros(2), np.full(2, 1e300)
    all_of_it = 1.0 / nothing, nothing / nothing, much * much, np.sqrt(-much), 1.0 / much**1
    if state.t > LATE:
        rows.e[0] += sum(x[0] for x in all_of_it)
        rows.J[0] *= much[0] * much[0]


@spec
class WarningLimit(Limit):
    """The same, with bounds that are none of a number."""

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        """Tightens nothing at first."""

        def tighten(state: State, rows: LimitRows) -> None:
            much = np.full(chain.n, 1e300) * 1e300
            if state.t > LATE:
                np.minimum(rows.ub, much - much, out=rows.ub)

        return tighten


@pytest.fixture
def strict() -> Iterator[None]:
    """As a user may have it: numpy raises, and warnings are errors."""
    with np.errstate(all="raise"), warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.mark.usefixtures("strict")
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("by", ["task", "limit"])
def test_no_warning_of_numpy_leaves_a_tick(
    chain: ClosedChain, law: str, by: str, capfd: pytest.CaptureFixture[str]
) -> None:
    controller, more = LAWS[law]
    tasks = (PointOnPoint(goal=NEAR), *([Own(name="mine", write=warn)] if by == "task" else []))
    limits = (JointPosition(), JointVelocity(), *([WarningLimit()] if by == "limit" else []))
    built = controller.build(problem(chain, *tasks, limits=limits, **more))
    state = built.start()
    for _ in range(8):
        command = built.tick(state)
        assert command.status is not Status.RAISED, command.note
        assert np.isfinite(command.v).all()
        if state.t <= LATE or (by == "limit" and law == "closed form"):
            assert command.status is Status.OPTIMAL
        else:
            assert not command.status.usable
            assert "NaN or infinite" in command.note
        state.advance(command.v, 0.01)
    assert capfd.readouterr() == ("", "")
