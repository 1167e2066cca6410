"""Answers that are believed, and those that are not."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from example_solvers import M, N, curvature, empty_qp, random_qp, solved

from coopqp.base.qp import QP
from coopqp.base.spec import Array
from coopqp.solver import Budget, Solution, Status, Verifier
from coopqp.solvers import Daqp


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


def test_tiny_violation_is_clipped_to_the_bound() -> None:
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


MU = 1e-6  # least curvature: the damping that scenarios have [s2/rad2]


def verdict_on(qp: QP, v: list[float], z: list[float], mu: float = MU) -> Status:
    solution = Solution(qp)
    solution.v[:], solution.z[:], solution.status = v, z, Status.OPTIMAL
    return Verifier(qp, solution, Budget(), mu).check()


def test_no_multiplier_of_the_wrong_sign_makes_a_wrong_answer_optimal() -> None:
    """The minimum of mu (v - 1/2)^2 / 2 with v >= 0 is 1/2; a row that pulls makes 0 look right."""
    qp = empty_qp(1, 1, 0)
    qp.P[:], qp.q[:], qp.G[:], qp.h[:] = MU, -0.5 * MU, -1.0, 0.0
    assert verdict_on(qp, [0.0], [-0.5 * MU]) is not Status.OPTIMAL


def test_no_short_row_makes_a_wrong_answer_optimal() -> None:
    """The minimum of mu (v - 1)^2 / 2 with 1e-6 v <= 0.5e-6 is 1/2; at 0.2 the row is idle."""
    qp = empty_qp(1, 1, 0)
    qp.P[:], qp.q[:], qp.G[:], qp.h[:] = MU, -MU, 1e-6, 0.5e-6
    assert verdict_on(qp, [0.2], [0.8 * MU / 1e-6]) is not Status.OPTIMAL


@pytest.mark.xfail(
    strict=True,
    reason="a projected step bounds nothing where a bound holds one of two stiff joints",
)
def test_optimal_means_within_the_declared_accuracy_beside_a_bound() -> None:
    """v0 is 4e-7 short of its bound, which is excused, and v1 follows it by 3e-4, which is not."""
    qp, a = empty_qp(2, 0, 0), np.sqrt(0.5 * MU)
    qp.P[:], qp.lb[:], qp.ub[:] = [[1.0, a], [a, MU]], -5.0, [0.1, 5.0]
    qp.q[:] = [-10.0, -0.1 * a]  # the minimum is (0.1, 0)
    v0 = 0.1 - 4e-7
    mu = float(np.linalg.eigvalsh(qp.P)[0])
    assert verdict_on(qp, [v0, (0.1 - v0) * a / MU], [], mu) is not Status.OPTIMAL


@pytest.mark.xfail(
    strict=True, reason="the gradient is taken after clipping by 5e-11, which mu makes 5e-5 of"
)
def test_an_answer_clipped_by_its_last_digits_is_still_optimal() -> None:
    """Right to 5e-11; called optimal before 7496501. It hits half of what ProxQP gets right."""
    qp = empty_qp(2, 0, 0)
    qp.P[:], qp.ub[:] = np.ones((2, 2)) + MU * np.eye(2), [0.1, 5.0]
    qp.q[:] = [-10.0, -0.3]
    v0 = 0.1 + 5e-11
    assert verdict_on(qp, [v0, (0.3 - v0) / (1.0 + MU)], []) is Status.OPTIMAL


@pytest.mark.xfail(strict=True, reason="an infinite objective leaves a finite projected step")
def test_an_answer_to_an_infinite_objective_is_not_used() -> None:
    qp = empty_qp(2, 0, 0)
    qp.lb[:], qp.ub[:], qp.q[0] = -1.0, 1.0, np.inf
    assert not verdict_on(qp, [0.0, 0.0], [], 1.0).usable


@pytest.mark.parametrize(("apart", "status"), [(1e-2, Status.OPTIMAL), (1e-9, Status.INACCURATE)])
def test_rows_that_nearly_depend_on_each_other_tell_little(apart: float, status: Status) -> None:
    """v0 = 0 and v0 + apart v1 = 0; both lack 1e-9, for v1 is 1e-9 / apart."""
    qp = empty_qp(2, 0, 2)
    qp.P[:], qp.A[:], qp.b[:] = np.eye(2), [[1.0, 0.0], [1.0, apart]], 0.0
    solution = Solution(qp)
    solution.v[:], solution.status = [0.0, 1e-9 / apart], Status.OPTIMAL
    solution.y[:] = np.linalg.solve(qp.A.T, -solution.v)
    assert Verifier(qp, solution, Budget(), 1.0).check() is status


def test_active_limits_hold_to_the_last_digit_once_polished() -> None:
    """The minimum of |v|^2 / 2 - 5 v0 with v0 = 1 a limit and v0 + v1 = 1 a row is (1, 0)."""
    qp = empty_qp(2, 0, 1)
    qp.P[:], qp.A[:], qp.b[:], qp.ub[0], qp.q[0] = np.eye(2), 1.0, 1.0, 1.0, -5.0
    solution = Solution(qp)
    solution.v[:], solution.status = [1.0 - 1e-8, 0.0], Status.OPTIMAL
    solution.z_box[0] = 4.0 + 1e-8
    verifier = Verifier(qp, solution, Budget(), 1.0)
    assert verifier.polish(verifier.check()) is Status.OPTIMAL
    np.testing.assert_allclose(solution.v, [1.0, 0.0], atol=1e-15)
    assert max(solution.primal_residual, solution.dual_residual) < 1e-15


def test_an_answer_that_is_worse_polished_stays() -> None:
    """The minimum of mu (v - 1/2)^2 / 2 is 1/2; the bound that the solver calls active is far."""
    qp = empty_qp(1, 0, 0)
    qp.P[:], qp.q[:], qp.ub[:] = 1.0, -0.5, 0.5 + 5e-7
    solution = Solution(qp)
    solution.v[:], solution.z_box[:], solution.status = 0.5, 6e-7, Status.OPTIMAL
    verifier = Verifier(qp, solution, Budget(accuracy=2e-7), 1.0)
    assert verifier.polish(verifier.check()) is Status.INACCURATE
    assert solution.v[0] == 0.5


def test_rows_that_nearly_depend_on_an_active_limit_tell_little() -> None:
    """v0 = 1 is a limit and v0 + 1e-4 v1 = 1 a row; it lacks 1e-9, for v1 is 1e-5."""
    qp = empty_qp(2, 0, 1)
    qp.P[:], qp.A[:], qp.b[:], qp.ub[0], qp.q[0] = np.eye(2), [1.0, 1e-4], 1.0, 1.0, -5.0
    solution = Solution(qp)
    solution.v[:], solution.status = [1.0, 1e-5], Status.OPTIMAL
    solution.y[0], solution.z_box[0] = -0.1, 4.1
    assert Verifier(qp, solution, Budget(), 1.0).check() is Status.INACCURATE


def test_a_limit_that_is_exceeded_by_next_to_nothing_counts_without_a_multiplier() -> None:
    """v1 <= 0 and 1e-9 v2 <= v1 leave v2 <= 0 alone; 0.1 exceeds the second by 1e-10 only."""
    qp = empty_qp(n=2, p=2, m=0)
    qp.P[:], qp.q[:] = np.eye(2), [-1.0, -0.1]
    qp.G[:], qp.h[:] = [[1.0, 0.0], [-1.0, 1e-9]], 0.0
    solution = Solution(qp)
    solution.v[:], solution.z[:], solution.status = [0.0, 0.1], [1.0, 0.0], Status.OPTIMAL
    verifier = Verifier(qp, solution, Budget(), 1.0)
    status = verifier.polish(verifier.check())
    assert status is not Status.OPTIMAL or np.abs(solution.v).max() < 1e-9


@pytest.mark.parametrize(("apart", "status"), [(1e-2, Status.OPTIMAL), (1e-9, Status.INACCURATE)])
def test_a_limit_that_is_reached_to_the_last_digits_may_hold_or_not(
    apart: float, status: Status
) -> None:
    """v1 <= 0 and apart v2 = v1 leave v2 <= 0; at 5e-15 / apart both hold but for 5e-15."""
    qp = empty_qp(n=3, p=0, m=1)
    far = 5e-15 / apart
    qp.P[:], qp.q[:], qp.A[:], qp.b[:] = np.eye(3), [-1.0, -far, 0.0], [-1.0, apart, 0.0], 0.0
    qp.lb[:], qp.ub[:] = -1.0, [0.0, 1.0, 1.0]
    solution = Solution(qp)
    solution.v[1], solution.z_box[0], solution.status = far, 1.0, Status.OPTIMAL
    assert Verifier(qp, solution, Budget(), 1.0).check() is status
