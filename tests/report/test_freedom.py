"""Condition and manipulability: against finite differences of where the arms carry the object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import scipy.linalg
from chains import Walk
from numpy.typing import NDArray
from scenario_files import cut

import coopqp
from coopqp.base.spec import Pose as PoseValue
from coopqp.closed_loop.mobility import manipulability as mobility_measure
from coopqp.closed_loop.screw import LENGTH
from coopqp.controller import ControlProblem
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.report.curves import Chart
from coopqp.report.figures import object as freedom
from coopqp.report.figures.object import (
    LESS,
    WORST,
    condition,
    freedom_figures,
    left,
    manipulability,
    singular_values,
)
from coopqp.scenario.loader import load
from coopqp.task import Task, TaskStack
from coopqp.tasks import JointCentering, PointOnPoint, Pose

Array = NDArray[np.float64]
POINT = (0.03, -0.02, 0.05)
AT = (0.17, 0.01, 0.06)
STEP = 1e-6  # rad


def problem_of(chain: ClosedChain, *tasks: Task) -> ControlProblem:
    scenario = load("point_on_point")
    return replace(scenario.problem(scenario.schedule[0], chain), tasks=tasks)


def poses(chain: ClosedChain, q: Array) -> list[pin.SE3]:
    data = chain.model.createData()
    pin.framesForwardKinematics(chain.model, data, q)
    return [data.oMf[frame].copy() for frame in chain.frames]


def by_differences(chain: ClosedChain, q: Array, point: Array) -> tuple[Array, Array]:
    """Of one arm's object frame: motions that keep both arms together, and the point's velocity.

    Returns:
        A basis N of the motions, and [velocity of the point; angular velocity] along each.
    """

    def column(dq: Array) -> tuple[Array, Array]:
        (a, b), (c, d) = (poses(chain, q + s * STEP * dq) for s in (-1.0, 1.0))
        apart = [(Y.translation - X.translation) / (2 * STEP) for X, Y in ((a, c), (b, d))] + [
            pin.log3(Y.rotation @ X.rotation.T) / (2 * STEP) for X, Y in ((a, c), (b, d))
        ]
        moved = (c.act(point) - a.act(point)) / (2 * STEP)
        loop = np.concatenate([apart[1] - apart[0], apart[3] - apart[2]])
        return loop, np.concatenate([moved, apart[2]])

    columns = [column(dq) for dq in np.eye(chain.n)]
    loop, motion = (np.array([pair[i] for pair in columns]).T for i in (0, 1))
    N = scipy.linalg.null_space(loop, rcond=1e-6)
    return N, motion @ N


def test_values_are_those_of_differences(chain: ClosedChain, closed_loop_walk: Walk) -> None:
    task = PointOnPoint(goal=AT, point=POINT)
    q = np.array(closed_loop_walk(chain, 4))
    sigma = singular_values(problem_of(chain, task), np.zeros(4), q)
    assert sigma.shape == (4, 3)
    for row, found in zip(q, sigma, strict=True):
        _, motion = by_differences(chain, row, np.array(POINT))
        M = motion[:3]
        expected = np.sqrt(np.linalg.eigvalsh(M @ M.T)[::-1])
        np.testing.assert_allclose(found, expected, rtol=1e-5)
        assert manipulability(found[None])[0] == pytest.approx(
            np.sqrt(np.linalg.det(M @ M.T)), rel=1e-5
        )
        assert condition(found[None])[0] == pytest.approx(np.linalg.cond(M), rel=1e-5)


def test_it_is_the_measure_of_the_mobility_report(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    task = PointOnPoint(goal=AT, point=POINT)
    q = np.array(closed_loop_walk(chain, 3))
    found = manipulability(singular_values(problem_of(chain, task), np.zeros(3), q))
    for row, measure in zip(q, found, strict=True):
        state = State(chain, row)
        tasks = TaskStack([task], state)
        tasks.update(state)
        assert measure == pytest.approx(mobility_measure(chain, row, tasks.J), rel=1e-9)


def test_angles_count_as_lengths_and_what_the_loops_do_not_leave_counts_not(
    chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    """NAO's ten joints less six loop rows leave four of a pose's six rows."""
    (q,) = closed_loop_walk(chain, 1)
    goal = chain.object_pose(q)  # where the error is zero, J is that of the object
    pose = Pose(goal=PoseValue(position=goal.translation, rpy=pin.rpy.matrixToRpy(goal.rotation)))
    sigma = singular_values(problem_of(chain, pose.at_goal()), np.zeros(1), q[None])
    _, motion = by_differences(chain, q, np.zeros(3))
    motion[3:] *= LENGTH
    expected = np.linalg.svd(motion, compute_uv=False)
    assert left(sigma).shape == (1, 4)
    np.testing.assert_allclose(left(sigma)[0], expected, rtol=1e-5)
    assert manipulability(sigma)[0] == pytest.approx(expected.prod(), rel=1e-4)


def test_a_lost_direction_is_zero_manipulability_and_the_worst_condition() -> None:
    sigma = np.array([[2.0, 1.0, 0.0], [2.0, 0.0, 0.0], [np.nan, np.nan, np.nan]])
    np.testing.assert_array_equal(manipulability(sigma), [2.0, 0.0, np.nan])
    np.testing.assert_array_equal(condition(sigma), [2.0, WORST, np.nan])


def test_figures_have_a_line_a_controller_and_say_when_tasks_ask_too_much() -> None:
    scenario = cut(load("point_on_point"), 20)
    comparison = coopqp.compare(scenario, controllers=["qp", "pseudoinverse"])
    problem = scenario.problem(scenario.schedule[0], scenario.chain)
    ratio, product = freedom_figures(Chart(comparison))
    assert (ratio.title, product.title) == ("Condition", "Manipulability")
    for figure, of in ((ratio, condition), (product, manipulability)):
        assert not figure.notes
        for line in figure.data:
            trace = comparison.traces[line["legendgroup"]]
            expected = of(singular_values(problem, trace.t, trace.q))
            np.testing.assert_allclose(line["y"], expected, rtol=1e-6)
    pose = Pose(goal=PoseValue(position=AT), profile=coopqp.Profile(duration=0.1))
    more = coopqp.compare(replace(scenario, tasks=(pose,)), controllers=["qp"])
    assert all(LESS in figure.notes for figure in freedom_figures(Chart(more)))


def test_without_a_task_that_steers_the_object_there_is_no_figure() -> None:
    scenario = replace(cut(load("point_on_point"), 5), tasks=(JointCentering(),), secondary=())
    assert not freedom_figures(Chart(coopqp.compare(scenario, controllers=["qp"])))


def test_an_object_that_cannot_move_has_no_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    """As between arms that the loops hold fast, where M has no columns."""
    comparison = coopqp.compare(cut(load("point_on_point"), 5), controllers=["qp"])
    monkeypatch.setattr(freedom, "null_space", lambda J: np.zeros((J.shape[1], 0)))
    assert not freedom_figures(Chart(comparison))
