"""What every solver keeps: the optimum or a status, no exception, no print."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import numpy as np
import pytest
from example_solvers import (
    PROBLEMS,
    N,
    active,
    checked,
    copy_into,
    curvature,
    distance_from_optimality,
    each_solver,
    empty_qp,
    problem_set,
    random_qp,
    solved,
)

from coopqp.base.errors import UnknownNameError
from coopqp.base.qp import QP
from coopqp.solver import Budget, Solution, Solver, Status, Verifier
from coopqp.solvers import Daqp, Osqp, Proxqp, Qpsolvers


def test_bounds_and_rows_bind_in_most_problems() -> None:
    presses = [active(qp, solved(Daqp(), qp).v)[0] for qp in problem_set()]
    assert sum(p[: 2 * N].any() for p in presses) > 0.8 * PROBLEMS
    assert sum(p[2 * N :].any() for p in presses) > 0.15 * PROBLEMS


def test_daqp_meets_the_optimality_conditions() -> None:
    for qp in problem_set():
        v = solved(Daqp(), qp).v
        assert np.abs(qp.A @ v - qp.b).max() < 1e-9
        assert (np.concatenate([qp.lb - v, v - qp.ub, qp.G @ v - qp.h]) < 1e-9).all()
        assert distance_from_optimality(qp, v) < 1e-8


@each_solver
def test_solver_finds_the_optimum(solver: Solver) -> None:
    for qp in problem_set():
        exact = solved(Daqp(), qp).v
        solution, status = checked(solver, qp)
        assert status.usable
        np.testing.assert_allclose(solution.v, exact, atol=1e-5)


@each_solver
def test_no_usable_answer_is_wrong(solver: Solver) -> None:
    """Loose backends may be refused; what is used keeps the constraints, what is optimal is so.

    Row residuals within the budget of 1e-6 move the optimum by more: 4e-5 where nine rows bind.
    """
    for qp in problem_set():
        exact = solved(Daqp(), qp).v
        solution, status = checked(solver, qp)
        v = solution.v
        if status is Status.OPTIMAL:
            np.testing.assert_allclose(v, exact, atol=1e-4)
        if status.usable:
            assert np.abs(qp.A @ v - qp.b).max() < 1e-6
            assert (np.concatenate([qp.lb - v, v - qp.ub]) <= 0).all()
            assert (qp.G @ v - qp.h <= 1e-6).all()


@each_solver
def test_multipliers_balance_the_gradient_with_the_declared_signs(solver: Solver) -> None:
    """The sign of z is positive when active, z_box positive at ub and negative at lb."""
    for qp in problem_set():
        s = solved(solver, qp)
        gradient = qp.P @ s.v + qp.q + qp.A.T @ s.y + qp.G.T @ s.z + s.z_box
        np.testing.assert_allclose(gradient, 0, atol=1e-5)
        assert (s.z > -1e-6).all()
        assert np.abs(s.z * (qp.G @ s.v - qp.h)).max(initial=0.0) < 1e-5
        towards = np.where(s.z_box > 0, qp.ub - s.v, s.v - qp.lb)
        assert np.abs(s.z_box * towards).max() < 1e-5


def drift(qp: QP, rng: np.random.Generator) -> None:
    """Shift the problem in v and turn its cost a little; it stays feasible."""
    shift = rng.normal(scale=0.02, size=N)
    qp.lb += shift
    qp.ub += shift
    qp.b += qp.A @ shift
    qp.h += qp.G @ shift
    qp.q += rng.normal(scale=0.1, size=N)
    qp.seal()


def jump(qp: QP, rng: np.random.Generator) -> None:
    """Become another problem."""
    copy_into(qp, random_qp(rng))


@pytest.mark.each_value
@pytest.mark.parametrize("change", [drift, jump])
@each_solver
def test_solver_follows_a_problem_that_changes_from_tick_to_tick(
    solver: Solver, change: Callable[[QP, np.random.Generator], None], rng: np.random.Generator
) -> None:
    """One opened solver with its warm start, as in a run."""
    qp = random_qp(rng)
    solution = Solution(qp)
    solve = solver.open(qp, solution)
    for _ in range(50):
        change(qp, rng)
        solve()
        status = Verifier(qp, solution, Budget(), curvature(qp)).check()
        assert status.usable
        if change is drift or status is Status.OPTIMAL:
            np.testing.assert_allclose(solution.v, solved(Daqp(), qp).v, atol=1e-5)


def loops_beyond_reach(qp: QP) -> None:
    qp.b[:] += 100.0
    qp.seal()


def one_loop_with_two_wills(qp: QP) -> None:
    qp.A[1], qp.b[1] = qp.A[0], qp.b[0] + 1.0
    qp.seal()


def rows_that_exclude_each_other(qp: QP) -> None:
    qp.G[1], qp.h[1] = -qp.G[0], -qp.h[0] - 1.0


def bounds_that_cross(qp: QP) -> None:
    """At the joint that presses hardest on its upper bound."""
    joint = int(solved(Daqp(), qp).z_box.argmax())
    qp.lb[joint] = qp.ub[joint] + 1.0


CONTRADICTIONS = [loops_beyond_reach, one_loop_with_two_wills, rows_that_exclude_each_other]


def verdict_when_spoilt(solver: Solver, qp: QP, spoil: Callable[[QP], None]) -> Status:
    """Of a solver that is opened on a feasible problem, which then becomes infeasible."""
    solution = Solution(qp)
    solve = solver.open(qp, solution)
    solve()
    spoil(qp)
    solve()
    return Verifier(qp, solution, Budget(), curvature(qp)).check()


@pytest.mark.parametrize("spoil", CONTRADICTIONS)
@each_solver
def test_infeasible_problem_is_a_status_and_never_an_exception(
    solver: Solver, spoil: Callable[[QP], None], rng: np.random.Generator
) -> None:
    assert not verdict_when_spoilt(solver, random_qp(rng), spoil).usable


@each_solver
def test_bounds_that_cross_are_a_status_and_never_an_exception(
    solver: Solver, rng: np.random.Generator
) -> None:
    if isinstance(solver, Proxqp):  # some crossed bounds take it half a minute
        solver = Proxqp(max_iter=100)
    assert not verdict_when_spoilt(solver, random_qp(rng), bounds_that_cross).usable


@each_solver
def test_solver_recovers_in_the_tick_after_an_infeasible_one(solver: Solver) -> None:
    for seed in range(8):
        qp = random_qp(np.random.default_rng(seed))
        solution = Solution(qp)
        solve = solver.open(qp, solution)
        solve()
        loops_beyond_reach(qp)
        solve()
        assert not solution.status.usable
        solution.v[:] = 0.0  # as the controller does
        copy_into(qp, random_qp(np.random.default_rng(seed)))
        solve()
        assert solution.status.usable
        np.testing.assert_allclose(solution.v, solved(Daqp(), qp).v, atol=1e-2)


@each_solver
def test_solver_says_nothing_when_bounds_cross(
    solver: Solver, rng: np.random.Generator, capfd: pytest.CaptureFixture[str]
) -> None:
    qp = random_qp(rng)
    solve = solver.open(qp, Solution(qp))
    bounds_that_cross(qp)
    solve()
    ctypes.CDLL(None).fflush(None)  # what C code printed is still in its buffer
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("spoil", ["P", "q", "A", "b", "lb"])
@each_solver
def test_broken_numbers_never_raise(solver: Solver, spoil: str, rng: np.random.Generator) -> None:
    if isinstance(solver, Proxqp):  # it iterates on NaN for half a minute
        solver = Proxqp(max_iter=10)
    if solver == Qpsolvers(backend="proxqp"):
        pytest.skip("it iterates on NaN for half a minute and has no limit to set")
    qp = random_qp(rng)
    solution = Solution(qp)
    solve = solver.open(qp, solution)
    getattr(qp, spoil)[2] = np.nan
    qp.seal()
    solve()
    assert isinstance(Verifier(qp, solution, Budget(), 0.1).check(), Status)


def test_unknown_backend_is_named_with_those_installed() -> None:
    qp = empty_qp()
    with pytest.raises(UnknownNameError, match="'dapq'; did you mean 'daqp'"):
        Qpsolvers(backend="dapq").open(qp, Solution(qp))


def test_solver_out_of_iterations_says_so(rng: np.random.Generator) -> None:
    for solver in (Daqp(iter_limit=1), Osqp(max_iter=1), Proxqp(max_iter=1)):
        assert checked(solver, random_qp(rng))[1] is Status.ITERATION_LIMIT


def test_osqp_says_nothing_when_no_row_is_active(capfd: pytest.CaptureFixture[str]) -> None:
    qp = empty_qp(2, 0, 0)
    qp.lb[:], qp.ub[:] = -1.0, 1.0
    solution = Solution(qp)
    Osqp().open(qp, solution)()
    ctypes.CDLL(None).fflush(None)  # what C code printed is still in its buffer
    assert capfd.readouterr() == ("", "")
