"""What a kernel is not built for, and what may happen to a process that has one."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
from chains import ring, robot_of, serial
from forking import forked, program
from laws import LIMITS, NEAR, problem
from side_by_side import needs_kernel

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.controller import Controller
from coopqp.controllers import Pseudoinverse, QPController
from coopqp.execution.controller_run import run
from coopqp.grasps import Rigid
from coopqp.kernel import native
from coopqp.kernel.flat import why_not
from coopqp.kernel.law import KernelLaw
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State
from coopqp.robot_files.mdh import MdhParameters as Parameters
from coopqp.scenario.loader import load
from coopqp.solver import Status
from coopqp.task import Task
from coopqp.tasks import JointCentering, PointOnPoint

pytestmark = needs_kernel

CENTRE = JointCentering(gain=0.5)


def alike(chain: ClosedChain, *tasks: PointOnPoint) -> None:
    """One tick by both, with joint centring."""
    given = problem(chain, *tasks, secondary=[CENTRE], limits=LIMITS)
    plain, law = (QPController(engine=engine).build(given) for engine in ("python", "kernel"))
    wanted = plain.tick(plain.start()).v
    np.testing.assert_allclose(law.tick(law.start()).v, wanted, rtol=0.0, atol=1e-10)
    assert law.compiled


def test_nothing_to_do(chain: ClosedChain) -> None:
    """No task, no limit: it stands still."""
    law = QPController(engine="kernel").build(problem(chain))
    assert isinstance(law, KernelLaw)
    np.testing.assert_allclose(law.tick(law.start()).v, 0.0, atol=1e-12)
    assert law.compiled


def test_one_arm_alone(chain: ClosedChain) -> None:
    """Without a loop."""
    one = chain.handed_over(chain.q_start, [chain.arms[0].name])
    alike(one, PointOnPoint(goal=tuple((one.start_position + 0.01).tolist())))


def test_an_arm_of_one_joint() -> None:
    """It decides for the others; the loop has hardly more joints than rows."""
    joints = [Parameters(alpha=1.0, d=0.1 * k, r=0.1) for k in range(7)]
    robot = robot_of("uneven", {"long": serial("l", joints), "short": serial("s", joints[:1])},
                     (0.1, 0.0, 0.0))  # fmt: skip
    chain = ClosedChain.attach(robot, np.linspace(-0.5, 0.6, 8), Rigid(), HeldObject())
    alike(chain, PointOnPoint(goal=tuple((chain.start_position + 0.001).tolist())))


@pytest.mark.parametrize("joints", [30, 33])
def test_many_joints(joints: int) -> None:
    """Sixty are compiled for, more than that are said to be too many."""
    chain = ring(2, joints)
    task = PointOnPoint(goal=tuple((chain.start_position + 0.001).tolist()))
    reason = why_not(problem(chain, task))
    if joints > 30:
        assert "more than" in reason
        assert not isinstance(QPController().build(problem(chain, task)), KernelLaw)
    else:
        alike(chain, task)


def test_the_module_refuses_what_is_no_problem() -> None:
    """Whoever calls it without coopqp gets an exception."""
    engine = native.module().Engine  # type: ignore[union-attr]
    for wrong in ({}, {"model": {}}, {"model": None}):
        with pytest.raises((KeyError, RuntimeError, TypeError)):
            engine(wrong)


def test_laws_are_not_pickled(chain: ClosedChain) -> None:
    """An exception, and the law goes on."""
    law = QPController(engine="kernel").build(problem(chain, PointOnPoint(goal=NEAR)))
    with pytest.raises((TypeError, pickle.PicklingError, AttributeError)):
        pickle.dumps(law)
    assert law.tick(law.start()).status is Status.OPTIMAL


@pytest.mark.parametrize("ticks", [-1, 1.5, "x", None, True, 10**9])
@pytest.mark.parametrize("engine", ["python", "kernel"])
def test_a_run_has_a_whole_number_of_ticks(
    chain: ClosedChain, engine: Literal["python", "kernel"], ticks: Any
) -> None:
    law = QPController(engine=engine).build(problem(chain, PointOnPoint(goal=NEAR)))
    with pytest.raises(InvalidValueError, match="ticks: found"):
        law.run(law.start(), ticks)


REACH = PointOnPoint(goal=NEAR)
LAWS: dict[str, tuple[Controller, Task]] = {
    "kernel": (QPController(engine="kernel"), REACH),
    "hard": (QPController(engine="kernel"), replace(REACH, mode="hard")),
    "large": (QPController(engine="kernel"), JointCentering(gain=0.5)),
    "python": (QPController(engine="python"), REACH),
    "pseudoinverse": (Pseudoinverse(), REACH),
}


@pytest.mark.few(4)
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("how", ["run", "step", "tick"])
def test_two_threads_on_one_law_take_turns(
    chain: ClosedChain, name: str, how: str, often: None
) -> None:
    """Each gets what it gets alone, to the last bit, and nobody else writes to its command."""
    chain = ring(7, 6) if name == "large" else chain
    controller, task = LAWS[name]
    law, ticks = controller.build(problem(chain, task)), 300

    def work() -> Array:
        state, v = law.start(), np.zeros((ticks, chain.n))
        if how == "run":
            return law.run(state, ticks).v
        for k in range(ticks):
            command = getattr(law, how)(state)
            if how == "tick":
                state.advance(command.v, law.problem.dt)
            time.sleep(0.0)  # the other one's turn
            v[k] = command.v
        return v

    alone = work()
    with ThreadPoolExecutor(2) as pool:
        for found in [pool.submit(work) for _ in range(4)]:
            np.testing.assert_array_equal(found.result(), alone)


@pytest.fixture
def often() -> Iterator[None]:
    """Threads are changed in the middle of ticks."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(interval)


