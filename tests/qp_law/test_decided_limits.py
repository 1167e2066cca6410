"""Limits that later levels hardly move give way step by step, not at once."""

import laws
import numpy as np

from coopqp.model.closed_chain import ClosedChain
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.equations import Damping
from coopqp.qp_law.level import Given, Step
from coopqp.qp_law.priorities import Order
from coopqp.task import TaskStack


def test_a_limit_gives_way_continuously_as_its_share_vanishes(chain: ClosedChain) -> None:
    """Joint 0 slows down along a direction that moves joint 1, at its bound, by a small share."""
    problem = laws.problem(chain)
    start = Order(problem).start
    bounds = Bounds((), start, laws.DT)
    bounds.lb[1] = 0.0
    damping = Damping(base=1.0, share=0.0, dt=laws.DT)
    step = Step(Given(problem, bounds, damping), TaskStack((), start))
    v = np.eye(chain.n)[0]

    def slowed(share: float) -> float:
        direction = v.copy()
        direction[1] = share
        assert step.step(v, direction[None], 1.0).usable
        assert step.v[1] == 0.0
        return 1.0 - step.v[0]

    found = np.array([slowed(share) for share in np.geomspace(1e-8, 1e-6, 2000)])
    assert np.allclose(found[:400], 1.0)
    assert np.allclose(found[-900:], 0.0)
    assert np.abs(np.diff(found)).max() < 0.05
