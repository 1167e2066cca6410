"""Every solver on one set of problems, and the check that no answer escapes."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
import scipy.optimize

import coopqp.solvers
from coopqp.checked import Array
from coopqp.errors import UnknownNameError
from coopqp.qp import QP, RowNames
from coopqp.solver import Budget, Solution, Solver, Status, Verifier
from coopqp.solvers import Daqp, Osqp, Proxqp, Qpsolvers
from coopqp.solvers.qpsolvers import installed

N, M, P = 10, 6, 3  # variables, equalities, inequalities
PROBLEMS = 60
SOLVERS: dict[str, Solver] = {
    "daqp": Daqp(),
    "osqp": Osqp(),
    "proxqp": Proxqp(),
    **{f"qpsolvers.{name}": Qpsolvers(backend=name) for name in installed()},
}


each_solver = pytest.mark.parametrize(
    "solver", [pytest.param(solver, id=name) for name, solver in SOLVERS.items()]
)


def empty_qp(n: int = N, p: int = P, m: int = M) -> QP:
    return QP(
        RowNames(
            variables=tuple(f"v{i}" for i in range(n)),
            inequalities=tuple(f"row{i}" for i in range(p)),
            equalities=tuple(f"loop{i}" for i in range(m)),
        )
    )


def random_qp(rng: np.random.Generator, p: int = P) -> QP:
    """Strictly convex, feasible, with bounds and rows near enough to bind."""
    qp = empty_qp(p=p)
    root, inside = rng.normal(size=(N, N)), rng.uniform(-0.5, 0.5, N)
    qp.P[:], qp.q[:] = root.T @ root + 0.1 * np.eye(N), rng.normal(scale=3.0, size=N)
    qp.A[:], qp.G[:] = rng.normal(size=(M, N)), rng.normal(size=(p, N))
    qp.b[:] = qp.A @ inside
    qp.h[:] = qp.G @ inside + rng.uniform(0.0, 0.3, p)
    qp.lb[:], qp.ub[:] = inside - rng.uniform(0.01, 0.5, N), inside + rng.uniform(0.01, 0.5, N)
    qp.seal()
    return qp


def problem_set() -> list[QP]:
    """The same problems for every solver, half of them with inequality rows."""
    rng = np.random.default_rng(60)
    return [random_qp(rng, p=P * (i % 2)) for i in range(PROBLEMS)]


def copy_into(qp: QP, other: QP) -> None:
    qp.P[:], qp.q[:], qp.C[:] = other.P, other.q, other.C
    qp.lower[:], qp.upper[:] = other.lower, other.upper


def curvature(qp: QP) -> float:
    return float(np.linalg.eigvalsh(qp.P)[0])


def solved(solver: Solver, qp: QP) -> Solution:
    solution = Solution(qp)
    solver.open(qp, solution)()
    return solution


def checked(solver: Solver, qp: QP) -> tuple[Solution, Status]:
    solution = solved(solver, qp)
    return solution, Verifier(qp, solution, Budget(), curvature(qp)).check()


def active(qp: QP, v: Array) -> tuple[Array, Array]:
    """Which of [-v; v; G v] press on -lb, ub and h, and those rows."""
    rows = np.vstack([-np.eye(N), np.eye(N), qp.G])
    room = np.concatenate([-qp.lb, qp.ub, qp.h]) - rows @ v
    return room < 1e-7, rows


def distance_from_optimality(qp: QP, v: Array) -> float:
    """Karush, Kuhn and Tucker by non-negative least squares, with no multipliers of the solver."""
    touching, rows = active(qp, v)
    cone = np.vstack([qp.A, -qp.A, rows[touching]])
    _, residual = scipy.optimize.nnls(cone.T, -(qp.P @ v + qp.q))
    return float(residual)


def test_every_solver_of_the_collection_is_tested_here() -> None:
    assert {type(s).__name__ for s in SOLVERS.values()} == set(coopqp.solvers.__all__)


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


@each_solver
def test_solver_follows_a_problem_that_drifts_from_tick_to_tick(
    solver: Solver, rng: np.random.Generator
) -> None:
    """One opened solver with its warm start, as in a run."""
    qp = random_qp(rng)
    solution = Solution(qp)
    solve = solver.open(qp, solution)
    for _ in range(50):
        drift(qp, rng)
        solve()
        assert Verifier(qp, solution, Budget(), curvature(qp)).check().usable
        np.testing.assert_allclose(solution.v, solved(Daqp(), qp).v, atol=1e-5)


@each_solver
def test_solver_follows_a_problem_that_jumps_from_tick_to_tick(
    solver: Solver, rng: np.random.Generator
) -> None:
    qp = random_qp(rng)
    solution = Solution(qp)
    solve = solver.open(qp, solution)
    for _ in range(50):
        copy_into(qp, random_qp(rng))
        solve()
        status = Verifier(qp, solution, Budget(), curvature(qp)).check()
        assert status.usable
        if status is Status.OPTIMAL:
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


def verdict(qp: QP, v: Array, exact: Solution | None = None) -> Status:
    """What becomes of an answer v that its solver calls optimal."""
    solution = Solution(qp)
    if exact is not None:
        solution.multipliers[:] = exact.multipliers
    solution.v[:], solution.status = v, Status.OPTIMAL
    return Verifier(qp, solution, Budget(), curvature(qp)).check()


@pytest.fixture
def lie(rng: np.random.Generator) -> tuple[QP, Solution]:
    """A problem and its true answer, to be falsified."""
    qp = random_qp(rng)
    return qp, solved(Daqp(), qp)


def test_true_answer_is_optimal(lie: tuple[QP, Solution]) -> None:
    qp, exact = lie
    assert verdict(qp, exact.v, exact) is Status.OPTIMAL


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_answer_that_is_not_finite_is_caught(value: float, lie: tuple[QP, Solution]) -> None:
    qp, exact = lie
    exact.v[4] = value
    assert verdict(qp, exact.v, exact) is Status.NOT_FINITE


def test_infinite_answer_without_bounds_is_caught(lie: tuple[QP, Solution]) -> None:
    qp, exact = lie
    qp.lb[:], qp.ub[:], exact.v[4] = -np.inf, np.inf, np.inf
    assert verdict(qp, exact.v, exact) is Status.NOT_FINITE


def inside_the_box(qp: QP) -> QP:
    """Wide bounds and rows, so that a step along the loop rows breaks nothing else."""
    qp.lb[:], qp.ub[:], qp.h[:] = -50.0, 50.0, 500.0
    return qp


def along_the_loop(qp: QP) -> Array:
    """A self-motion of length one: A step = 0."""
    return np.linalg.svd(qp.A)[2][-1]


def test_wrong_answer_called_optimal_is_inaccurate(rng: np.random.Generator) -> None:
    qp = inside_the_box(random_qp(rng))
    exact = solved(Daqp(), qp)
    wrong = exact.v + 1e-3 * along_the_loop(qp)
    assert verdict(qp, wrong, exact) is Status.INACCURATE
    assert verdict(qp, wrong) is Status.INACCURATE  # without multipliers


def test_no_loop_multipliers_make_a_wrong_answer_optimal(rng: np.random.Generator) -> None:
    qp = inside_the_box(random_qp(rng))
    exact = solved(Daqp(), qp)
    for _ in range(50):
        exact.y[:] = rng.normal(scale=10.0, size=M)
        assert verdict(qp, exact.v + 1e-3 * along_the_loop(qp), exact) is Status.INACCURATE


def test_no_row_multipliers_make_a_wrong_answer_optimal() -> None:
    """The minimum of (v - 1)^2 / 2 with v <= 5 is 1; z = 1 on the idle row makes 0 look right."""
    qp = empty_qp(n=1, p=1, m=0)
    qp.q[:], qp.G[:], qp.h[:] = -1.0, 1.0, 5.0
    solution = Solution(qp)
    solution.v[:], solution.z[:], solution.status = 0.0, 1.0, Status.OPTIMAL
    assert Verifier(qp, solution, Budget(), 1.0).check() is Status.INACCURATE


def test_optimal_means_within_the_declared_accuracy_also_at_a_bound() -> None:
    """The minimum of 100 v^2 / 2 - 1000 v with v <= 1 is 1; 1 - 5e-5 is off by 50 accuracies."""
    qp = empty_qp(n=1, p=0, m=0)
    qp.P[:], qp.q[:], qp.ub[:] = 100.0, -1000.0, 1.0
    solution = Solution(qp)
    solution.v[:], solution.status = 1.0 - 5e-5, Status.OPTIMAL
    assert Verifier(qp, solution, Budget(accuracy=1e-6), 100.0).check() is Status.INACCURATE


def test_optimal_means_within_the_declared_accuracy(rng: np.random.Generator) -> None:
    """Answers that are off by about the accuracy, where no bound holds them."""
    seen = set()
    for _ in range(100):
        qp = inside_the_box(random_qp(rng))
        exact = solved(Daqp(), qp)
        off = 10.0 ** rng.uniform(-9, -4)
        status = verdict(qp, exact.v + off * along_the_loop(qp), exact)
        seen.add(status)
        assert off <= Budget().accuracy or status is Status.INACCURATE
    assert seen == {Status.OPTIMAL, Status.INACCURATE}


def test_answer_that_opens_the_loop_is_caught(rng: np.random.Generator) -> None:
    qp = inside_the_box(random_qp(rng))
    exact = solved(Daqp(), qp)
    for row in range(M):
        step = 1e-4 * np.linalg.pinv(qp.A)[:, row]
        assert verdict(qp, exact.v + step, exact) is Status.EQUALITY_RESIDUAL


def test_answer_beyond_a_bound_is_caught(lie: tuple[QP, Solution]) -> None:
    qp, exact = lie
    for j in range(N):
        for beyond in (qp.lb[j] - 1e-4, qp.ub[j] + 1e-4):
            v = exact.v.copy()
            v[j] = beyond
            assert verdict(qp, v, exact) is Status.BOUND_RESIDUAL


def test_answer_beyond_a_row_is_caught(lie: tuple[QP, Solution]) -> None:
    qp, exact = lie
    qp.h[0] = qp.G[0] @ exact.v - 1e-4
    assert verdict(qp, exact.v, exact) is Status.BOUND_RESIDUAL


def test_tiny_overrun_is_clipped_to_the_bound() -> None:
    """The minimum of (v - 3)^2 / 2 with v <= 1 is at the bound; a solver may end 1e-8 beyond."""
    qp = empty_qp(n=2, p=0, m=0)
    qp.q[:], qp.ub[:] = -3.0, 1.0
    solution = Solution(qp)
    solution.v[:], solution.status = 1.0 + 1e-8, Status.OPTIMAL
    assert Verifier(qp, solution, Budget(), 1.0).check() is Status.OPTIMAL
    np.testing.assert_array_equal(solution.v, [1.0, 1.0])


def test_no_answer_lies_between_bounds_that_cross(lie: tuple[QP, Solution]) -> None:
    qp, exact = lie
    qp.ub[3] = exact.v[3]
    qp.lb[3] = exact.v[3] + 1.0
    assert not verdict(qp, exact.v, exact).usable


@pytest.mark.parametrize("where", ["at lb", "at ub", "between"])
def test_no_answer_is_inside_bounds_that_cross_by_more_than_the_budget(where: str) -> None:
    """Not even one that lies on a bound."""
    qp = empty_qp(n=2, p=0, m=0)
    qp.lb[0], qp.ub[0] = 1.0, 1.0 - 1e-3
    v = np.array([{"at lb": 1.0, "at ub": 1.0 - 1e-3, "between": 1.0 - 5e-4}[where], 0.0])
    assert verdict(qp, v) is Status.BOUND_RESIDUAL


def test_residual_of_the_loop_is_that_of_the_clipped_answer() -> None:
    """v_0 = 1 + 9e-7 closes the loop and is beyond its bound of 1: clipped, it is 9e-7 off."""
    qp = empty_qp(n=2, p=0, m=1)
    qp.A[:], qp.b[:], qp.ub[0] = [[1.0, 0.0]], 1.0 + 9e-7, 1.0
    qp.seal()
    solution = Solution(qp)
    solution.v[:], solution.y[:], solution.status = [1.0 + 9e-7, 0.0], -1.0, Status.OPTIMAL
    assert Verifier(qp, solution, Budget(equality=5e-7), 1.0).check() is Status.EQUALITY_RESIDUAL
    assert solution.primal_residual == pytest.approx(9e-7)


def nearly_clashing(rng: np.random.Generator) -> tuple[QP, Array, list[Fraction]]:
    """Two rows that differ by 1e-5 in the joints that no bound holds, so that y is about 1e5.

    Returns the problem, its optimum and y, solved in fractions: v_2 at its bound, v_0 and v_1 from
    the rows, y from the gradient along v_0 and v_1.
    """
    qp = empty_qp(n=3, p=0, m=2)
    a, c = rng.uniform(0.5, 1.0, 2)
    near = a + 1e-5 * rng.uniform(0.5, 1.0)
    qp.P[:], qp.q[:] = DAMPING * np.eye(3), [*rng.uniform(0.5, 1.0, 2), 0.0]
    qp.A[:], qp.b[:] = [[a, c, 0.3], [near, c, -0.4]], rng.uniform(-0.1, 0.1, 2)
    bound = rng.uniform(-0.1, 0.1)
    (a11, a12, a13), (a21, a22, a23) = [[Fraction(x) for x in row] for row in qp.A.tolist()]
    right = [Fraction(qp.b[0]) - a13 * Fraction(bound), Fraction(qp.b[1]) - a23 * Fraction(bound)]
    det = a11 * a22 - a12 * a21
    v = [(right[0] * a22 - a12 * right[1]) / det, (a11 * right[1] - a21 * right[0]) / det]
    g = [Fraction(qp.q[i]) + Fraction(DAMPING) * v[i] for i in (0, 1)]
    y = [(a21 * g[1] - a22 * g[0]) / det, (a12 * g[0] - a11 * g[1]) / det]
    pull = a13 * y[0] + a23 * y[1] + Fraction(DAMPING) * Fraction(bound)
    (qp.lb if pull > 0 else qp.ub)[2] = bound  # the cost pulls v_2 to that side
    qp.seal()
    return qp, np.array([float(v[0]), float(v[1]), bound]), y


DAMPING = 1e-6


def test_the_optimum_is_not_called_inaccurate_for_the_last_digits_of_its_multipliers(
    rng: np.random.Generator,
) -> None:
    """Rounding y = 1e5 alone makes a gradient step of more than the accuracy."""
    steps = []
    for _ in range(100):
        qp, v, y = nearly_clashing(rng)
        solution = Solution(qp)
        solution.v[:], solution.y[:] = v, [float(value) for value in y]
        solution.status = Status.OPTIMAL
        assert Verifier(qp, solution, Budget(), DAMPING).check() is Status.OPTIMAL
        steps.append(solution.dual_residual / DAMPING)
    assert np.median(steps) > Budget().accuracy


def test_rounding_of_huge_multipliers_excuses_no_wrong_answer() -> None:
    """The minimum of |v|^2 with v_0 = 1 twice is (1, 0); y = (1e12, -1e12) cancels exactly."""
    qp = empty_qp(n=2, p=0, m=2)
    qp.P[:], qp.A[:], qp.b[:] = DAMPING * np.eye(2), [[1.0, 0.0], [1.0, 0.0]], 1.0
    qp.seal()
    solution = Solution(qp)
    solution.v[:], solution.y[:] = [1.0, 1e-3], [1e12, -1e12]
    solution.status = Status.OPTIMAL
    assert Verifier(qp, solution, Budget(), DAMPING).check() is Status.INACCURATE


def test_refused_answers_have_no_residuals(lie: tuple[QP, Solution]) -> None:
    """Those of an earlier tick are not left behind."""
    qp, exact = lie
    verifier = Verifier(qp, exact, Budget(), curvature(qp))
    assert verifier.check() is Status.OPTIMAL
    exact.status = Status.INFEASIBLE
    verifier.check()
    assert exact.primal_residual == exact.dual_residual == np.inf


@pytest.mark.parametrize("broken", ["P", "q"])
def test_answer_to_an_objective_that_is_not_a_number_is_not_used(
    broken: str, lie: tuple[QP, Solution]
) -> None:
    qp, exact = lie
    getattr(qp, broken)[2] = np.nan
    solution = Solution(qp)
    solution.v[:], solution.status = exact.v, Status.OPTIMAL
    assert not Verifier(qp, solution, Budget(), 0.1).check().usable


@pytest.mark.parametrize("status", [s for s in Status if not s.usable])
def test_solver_that_gives_up_is_believed(status: Status, lie: tuple[QP, Solution]) -> None:
    qp, exact = lie
    exact.status = status
    assert Verifier(qp, exact, Budget(), 0.1).check() is status


def test_residuals_are_those_of_the_answer(lie: tuple[QP, Solution]) -> None:
    qp, exact = lie
    Verifier(qp, exact, Budget(), curvature(qp)).check()
    assert max(exact.primal_residual, exact.dual_residual) < 1e-9
    exact.v[:] = np.clip(exact.v + 0.01 * along_the_loop(qp), qp.lb, qp.ub)
    Verifier(qp, exact, Budget(), curvature(qp)).check()
    gap = np.linalg.norm(qp.A @ exact.v - qp.b)
    above = max(0.0, float((qp.G @ exact.v - qp.h).max()))
    assert exact.primal_residual == pytest.approx(max(gap, above))
    assert exact.dual_residual > 1e-4


@pytest.mark.parametrize("keys", [{"equality": 0.0}, {"bound": -1.0}, {"accuracy": np.nan}])
def test_budget_of_nothing_is_refused(keys: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(keys))):
        Budget(**keys)
