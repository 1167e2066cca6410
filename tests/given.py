"""What many tests need: seeded chance, NAO, NAO with a box in its hands, closed-loop states.

A plug-in, not the conftest, so that the process that only gives work to others does not import it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path

import numpy as np
import pytest
from chains import BOX, HANDS, Hinge, Walk
from laws import DT, LIMITS, UNREACHABLE, problem

from coopqp.base.rank import null_space
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.grasps import Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State
from coopqp.robot import RobotModel
from coopqp.robots import NaoT14
from coopqp.scenario import loader
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import find, shipped
from coopqp.scenario.scenario import Scenario
from coopqp.tasks import PointOnPoint

SEED = 2014
STEPS, STEP = 12, 0.1  # self-motions between two states, and their size [rad]
CLOSED = 1e-13  # largest loop error after the projection [m, rad]
SINGULAR = 1e-8  # share of the largest singular value


def _remembering(load: Callable[..., Scenario]) -> Callable[..., Scenario]:
    """Shipped scenarios are read and checked once a process; nothing in a scenario ever changes.

    So they are by commands too, unless these have plug-ins of a user's own.
    """
    once, places, ordinary = cache(load), set(shipped().values()), Catalog()

    @wraps(load)
    def remembered(path: str | Path, catalog: Catalog | None = None) -> Scenario:
        found = find(path)
        plain = found in places and (catalog is None or catalog == ordinary)
        return once(found) if plain else load(path, catalog)

    return remembered


loader.load = _remembering(loader.load)  # before tests import it


@pytest.fixture
def rng() -> np.random.Generator:
    """The same chance in every run."""
    return np.random.default_rng(SEED)


@pytest.fixture(scope="session")
def nao() -> RobotModel:
    return NaoT14().build()


@pytest.fixture(scope="session")
def chain(nao: RobotModel) -> ClosedChain:
    """NAO holds a box firmly."""
    return ClosedChain.attach(nao, nao.configuration(HANDS), Rigid(), HeldObject())


@pytest.fixture(scope="session")
def hinged(nao: RobotModel, chain: ClosedChain) -> ClosedChain:
    """The same with a hinge in each hand, as in the paper's Table 2."""
    return ClosedChain.attach(nao, chain.q_start, Hinge(), HeldObject())


@pytest.fixture(scope="session")
def hinged_box(nao: RobotModel, chain: ClosedChain) -> ClosedChain:
    """A box whose weight is not in its middle, between two hinges."""
    return ClosedChain.attach(nao, chain.q_start, Hinge(), BOX)


@pytest.fixture(scope="session")
def closed_loop_walk() -> Walk:
    """A function that gives random configurations with all loops closed, inside the limits.

    The same ones for the same chain and count, to be read only.
    """

    @cache
    def walk(chain: ClosedChain, count: int) -> list[Array]:
        rng, state, found = np.random.default_rng(SEED), State(chain), []
        for _ in range(count):
            for _ in range(STEPS):
                _random_self_motion(state, rng)
            found.append(state.q.copy())
            found[-1].flags.writeable = False
        return found

    return walk


def _random_self_motion(state: State, rng: np.random.Generator) -> None:
    """Move along the null space of J_c and back onto the loop; stay if that leaves the limits."""
    chain, before = state.chain, state.q.copy()
    # Projected, so that the step does not depend on the basis, which every processor chooses anew.
    free = null_space(state.J_rel)
    state.q += STEP * free @ (free.T @ rng.normal(size=chain.n))
    if not (_close(state) and np.all((chain.lower < state.q) & (state.q < chain.upper))):
        state.q[:] = before
        state.update()


def _close(state: State) -> bool:
    """Newton's method on the loop error."""
    for _ in range(10):
        state.update()
        if np.abs(state.loop_error).max() < CLOSED:
            return True
        state.q -= np.linalg.pinv(state.J_rel, rcond=SINGULAR) @ state.loop_error
    return False


@pytest.fixture(scope="session")
def reach_too_far(chain: ClosedChain) -> ControlProblem:
    """A goal that NAO cannot reach, within its limits."""
    return problem(chain, PointOnPoint(goal=UNREACHABLE), limits=LIMITS, kappa=1 / DT)