def test_a_law_goes_on_in_a_process_that_was_forked_in_the_middle_of_a_tick(
    chain: ClosedChain,
) -> None:
    """The thread whose turn it was is not there any more."""
    law = QPController(engine="kernel").build(problem(chain, PointOnPoint(goal=NEAR)))
    wanted, ticking, go_on = law.tick(law.start()).v.copy(), threading.Event(), threading.Event()

    class Slow(State):
        def update(self) -> None:
            super().update()
            if threading.current_thread() is not threading.main_thread():
                ticking.set()
                go_on.wait(10.0)

    slow = Slow(chain)
    slow.q_measured = slow.q.copy()
    other = threading.Thread(target=law.tick, args=(slow,))

    def same() -> bool:
        signal.alarm(10)  # else it may wait for ever
        return np.array_equal(law.tick(law.start()).v, wanted)

    other.start()
    assert ticking.wait(10.0)
    try:
        child = forked(lambda: os._exit(3 if same() else 4))
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3
    finally:
        go_on.set()
        other.join()


def test_a_spawned_process_gives_the_same_bits() -> None:
    scenario = replace(load("point_on_point"), duration=0.5)
    here = run(scenario, controller="qp").q
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn) as pool:
        there: Array = pool.submit(run, scenario, controller="qp").result(60.0).q
    np.testing.assert_array_equal(there, here)


FORKED = """
import os, signal, numpy as np
from coopqp.controllers import QPController
from coopqp.scenario.loader import load
law = QPController(engine="kernel").build(load("point_on_point").problem())
state = law.start()
law.tick(state)
wanted = law.tick(law.start()).v.copy()
child = os.fork()
same = np.array_equal(law.tick(law.start()).v, wanted)
if not child:
    os._exit(0 if same else 1)
assert same and os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0

def ring(*_):
    raise KeyboardInterrupt
signal.signal(signal.SIGALRM, ring)
signal.setitimer(signal.ITIMER_REAL, 0.05)
try:
    law.run(state, 10_000_000)
except KeyboardInterrupt:
    pass
else:
    raise AssertionError("nobody heard the bell")
assert np.isfinite(state.q).all() and np.array_equal(law.tick(law.start()).v, wanted)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_forks_and_bells_in_a_rollout() -> None:
    """A child goes on by itself; a signal ends ten million ticks soon, and the law goes on."""
    assert hasattr(signal, "setitimer")
    with program(FORKED) as process:
        said = process.out.read()
        assert process.ended() == 0, said
