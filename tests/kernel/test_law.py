"""When the kernel decides, when Python does, and what bad input comes to."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from chains import ring, short_pair
from laws import LIMITS, NEAR, STEP, problem
from own_task import Own
from side_by_side import needs_kernel
from stress.trial import one_rollout

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.controllers import QPController
from coopqp.kernel import native
from coopqp.kernel.flat import why_not
from coopqp.kernel.law import KernelLaw
from coopqp.limits import Workspace
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.qp_law.law import QPLaw
from coopqp.scenario.loader import load
from coopqp.solver import Status
from coopqp.solvers import Osqp
from coopqp.task import Task, TaskRows
from coopqp.tasks import JointCentering, Manipulability, PointOnPoint

pytestmark = needs_kernel

REACH = PointOnPoint(name="reach", goal=NEAR)
CENTRE = JointCentering(gain=0.5)


def kernel(chain: ClosedChain, *tasks: Task, **settings: object) -> KernelLaw:
    law = QPController(engine="kernel").build(problem(chain, *tasks, limits=LIMITS, **settings))
    assert isinstance(law, KernelLaw)
    return law


def test_auto_takes_the_kernel_and_python_never_does(chain: ClosedChain) -> None:
    given = problem(chain, REACH)
    assert isinstance(QPController().build(given), KernelLaw)
    assert isinstance(QPController(engine="python").build(given), QPLaw)


def test_a_kernel_of_other_sources_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a checkout that has gone on, and was not compiled again."""
    native.module.cache_clear()
    monkeypatch.setattr(native, "digest", lambda: "of other sources")
    assert native.module() is None
    native.module.cache_clear()
    monkeypatch.undo()
    assert native.module() is not None


def test_what_the_kernel_cannot_do_is_left_or_refused(chain: ClosedChain) -> None:
    for given in (problem(chain, REACH, solver=Osqp()), problem(short_pair(), REACH)):
        assert why_not(given)
        assert isinstance(QPController().build(given), QPLaw)
        with pytest.raises(InvalidValueError, match="engine: kernel cannot do this"):
            QPController(engine="kernel").build(given)


def test_python_tasks_and_limits_mix_with_compiled_ones(chain: ClosedChain) -> None:
    wall = Workspace(normal=(0, 0, 1), through=(0, 0, -0.2), gain=10.0)
    given = problem(chain, REACH, limits=(*LIMITS, wall), secondary=[Manipulability()])
    plain, law = QPController(engine="python").build(given), QPController().build(given)
    one, other = plain.start(), law.start()
    for _ in range(20):
        wanted, found = plain.tick(one), law.tick(other)
        assert law.compiled
        np.testing.assert_allclose(found.v, wanted.v, atol=1e-10)
        one.advance(wanted.v, 0.01)
        other.advance(wanted.v, 0.01)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e150])
@pytest.mark.parametrize("where", ["q", "v"])
def test_garbage_is_a_status(bad: float, where: str, chain: ClosedChain) -> None:
    law = kernel(chain, REACH, secondary=[CENTRE])
    state = law.start()
    getattr(state, where)[3] = bad
    command = law.tick(state)
    assert not command.status.usable or command.status.relaxed or np.isfinite(command.v).all()
    assert np.isfinite(command.v).all()


def test_kernel_goes_on_after_garbage(chain: ClosedChain) -> None:
    law = kernel(chain, REACH, secondary=[CENTRE])
    state = law.start()
    first = law.tick(state).v.copy()
    good, state.q[0] = state.q[0], np.nan
    assert law.tick(state).status is Status.NOT_FINITE
    state.q[0] = good
    state.memory.numbers[:] = 0.0  # what the first tick has left there
    np.testing.assert_array_equal(law.tick(state).v, first)


def test_arrays_that_are_replaced_are_seen(chain: ClosedChain) -> None:
    """Whoever writes state.q = ... gives the state another array."""
    law, plain = (QPController(engine=e).build(problem(chain, REACH)) for e in ("kernel", "python"))
    state = law.start()
    law.tick(state)
    state.q = state.q + 0.01
    np.testing.assert_allclose(law.tick(state).v, plain.tick(State(chain, state.q)).v, atol=1e-10)
    state.q = np.asfortranarray(np.tile(state.q, (2, 1)).T)[:, 0].astype(np.float32)  # type: ignore[assignment]
    assert np.isfinite(law.tick(state).v).all()


