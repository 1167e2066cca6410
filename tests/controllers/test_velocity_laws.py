"""Where QP and pseudoinverse must agree, and what each law gives in closed form."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from chains import Walk
from example_controllers import each_controller
from laws import DT, LIMITS, NEAR, STEP, UNREACHABLE, WIDE, answer, distances, problem, run

from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.controller import Controller
from coopqp.controllers import (
    DampedPseudoinverse,
    Pseudoinverse,
    PseudoinverseNullSpace,
    QPController,
)
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.task import Task, TaskStack
from coopqp.tasks import JointCentering, MinimumKineticEnergy, PointOnPlane, PointOnPoint


@pytest.mark.parametrize(
    "task",
    [
        pytest.param(PointOnPoint(goal=NEAR, profile=STEP), id="point"),
        pytest.param(PointOnPlane(normal=(0, 1, 2), through=NEAR, profile=STEP), id="plane"),
    ],
)
def test_without_limits_qp_and_pseudoinverse_move_the_object_alike(
    task: Task, chain: ClosedChain
) -> None:
    """With little damping both give the least joint speed that does the task: one twist."""
    given, J = problem(chain, task), State(chain).J_task
    twist = J @ answer(Pseudoinverse(), given)
    assert np.linalg.norm(twist) > 0.1
    np.testing.assert_allclose(
        J @ answer(QPController(damping=1e-9, error_damping=0.0), given), twist, atol=1e-6
    )


def test_qp_tends_to_the_pseudoinverse_in_proportion_to_its_damping(chain: ClosedChain) -> None:
    given = problem(chain, PointOnPoint(goal=NEAR, profile=STEP))
    exact = answer(Pseudoinverse(), given)
    off = [
        np.abs(answer(QPController(damping=d, error_damping=0.0), given) - exact).max()
        for d in (1e-5, 1e-7)
    ]
    assert off[0] / off[1] == pytest.approx(100, rel=0.05)


def test_qp_with_a_strictly_secondary_objective_is_the_null_space_law(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    """With strict levels only the damping, far below both weights, tells them apart."""
    task = PointOnPoint(goal=NEAR, profile=STEP, weight=1e3, gain=1.0)
    given = problem(chain, task, secondary=[JointCentering()], budget=WIDE)
    for q in closed_loop_walk(chain, 5):
        null_space = answer(PseudoinverseNullSpace(), given, q)
        assert np.abs(null_space - answer(Pseudoinverse(), given, q)).max() > 1e-2
        qp = answer(QPController(damping=1e-9, error_damping=0.0), given, q)
        assert np.abs(qp - null_space).max() < 1e-6 * max(1.0, np.abs(null_space).max())


def test_least_kinetic_energy_as_a_secondary_objective_is_the_inertia_weighted_inverse(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    """The closed form, v = A^-1 H' (H A^-1 H')^-1 b, Khatib's generalised inverse."""
    task = PointOnPoint(goal=NEAR, profile=STEP, weight=1e3, gain=1.0)
    given = problem(chain, task, secondary=[MinimumKineticEnergy(weight=1e4)], budget=WIDE)
    model = ClosedLoopDynamics(chain).model
    for q in closed_loop_walk(chain, 5):
        state = State(chain, q)
        tasks = TaskStack([task], State(chain))
        tasks.update(state)
        H, b = np.vstack([tasks.J, state.J_loop]), np.concatenate([tasks.wanted, np.zeros(6)])
        A_H = np.linalg.solve(pin.crba(model, model.createData(), q), H.T)
        expected = A_H @ np.linalg.solve(H @ A_H, b)
        qp = answer(QPController(damping=1e-9, error_damping=0.0), given, q)
        np.testing.assert_allclose(qp, expected, atol=1e-4)
        # Resting is what this objective asks for by itself, so that Z = 0.
        plain = answer(Pseudoinverse(), given, q)
        assert np.abs(expected - plain).max() > 1e-3  # ten times what may be between them above
        np.testing.assert_allclose(answer(PseudoinverseNullSpace(), given, q), plain, atol=1e-9)


def test_an_objective_of_the_object_moves_it_where_the_tasks_leave_it_free(
    chain: ClosedChain,
) -> None:
    """Z = pinv(J) wanted, projected, closes in on the second point as far as the plane allows."""
    plane = PointOnPlane(normal=(0, 0, 1), through=(0.18, 0, 0.06), profile=STEP)
    given = problem(chain, plane, secondary=[PointOnPoint(goal=NEAR, profile=STEP)])
    state = State(chain)
    for law in (PseudoinverseNullSpace(), QPController(damping=1e-9, error_damping=0.0)):
        v = answer(law, given)
        alone = answer(Pseudoinverse(), given)
        np.testing.assert_allclose(state.J_task[2] @ v, state.J_task[2] @ alone, atol=1e-6)
        way = np.array(NEAR) - state.p_WO
        assert (state.J_task[:2] @ v) @ way[:2] > (state.J_task[:2] @ alone) @ way[:2] + 1e-4


