"""Tasks of the joints: the middle of their ranges, postures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from chains import Hinge
from example_tasks import EXAMPLES, IN_JOINTS, TIMES, H, at, error, over, rows

from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State
from coopqp.robot import RobotModel
from coopqp.task import Task
from coopqp.tasks import JointCentering, JointLimitBarrier, Posture
from coopqp.tasks.posture import posture


@over(IN_JOINTS)
def test_joint_objective_speaks_of_every_joint(task: Task, chain: ClosedChain) -> None:
    stack = rows(task, State(chain))
    assert task.rows(chain) == chain.joint_names
    asked = np.ones(chain.n)
    if isinstance(task, Posture):  # joints without a goal are free
        asked = np.isfinite(posture(task.goal, chain)).astype(float)
    np.testing.assert_array_equal(stack.J, np.diag(asked))
    np.testing.assert_array_equal(stack.rate, np.zeros(chain.n))  # at rest before it sets out


def test_joint_centering_pulls_down_the_slope_of_the_papers_criterion(
    chain: ClosedChain, rng: np.random.Generator
) -> None:
    """The criterion is phi = sum ((q - mid) / range)^2 and e its gradient."""
    middle, span = 0.5 * (chain.lower + chain.upper), chain.upper - chain.lower
    for q in chain.sample(rng, 10):
        e = error(JointCentering(), State(chain, q))
        for joint, unit in enumerate(np.eye(chain.n)):
            after, before = (np.sum(((q + s * H * unit - middle) / span) ** 2) for s in (1, -1))
            assert e[joint] == pytest.approx((after - before) / (2 * H), abs=1e-9)
    np.testing.assert_allclose(error(JointCentering(), State(chain, middle)), 0, atol=1e-15)


def test_joint_limit_barrier_pulls_down_the_slope_of_a_logarithm(
    chain: ClosedChain, rng: np.random.Generator
) -> None:
    """Phi = -1/4 sum log(1 - x^2); near mid-range it is the paper's criterion."""
    middle, half = 0.5 * (chain.lower + chain.upper), 0.5 * (chain.upper - chain.lower)
    width = 0.05

    def phi(q: Array) -> float:
        return float(-0.25 * np.sum(np.log(1.0 - ((q - middle) / half) ** 2)))

    for q in chain.sample(rng, 10):
        q = middle + (1.0 - 2.0 * width) * (q - middle)
        e = error(JointLimitBarrier(width=width), State(chain, q))
        for joint, unit in enumerate(np.eye(chain.n)):
            slope = (phi(q + H * unit) - phi(q - H * unit)) / (2 * H)
            assert e[joint] == pytest.approx(slope, rel=1e-6, abs=1e-8)
    near = middle + 1e-4 * half
    e = error(JointLimitBarrier(), State(chain, near))
    np.testing.assert_allclose(e, error(JointCentering(), State(chain, near)), rtol=1e-6)


def test_joint_limit_barrier_keeps_its_slope_at_the_limit_and_beyond(chain: ClosedChain) -> None:
    middle, half = 0.5 * (chain.lower + chain.upper), 0.5 * (chain.upper - chain.lower)
    at = [error(JointLimitBarrier(), State(chain, middle + x * half)) for x in (0.95, 1.0, 3.0)]
    np.testing.assert_allclose(at[1], at[0], rtol=1e-9)
    np.testing.assert_allclose(at[2], at[0], rtol=1e-9)
    back = error(JointLimitBarrier(), State(chain, middle - half))
    np.testing.assert_allclose(back, -at[0], rtol=1e-9)


def test_posture_error_is_the_way_left_to_the_reference(
    chain: ClosedChain, rng: np.random.Generator
) -> None:
    goal = np.array([0.1 * i for i in range(10)])
    for t in TIMES:
        q = chain.sample(rng, 1)[0]
        x = min(max((t - 0.3) / 2.0, 0.0), 1.0)
        share = 10 * x**3 - 15 * x**4 + 6 * x**5
        stack = rows(EXAMPLES["whole posture"], at(chain, q, t))
        reference = chain.q_start + share * (goal - chain.q_start)
        np.testing.assert_allclose(stack.e, q - reference, atol=1e-14)
        after, before = (error(EXAMPLES["whole posture"], at(chain, q, t + h)) for h in (H, -H))
        np.testing.assert_allclose(-stack.rate, (after - before) / (2 * H), atol=1e-7)


def test_posture_leaves_joints_alone_that_it_does_not_name(chain: ClosedChain) -> None:
    """Those named come by arm or by joint; a list has all."""
    q = chain.q_start + 0.1
    stack = rows(EXAMPLES["posture"], at(chain, q, 5.0))
    named = [i for i, n in enumerate(chain.joint_names) if n[0] == "R" or n == "LElbowRoll"]
    others = [i for i in range(chain.n) if i not in named]
    assert np.abs(stack.e[named]).min() > 0.01
    np.testing.assert_array_equal(stack.e[others], 0.0)
    np.testing.assert_array_equal(stack.rate[others], 0.0)


@pytest.mark.parametrize(
    ("goal", "match"),
    [
        ({"RElbowRol": 0.1}, "did you mean 'RElbowRoll'"),
        ({"right": [0.1]}, "needs 5"),
        ([0.0] * 9, "needs 10"),
    ],
)
def test_posture_of_another_robot_is_refused(goal: Any, match: str, chain: ClosedChain) -> None:
    with pytest.raises(CoopqpError, match=match):
        rows(Posture(goal=goal), State(chain))


def test_joint_without_limits_is_left_alone(nao: RobotModel, chain: ClosedChain) -> None:
    hinged = ClosedChain.attach(nao, chain.q_start, Hinge(), HeldObject())
    q = np.full(hinged.n, 0.3)
    e = error(JointCentering(), State(hinged, q))
    np.testing.assert_array_equal(e[hinged.passive], [0.0, 0.0])
    assert np.isfinite(e).all()
