"""The gradient of the manipulability against its differences."""

from __future__ import annotations

import numpy as np
import pytest
from chains import Walk, three_arms
from example_tasks import error

from coopqp.base.spec import Array
from coopqp.grasps import Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State
from coopqp.robots import PlanarPair
from coopqp.task import TaskStack
from coopqp.tasks import Manipulability


def manipulability(state: State, axes: list[int]) -> tuple[float, float]:
    """The volume of the object's velocities with the loops closed, and its scale, by SVD."""
    _, sizes, basis = np.linalg.svd(state.J_rel)
    free = basis[np.sum(sizes > 1e-8 * sizes[0]) :].T
    sizes = np.linalg.svd(state.J_task[axes] @ free)[1]
    return float(np.prod(sizes)), float(np.mean(sizes**2) ** (0.5 * len(axes)))


@pytest.mark.parametrize("axes", ["xyz", "xy", "z"])
def test_manipulability_climbs_its_gradient(
    axes: str, chain: ClosedChain, closed_loop_walk: Walk, rng: np.random.Generator
) -> None:
    kept = ["xyz".index(axis) for axis in axes]
    _, scale = manipulability(State(chain), kept)
    task = Manipulability(axes=tuple(axes))  # type: ignore[arg-type]
    for q in [*closed_loop_walk(chain, 3), *chain.sample(rng, 3)]:
        e = error(task, State(chain, q))
        # m / m_0 up to three, then its logarithm, with the same slope at three.
        m = manipulability(State(chain, q), kept)[0]
        slope = min(1.0 / scale, 3.0 / m)
        for joint, unit in enumerate(np.eye(chain.n)):
            after, before = (
                manipulability(State(chain, q + h * unit), kept)[0] for h in (1e-6, -1e-6)
            )
            assert e[joint] == pytest.approx(-(after - before) / 2e-6 * slope, abs=2e-6)


def test_manipulability_stays_finite_where_there_is_none(rng: np.random.Generator) -> None:
    """A planar robot cannot rise: with z it has no gradient, without it has one."""
    robot = PlanarPair().build()
    q = robot.configuration({"right": [0.3, 0.6, 0.4], "left": [-0.3, -0.6, -0.4]})
    planar = ClosedChain.attach(robot, q, Rigid(), HeldObject())
    for q in (planar.q_start, np.zeros(planar.n), *planar.sample(rng, 5)):
        state = State(planar, q)
        assert np.abs(error(Manipulability(), state)).max() < 1e-3
        assert np.isfinite(error(Manipulability(axes=("x", "y")), state)).all()
    q = planar.q_start
    e = error(Manipulability(axes=("y", "x")), State(planar))
    _, scale = manipulability(State(planar), [0, 1])
    for joint, unit in enumerate(np.eye(planar.n)):
        after, before = (
            manipulability(State(planar, q + h * unit), [0, 1])[0] for h in (1e-6, -1e-6)
        )
        assert e[joint] == pytest.approx(-(after - before) / 2e-6 / scale, abs=1e-5)


@pytest.mark.xfail(strict=True, reason="open loops still count as closed in the manipulability")
@pytest.mark.parametrize("released", [["left"], ["right", "left"]])
def test_manipulability_forgets_the_loops_that_are_open(released: list[str]) -> None:
    three = three_arms()
    chain = three.handed_over(three.q_start, released)
    stack = TaskStack([Manipulability(name="m")], State(chain))
    stack.update(State(chain))

    def measure(q: Array) -> float:
        state = State(chain, q)
        J, C = state.J_task[:3], state.J_loop
        free = J - J @ np.linalg.pinv(C) @ C if len(C) else J
        return float(np.sqrt(np.linalg.det(free @ free.T)))

    h = 1e-6 * np.eye(chain.n)
    slope = [(measure(chain.q_start + d) - measure(chain.q_start - d)) / 2e-6 for d in h]
    along = -stack.e @ slope / np.linalg.norm(stack.e) / np.linalg.norm(slope)
    assert along == pytest.approx(1.0, abs=1e-6)