def test_null_space_motion_does_not_disturb_task_or_loop(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    given = problem(
        chain, PointOnPoint(goal=NEAR, profile=STEP), secondary=[JointCentering(gain=50.0)]
    )
    for q in closed_loop_walk(chain, 5):
        with_centering = answer(PseudoinverseNullSpace(), given, q)
        self_motion, state = with_centering - answer(Pseudoinverse(), given, q), State(chain, q)
        assert np.linalg.norm(self_motion) > 0.1
        np.testing.assert_allclose(state.J_task[:3] @ self_motion, 0, atol=1e-12)
        np.testing.assert_allclose(state.J_rel @ self_motion, 0, atol=1e-12)


def test_symmetric_pose_has_no_self_motion_that_centering_could_use(chain: ClosedChain) -> None:
    """Holding a point leaves one antisymmetric self-motion; the pull to the middle is symmetric."""
    given = problem(chain, PointOnPoint(goal=NEAR, profile=STEP), secondary=[JointCentering()])
    pseudo, null_space = (answer(k, given) for k in (Pseudoinverse(), PseudoinverseNullSpace()))
    np.testing.assert_allclose(null_space, pseudo, atol=1e-12)


def test_pseudoinverse_is_the_least_joint_speed_for_the_task(chain: ClosedChain) -> None:
    """Against numpy's least-norm solution of the task and loop rows, eq. (33)."""
    given, state = problem(chain, PointOnPoint(goal=NEAR, profile=STEP)), State(chain)
    rows = np.vstack([state.J_task[:3], state.J_rel])
    wanted = np.concatenate([-5.0 * (state.p_WO - NEAR), np.zeros(6)])
    least = np.linalg.lstsq(rows, wanted)[0]
    np.testing.assert_allclose(answer(Pseudoinverse(), given), least, atol=1e-12)


def test_damped_pseudoinverse_bounds_the_speed_in_every_pose(
    chain: ClosedChain, rng: np.random.Generator
) -> None:
    """|J^#| <= 1 / (2 damping), however singular the pose."""
    given, damping = problem(chain, PointOnPoint(goal=UNREACHABLE, profile=STEP), kappa=0.0), 0.02
    for q in [np.zeros(chain.n), *chain.sample(rng, 20)]:
        wanted = 5.0 * np.linalg.norm(State(chain, q).p_WO - UNREACHABLE)
        v = answer(DampedPseudoinverse(damping=damping), given, q)
        assert np.linalg.norm(v) <= wanted / (2 * damping)


@each_controller
def test_object_nears_the_goal_at_the_tasks_gain(
    controller: Controller, chain: ClosedChain
) -> None:
    """The error shrinks by (1 - gain dt) a tick; damped least squares may lag."""
    given = problem(chain, PointOnPoint(goal=NEAR, profile=STEP, gain=5.0), kappa=1 / DT)
    distance = distances(run(controller, given, 60), NEAR)
    slack = 0.25 if isinstance(controller, DampedPseudoinverse) else 0.01
    np.testing.assert_allclose(
        distance, distance[0] * 0.95 ** np.arange(61), atol=slack * distance[0]
    )


def test_joints_drift_to_the_middle_where_the_task_leaves_them_free(chain: ClosedChain) -> None:
    """Keeping one height leaves three self-motions; they lower the paper's criterion."""
    middle, span = 0.5 * (chain.lower + chain.upper), chain.upper - chain.lower
    here = tuple(State(chain).p_WO.tolist())
    task = PointOnPlane(normal=(0, 0, 1), through=here, profile=STEP, weight=1e3)
    centre = JointCentering(gain=20.0)
    given = problem(chain, task, secondary=[centre], limits=LIMITS, kappa=1 / DT)
    for controller in (QPController(), PseudoinverseNullSpace()):
        q = run(controller, given, 100).q
        phi = np.sum(((q - middle) / span) ** 2, axis=1)
        assert phi[-1] < 0.9 * phi[0]
        assert (np.diff(phi) < 0).all()
        assert State(chain, q[-1]).p_WO[2] == pytest.approx(here[2], abs=1e-5)
