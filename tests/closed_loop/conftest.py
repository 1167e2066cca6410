"""NAO with a box whose weight is not in its middle, and states with its loops closed."""

from __future__ import annotations

import pytest
from chains import BOX, PAPER_SCHEME, Closed, closed_states

from coopqp.closed_loop.mobility import Mobility, mobility
from coopqp.grasps import Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.robot import RobotModel

STATES = 1000


@pytest.fixture(scope="session")
def box_chain(nao: RobotModel, chain: ClosedChain) -> ClosedChain:
    """NAO holds a box whose weight is not in its middle."""
    return ClosedChain.attach(nao, chain.q_start, Rigid(), BOX)


@pytest.fixture(scope="session")
def states(box_chain: ClosedChain) -> list[Closed]:
    return closed_states(box_chain, STATES)


@pytest.fixture(scope="session")
def hinged_states(hinged_box: ClosedChain) -> list[Closed]:
    return closed_states(hinged_box, 20)


@pytest.fixture(scope="session")
def firm(chain: ClosedChain) -> Mobility:
    return mobility(chain, requested=PAPER_SCHEME)