def test_a_step_takes_the_state_by_name_and_nothing_else(chain: ClosedChain) -> None:
    law = kernel(chain, REACH)
    state = law.start()
    law.step(state=state)
    assert law.compiled
    assert state.t == law.problem.dt
    for wrong in ({}, {"x": state}):
        with pytest.raises(TypeError, match="step\\(\\) takes one argument, the state"):
            law.step(**wrong)  # type: ignore[arg-type]


def test_jacobians_are_those_of_the_tick(chain: ClosedChain) -> None:
    """Asked for after a tick and after q went on, they belong to the q of the tick."""
    law = kernel(chain, REACH)
    state = law.start()
    state.q += 0.01
    command, there = law.tick(state), State(chain, state.q)
    state.advance(command.v, 0.01)
    np.testing.assert_array_equal(state.J_ext, there.J_ext)
    np.testing.assert_allclose(state.p_WO, there.p_WO, atol=1e-15)


@pytest.mark.parametrize("name", ["three_ur", "tiago_torso", "yeo_4_5"])
def test_rows_in_python_are_filled_from_the_kernels_kinematics(name: str) -> None:
    """Which are pinocchio's but for rounding, with what is asked of joints beside them."""
    chain, seen = load(name).chain, dict[str, Array]()
    of = ("p_WO", "R_WO", "J_ext", "J_task", "J_rel", "loop_error", "drift", "J_loop", "J_joints")

    def write(state: State, rows: TaskRows) -> None:
        assert state.joints_due
        seen.update({name: getattr(state, name).copy() for name in of})
        rows.e[0], rows.J[0] = state.p_WO[0] - 0.1, state.J_task[0]

    law = kernel(chain, Own(write=write))
    state = law.start()
    state.q += 0.01 * np.cos(np.arange(chain.n))
    there = State(chain, state.q)
    assert law.tick(state).status.usable
    assert law.compiled
    for name in of:
        np.testing.assert_allclose(seen[name], getattr(there, name), atol=1e-13, err_msg=name)


def test_states_are_copied_and_kept_by_others(chain: ClosedChain) -> None:
    """A kernel that is gone leaves its arrays to who holds them, and the other way round."""
    law = kernel(chain, PointOnPoint(name="reach", goal=NEAR, profile=STEP))
    state = law.start()
    v = law.tick(state).v
    wanted = v.copy()
    again = pickle.loads(pickle.dumps(state))
    deep = copy.deepcopy(state)
    np.testing.assert_array_equal(law.tick(again).v, wanted)
    np.testing.assert_array_equal(law.tick(deep).v, wanted)
    del state, again, deep, law
    np.testing.assert_array_equal(v, wanted)


@pytest.mark.parametrize("seed", [2653, 9951])
def test_rows_that_nearly_depend_on_each_other_are_decided_in_twice_the_digits(seed: int) -> None:
    """In single ones 212 and 199 ticks of these rollouts had no proof."""
    found = one_rollout(seed)
    assert not found.broken
    assert not found.plain


def test_eight_arms_are_one_problem() -> None:
    chain = ring(8, 7)
    given = problem(chain, PointOnPoint(goal=tuple((chain.start_position + 0.01).tolist())))
    plain, law = (QPController(engine=e).build(given) for e in ("python", "kernel"))
    np.testing.assert_allclose(law.tick(law.start()).v, plain.tick(plain.start()).v, atol=1e-10)
    assert law.compiled


@pytest.mark.parametrize("measured", [False, True])
def test_a_tick_in_which_a_task_raises_once_is_told(chain: ClosedChain, measured: bool) -> None:
    """A look-up fails twice; the law does not ask it again and hide that."""
    calls = iter(range(1000))

    def write(state: State, rows: TaskRows) -> None:
        rows.e[0], rows.J[0] = state.p_WO[0] - 0.2, state.J_task[0]
        if next(calls) in (6, 9):
            raise TimeoutError("no transform")

    law = kernel(chain, REACH, Own(write=write))
    state = law.start(q_measured=chain.q_start if measured else None)
    said = [law.tick(state).status is Status.RAISED for _ in range(12)]
    assert sum(said) == 2
