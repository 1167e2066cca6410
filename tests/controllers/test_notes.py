"""The note of a tick that is not optimal names who is behind it, and costs nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from laws import LIMITS, NEAR, STEP, problem
from online_loops import Told, follows, go, simulated

from coopqp.controller import Command, ControlProblem, Law
from coopqp.controllers import Pseudoinverse, QPController, SaturationNullSpace, TorqueQp
from coopqp.limits import JointAcceleration, ObjectSpeed
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.online.loop import OnlineLoop
from coopqp.solver import Budget, Status
from coopqp.tasks import PointOnPoint

#: Nothing is wrong, or who says so is no law: the loop, whose words are tested below, or a plant.
OTHERS = {Status.OPTIMAL, Status.RAISED, Status.PLANT_FAILED, Status.OBJECT_LOST}
OTHERS |= {Status.FORCE_NOT_MEASURED, Status.SQUEEZE_GIVEN_UP, Status.INPUT_REFUSED}
OTHERS |= {Status.ROBOT_SILENT, Status.MEASURED_JUMPED, Status.STOPPED, Status.NOT_BEGUN}
OTHERS |= {Status.LATE, Status.EARLY, Status.CLOCK_WRONG, Status.FAULT, Status.OFFSET_AT_BOUND}
OTHERS |= {Status.JOINT_DOUBTED}

NAMES = {
    "solver 'daqp'": {
        Status.INACCURATE, Status.UNBOUNDED, Status.ITERATION_LIMIT, Status.SOLVER_FAILED,
        Status.EQUALITY_RESIDUAL, Status.BOUND_RESIDUAL, Status.SOLVER_ERROR,
    },
    "loop of left is ": {
        Status.INFEASIBLE, Status.DRIFT_SLOWED, Status.STEP_SHORTENED, Status.LOOP_BUDGET
    },
    "'reach'": {Status.TASKS_RELAXED, Status.NOT_FINITE},
    "RElbowRoll is 0.3 rad above its range": {Status.RECOVERING},
    "LWristYaw changes by +0.5": {Status.ACCELERATION_GIVEN_UP},
    "hand of ": {Status.CONTACT_GIVEN_UP},
    "found 10 joints": {Status.WRONG_STATE},
    "RElbowRoll by +0.1": {Status.OVERWRITTEN},
    "needs (10,)": {Status.NOT_MEASURED},
    "target": {Status.INPUT_STALE},
}  # fmt: skip


class Says(Law):
    """Says a status whatever the state."""

    engine = "python"
    says = Status.OPTIMAL

    def decide(self, state: State) -> Command:
        self.command.v[:] = 0.0
        self.command.v[-1] = 0.5
        self.command.say(self.says)
        return self.command


FAR = (1.0, 0.5, 1.0)


def _reach(mode: Any = "hard", goal: tuple[float, float, float] = FAR) -> PointOnPoint:
    return PointOnPoint(name="reach", goal=goal, profile=STEP, gain=20.0, mode=mode)


def _outside(chain: ClosedChain) -> np.ndarray[Any, Any]:
    q = chain.q_start.copy()
    i = chain.joint_names.index("RElbowRoll")
    q[i] = chain.upper[i] + 0.3
    return q


def test_every_status_of_a_law_has_words() -> None:
    assert set(Status) == OTHERS.union(*NAMES.values())


@pytest.mark.parametrize("status", sorted(set(Status) - OTHERS, key=lambda status: status.name))
def test_the_note_of_every_status_names_who_is_behind_it(
    chain: ClosedChain, status: Status
) -> None:
    law = Says(problem(chain, _reach(), limits=LIMITS))
    law.says = status
    state = law.start(_outside(chain))
    state.inputs.stale = ("target",)
    state.q_measured = np.zeros(3)
    state._commanded[:] = state.q
    state.q[chain.joint_names.index("RElbowRoll")] += 0.1 * (status is Status.OVERWRITTEN)
    note = law.tick(state).note
    (name,) = (name for name, statuses in NAMES.items() if status in statuses)
    assert name in note


def test_words_are_made_once_and_only_where_they_are_read(chain: ClosedChain) -> None:
    asked = []

    class Counted(ObjectSpeed):
        def margins(self, *given: Any) -> Any:
            asked.append(1)
            raise ValueError

    law = Says(problem(chain, _reach(), limits=(*LIMITS, Counted(linear=1.0))))
    law.says = Status.TASKS_RELAXED
    command = law.tick(law.start())
    assert not asked
    assert command.note == command.copy().note
    assert asked == [1]
    law.says = Status.OPTIMAL
    assert law.tick(law.start()).messages == ()
    assert (law.command.note, command.note) == ("", "'reach' made soft")


SLOW = (*LIMITS, JointAcceleration(max=1.0))
Given = Callable[[ClosedChain], tuple[Law, State]]


def _at(law: Law, q: Any = None) -> tuple[Law, State]:
    return law, law.start(q)


def _of(chain: ClosedChain, *tasks: PointOnPoint, **settings: Any) -> ControlProblem:
    return problem(chain, *(tasks or (_reach("soft", NEAR),)), **{"limits": LIMITS, **settings})


def _jerked(law: Law) -> tuple[Law, State]:
    state = law.start()
    state.v[:] = 2.0
    return law, state


def _dizzy(law: Law) -> tuple[Law, State]:
    state = law.start()
    state.v[3] = np.nan
    return law, state


def _infeasible(chain: ClosedChain) -> tuple[Law, State]:
    return _at(QPController().build(_of(chain, _reach(), on_infeasible="hold")))


def _torn(chain: ClosedChain) -> np.ndarray[Any, Any]:
    q = chain.q_start.copy()
    q[7] += 0.3
    return q


CASES: dict[str, tuple[Given, Status, str]] = {
    "recovering": (
        lambda c: _at(QPController().build(_of(c)), _outside(c)),
        Status.RECOVERING,
        "RElbowRoll is 0.3 rad above its range",
    ),
    "hard": (
        lambda c: _at(QPController().build(_of(c, _reach()))),
        Status.TASKS_RELAXED,
        "'reach' at ",
    ),
    "hold": (_infeasible, Status.INFEASIBLE, "hard 'reach' leave no motion: loop of left"),
    "torn": (
        lambda c: _at(QPController().build(_of(c)), _torn(c)),
        Status.DRIFT_SLOWED,
        "loop of left is ",
    ),
    "jerked": (
        lambda c: _jerked(QPController().build(_of(c, limits=SLOW))),
        Status.ACCELERATION_GIVEN_UP,
        "acceleration of ",
    ),
    "saturated": (
        lambda c: _at(SaturationNullSpace().build(_of(c)), _torn(c)),
        Status.DRIFT_SLOWED,
        "loop of left is ",
    ),
    "short": (
        lambda c: _at(QPController().build(_of(c, budget=Budget(loop_position=1e-9)))),
        Status.STEP_SHORTENED,
        "1e-06 mm, 10 mrad of the budget",
    ),
    "inverse": (
        lambda c: _dizzy(Pseudoinverse().build(_of(c))),
        Status.NOT_FINITE,
        "no finite q or v of RElbowRoll",
    ),
    "torque": (
        lambda c: _at(TorqueQp().build(_of(c, _reach()))),
        Status.TASKS_RELAXED,
        "'reach' made soft",
    ),
}  # fmt: skip


@pytest.mark.parametrize("python", [False, True])
@pytest.mark.parametrize("case", CASES)
def test_ticks_that_went_wrong_say_where(chain: ClosedChain, case: str, python: bool) -> None:
    given, status, words = CASES[case]
    law, state = given(chain)
    if python:
        v, law = state.v, getattr(law, "plain", law)
        state = law.start(state.q)
        state.v[:] = v
    command = law.tick(state)
    assert status in command.causes
    assert words in command.note


def test_a_run_that_the_kernel_steps_says_the_same(chain: ClosedChain) -> None:
    law = QPController().build(_of(chain))
    command = law.step(law.start(_outside(chain)))
    assert Status.RECOVERING in command.causes
    assert "RElbowRoll is 0.3 rad above its range" in command.note


def test_every_status_of_the_loop_has_a_note() -> None:
    clock, scenario = Told(), replace(follows(), start_outside=True)
    loop = OnlineLoop(scenario, clock=clock)
    q = scenario.chain.q_start
    said: dict[Status, str] = {}

    def tick(reading: Any, after: float = scenario.dt, **inputs: Any) -> None:
        clock.t += after
        command = loop.tick(reading, inputs)
        said.update(dict.fromkeys(command.causes, loop.note))
        assert loop.note or command.causes == (Status.OPTIMAL,)

    tick(np.zeros(3))
    tick(q)
    tick(q, 0.1 * scenario.dt)
    tick(q, target=[np.nan, 0.0, 0.0])
    tick(q, 2.0 * scenario.dt)
    tick(None)
    tick(q + 1.0)
    loop.stop("lunch")
    tick(q)
    for status, words in {
        Status.NOT_MEASURED: "found shape (3,)",
        Status.EARLY: "of the period are left",
        Status.INPUT_REFUSED: "target: ",
        Status.LATE: "20 ms after the last tick",
        Status.ROBOT_SILENT: "read() gave None",
        Status.MEASURED_JUMPED: " by +1 rad in ",
        Status.STOPPED: "lunch",
    }.items():
        assert words in said[status]


def test_a_loop_that_begins_outside_says_which_joint_recovers() -> None:
    loop, robot = simulated(replace(follows(), start_outside=True))
    robot.state.q[:] = _outside(loop.problem.chain)
    go(loop, robot, 1)
    assert loop.status is Status.RECOVERING
    assert "RElbowRoll is 0.3 rad above its range" in loop.note
