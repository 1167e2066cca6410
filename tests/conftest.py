"""What many tests need: seeded chance, NAO, NAO with a box in its hands, closed-loop states."""

from __future__ import annotations

import gc
import signal
from collections import Counter
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chains import BOX, HANDS, Hinge, Walk
from laws import DT, LIMITS, UNREACHABLE, problem

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.controller import ControlProblem
from coopqp.grasps import Rigid
from coopqp.held_object import HeldObject
from coopqp.rank import null_space
from coopqp.robot import RobotModel
from coopqp.robots import NaoT14
from coopqp.scenario import loader
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import find, shipped
from coopqp.scenario.scenario import Scenario
from coopqp.state import State
from coopqp.tasks import PointOnPoint

SEED = 2014
#: Files that take longest, in this order, so that no process is alone with one of them at the end.
LONGEST = (
    "viewer/test_in_a_browser.py",
    "plants/test_rigid_body.py",
    "controllers/test_passive_grasp.py",
    "study/test_stress_wide.py",
    "study/test_sweep_kept.py",
    "plants/test_pressing_hands.py",
    "controllers/test_torque_margins.py",
    "report/test_playback.py",
    "plants/test_kinematic_errors.py",
    "online/test_real_time.py",
    "recordings/test_every_format.py",
    "viewer/test_play_command.py",
    "controllers/test_impedance.py",
    "study/test_engine.py",
    "study/test_misled_runs.py",
    "border/test_reports_are_whole.py",
    "kernel/test_core.py",
    "study/test_stress_with_masses.py",
    "study/test_repeated_ticks.py",
    "online/test_recording.py",
    "report/test_hands.py",
    "plants/test_phases.py",
    "test_gallery.py",
)
STEPS, STEP = 12, 0.1  # self-motions between two states, and their size [rad]
CLOSED = 1e-13  # largest loop error after the projection [m, rad]
SINGULAR = 1e-8  # share of the largest singular value


def pytest_configure(config: pytest.Config) -> None:
    """Let Ctrl-C be heard by commands under test, which a shell's background has deaf to it."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _remembering(load: Callable[..., Scenario]) -> Callable[..., Scenario]:
    """Shipped scenarios are read and checked once a process; nothing in a scenario ever changes."""
    once, places = cache(load), set(shipped().values())

    @wraps(load)
    def remembered(path: str | Path, catalog: Catalog | None = None) -> Scenario:
        found = find(path)
        return once(found) if catalog is None and found in places else load(path, catalog)

    return remembered


loader.load = _remembering(loader.load)  # before tests import it


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Begin with the longest files where several processes share them, then those of many tests."""
    if not hasattr(config, "workerinput"):
        return
    here = Path(__file__).parent
    tests = Counter(item.path for item in items)
    places = {here / name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: (places.get(item.path, len(LONGEST)), -tests[item.path]))


def pytest_collection_finish() -> None:
    """What was imported and collected stays: the garbage collector need not look at it again.

    Nor at the rest after every 700 objects, which takes it 3 % of the time.
    """
    gc.freeze()
    gc.set_threshold(50_000)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> object:
    """All tests of a file in one process, so that what they share is made once."""
    from xdist.scheduler import LoadFileScheduling

    config.option.loadscopereorder = False  # the order is that of pytest_collection_modifyitems
    return LoadFileScheduling(config, log)


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
    return ClosedChain.take_hold(nao, nao.configuration(HANDS), Rigid(), HeldObject())


@pytest.fixture(scope="session")
def hinged(nao: RobotModel, chain: ClosedChain) -> ClosedChain:
    """The same with a hinge in each hand, as in the paper's Table 2."""
    return ClosedChain.take_hold(nao, chain.q_start, Hinge(), HeldObject())


@pytest.fixture(scope="session")
def hinged_box(nao: RobotModel, chain: ClosedChain) -> ClosedChain:
    """A box whose weight is not in its middle, between two hinges."""
    return ClosedChain.take_hold(nao, chain.q_start, Hinge(), BOX)


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
