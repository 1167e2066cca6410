"""Admittance without a plant: its limits, its gain, one tick of it, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from laws import DT, problem
from pads import line, scenario_pads, squeezed
from scipy.optimize import brentq

import coopqp
from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.closed_loop.admittance import GROWN, Admittance, stability_limit
from coopqp.controller import Law
from coopqp.controllers import QPController
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.plant import PlantModel
from coopqp.plants import RigidBody
from coopqp.solver import Status
from coopqp.tasks import InternalWrench, PointOnPoint

WANTED, STIFF = 10.0, 1e4  # [N], [N/m]
SETTINGS = Admittance(stiffness=STIFF, lag=0.01, delay=1)


def law_of(chain: ClosedChain, engine: Any = "python", **settings: Any) -> Law:
    """It keeps the object where it is and squeezes it."""
    x, y, z = chain.start_position
    asked = problem(chain, PointOnPoint(goal=(x, y, z)), wrenches=[InternalWrench(squeeze=WANTED)])
    pressed = replace(SETTINGS, **settings)
    return QPController(engine=engine, admittance=pressed).build(asked)


def closing(law: Law, state: State) -> Array:
    """Velocity with which the last command brings the second hand to the first."""
    return -np.asarray(state.J_rel[:3] @ law.command.v, float)


def radius(reach: float, delay: int) -> float:
    """Largest eigenvalue of F[n+1] = F[n] - g k dt F[n - delay]."""
    shift = np.eye(delay + 1, k=-1)
    shift[0, 0] += 1.0
    shift[0, delay] -= reach
    return float(np.abs(np.linalg.eigvals(shift)).max())


@pytest.mark.parametrize(
    ("delay", "limit"), [(0, 2.0), (1, 1.0), (2, 0.618), (3, 0.445), (7, None)]
)
def test_the_limit_is_where_an_eigenvalue_leaves_the_unit_circle(
    delay: int, limit: float | None
) -> None:
    found = brentq(lambda reach: radius(reach, delay) - 1.0, 0.05, 3.0, xtol=1e-12)
    assert stability_limit(delay) == pytest.approx(found, rel=1e-6)
    assert limit is None or found == pytest.approx(limit, abs=5e-4)


@pytest.mark.parametrize("lag", [0.0, 0.005, 0.03])
@pytest.mark.parametrize("delay", [0, 1, 2, 5])
@pytest.mark.parametrize("softer", [1.0, 3.0, 10.0])
def test_the_default_gain_does_not_overshoot(lag: float, delay: int, softer: float) -> None:
    """Of a spring behind a servo of first order, in a model that is not the loop."""
    gain = Admittance(stiffness=STIFF, lag=lag, delay=delay).gain_of(DT, 1.0 / DT)
    kept = np.exp(-DT / lag) if lag else 0.0  # of the servo's distance, in a tick
    force = told = way = 0.0
    late = [0.0] * delay
    most = 0.0
    for _ in range(int(20.0 * softer * (lag + (delay + 1) * DT) / DT)):
        late.append(gain * (WANTED - force))
        told += DT * late.pop(0)
        way = told + kept * (way - told)
        force = STIFF / softer * way
        most = max(most, force)
    assert most <= 1.0001 * WANTED
    assert force == pytest.approx(WANTED, rel=0.02)


@pytest.mark.parametrize("force", [0.0, 4.0, 10.0, 25.0])
def test_hands_approach_as_fast_as_force_is_missing(chain: ClosedChain, force: float) -> None:
    law = law_of(chain)
    state = law.start(q_measured=chain.q_start, hand_wrench=squeezed(chain, force))
    assert law.tick(state).causes == (Status.OPTIMAL,)
    gain = 0.2 / (STIFF * (0.01 + 2.0 * DT))
    assert closing(law, state) == pytest.approx(gain * (WANTED - force) * line(state), abs=1e-9)


def test_they_approach_no_faster_and_no_farther_than_they_may(chain: ClosedChain) -> None:
    law = law_of(chain, gain=1e-3, stiffness=1e3, most_speed=2e-3, most_way=5e-5)
    state = law.start(q_measured=chain.q_start, hand_wrench=squeezed(chain, 0.0))
    for way in (2e-5, 4e-5, 5e-5, 5e-5):
        state.advance(law.tick(state).v, DT)
        assert -line(state) @ state.loop_offset[:3] == pytest.approx(way, rel=1e-3)
    assert law.command.causes == (Status.SQUEEZE_GIVEN_UP,)
    assert "stands at most_way, 0.05 mm closer" in law.command.note
    assert "is the force sensor alive?" in law.command.note
    state.hand_wrench = squeezed(chain, WANTED)  # what is wanted is there
    assert law.tick(state).causes == (Status.OPTIMAL,)
    assert law.command.note == ""


LOST = {
    "no hand_wrench has come; needs 12 numbers": None,
    "no finite number at 0, 1": np.full(12, np.nan),
    "found shape (6,), needs (12,)": np.zeros(6),
    "found shape (13,), needs (12,)": np.zeros(13),
    "found shape (2, 6), needs (12,)": np.zeros((2, 6)),
    "found a text, needs numbers": "wrist",
    "found 1e+09, beyond any hand": np.full(12, 1e9),
}


@pytest.mark.parametrize("words", LOST)
def test_a_lost_force_stops_the_hands_where_they_are(chain: ClosedChain, words: str) -> None:
    law = law_of(chain)
    state = law.start(q_measured=chain.q_start, hand_wrench=squeezed(chain, 0.0))
    state.advance(law.tick(state).v, DT)
    before = state.loop_offset.copy()
    lost: Any = LOST[words]
    state.q_measured, state.hand_wrench = state.q.copy(), lost
    assert law.tick(state).causes == (Status.FORCE_NOT_MEASURED,)
    assert words in law.command.note
    assert closing(law, state) == pytest.approx(np.zeros(3), abs=1e-5)  # of 3 mm/s before
    assert state.loop_offset == pytest.approx(before, abs=1e-9)
    state.hand_wrench = squeezed(chain, 0.0)
    assert law.tick(state).causes == (Status.OPTIMAL,)
    assert line(state) @ closing(law, state) > 1e-3


def test_what_is_measured_teaches_nothing_along_the_squeeze(chain: ClosedChain) -> None:
    """Across it the loop offset follows the measured joints, as it does without a squeeze."""
    law = law_of(chain)
    state = law.start(q_measured=chain.q_start, hand_wrench=squeezed(chain, WANTED))
    e, begun = line(state), state.loop_offset.copy()
    state.q_measured = chain.q_start + 0.01
    law.tick(state)
    other = State(chain, chain.q_start + 0.01)
    learnt, seen = state.loop_offset - begun, other.loop_error - begun
    assert e @ learnt[:3] == pytest.approx(0.0, abs=1e-12)
    across = np.eye(3) - np.outer(e, e)
    assert learnt[:3] == pytest.approx(across @ seen[:3] * DT / 0.15, abs=1e-9)
    assert learnt[3:] == pytest.approx(seen[3:] * DT / 0.15, abs=1e-9)
    assert np.abs(learnt).max() > 1e-6


def test_the_squeeze_turns_with_the_object(chain: ClosedChain) -> None:
    law = law_of(chain)
    state = law.start(q_measured=chain.q_start, hand_wrench=squeezed(chain, WANTED))
    state.loop_offset[:3] = -0.004 * line(state)
    law.tick(state)
    old = line(state)
    turned = {"right": [0.7, -0.1, 1.2, 0.9, 0.1], "left": [0.7, 0.3, -1.2, -0.9, -0.1]}
    state.q[:] = chain.robot.configuration(turned)
    state.update()
    state.q_measured, state.hand_wrench = state.q.copy(), None
    law.tick(state)
    assert line(state) @ old < 0.999
    assert state.loop_offset[:3] == pytest.approx(-0.004 * line(state), abs=1e-5)


def test_the_kernel_decides_the_same(chain: ClosedChain) -> None:
    found = []
    for engine in ("python", "auto"):
        law = law_of(chain, engine)
        state = law.start(q_measured=chain.q_start, hand_wrench=squeezed(chain, 0.0))
        for _ in range(5):
            command = law.tick(state)
            state.advance(command.v, DT)
            state.q_measured = state.q.copy()
        found.append((state.q.copy(), state.loop_offset.copy()))
    assert found[0][0] == pytest.approx(found[1][0], abs=1e-8)
    assert found[0][1] == pytest.approx(found[1][1], abs=1e-8)


@pytest.mark.parametrize(
    ("wrench", "changed", "words"),
    [
        ({"squeeze": 5.0, "twist": 0.0}, {}, "asks for more than a squeeze"),
        ({"shear_up": 5.0}, {}, "asks for more than a squeeze"),
        ({"squeeze": 5.0, "mode": "hard"}, {}, "converges over time"),
        ({"squeeze": 5.0}, {"kappa": 0.0}, "kappa is 0"),
    ],
)
def test_what_admittance_cannot_do_is_refused(
    wrench: dict[str, Any], changed: dict[str, Any], words: str, chain: ClosedChain
) -> None:
    asked = problem(chain, wrenches=[InternalWrench(**wrench)], **changed)
    with pytest.raises(InvalidValueError, match=words):
        QPController(admittance=SETTINGS).build(asked)


def test_a_force_without_a_stated_stiffness_is_refused(chain: ClosedChain) -> None:
    asked = problem(chain, wrenches=[InternalWrench(squeeze=5.0)])
    with pytest.raises(InvalidValueError, match="state how stiff hands and servos are"):
        QPController().build(asked)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_gain_beyond_the_limit_is_refused(delay: int, chain: ClosedChain) -> None:
    asked = problem(chain, wrenches=[InternalWrench(squeeze=5.0)])
    most = stability_limit(delay) / (STIFF * DT)
    for share in (0.99, 1.01):
        settings = Admittance(stiffness=STIFF, delay=delay, gain=share * most)
        if share < 1.0:
            QPController(admittance=settings).build(asked)
            continue
        with pytest.raises(InvalidValueError, match="is unstable"):
            QPController(admittance=settings).build(asked)


def test_a_plant_that_tells_no_forces_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = replace(
        coopqp.load("point_on_point"),
        tasks=(InternalWrench(squeeze=5.0),),
        controllers={"qp": QPController(admittance=SETTINGS)},
        plant=RigidBody(),
    )
    monkeypatch.setattr(PlantModel, "hand_wrench", None)
    with pytest.raises(InvalidValueError, match="this plant tells none"):
        coopqp.run(scenario, controller="qp")


@pytest.mark.parametrize(("most", "grows_to"), [(None, 12.0), (10.5, 10.5)])
def test_hands_that_are_about_to_slip_press_more(most: float | None, grows_to: float) -> None:
    """Coulomb: 4.8 N along pads of friction 0.5 need 9.6 N, of which 80 % are 12 N."""
    chain = scenario_pads("point_on_point", 0.5, 0.02, friction=0.5, most=most)
    law, along, asked = law_of(chain), 4.8, 0.0
    state = law.start()
    for _ in range(200):
        told = squeezed(chain, WANTED + asked).reshape(-1, 6)
        told[:, 2] += along
        state.hand_wrench = told.ravel()
        law.tick(state)
        asked = float(state.memory[GROWN][0])
    assert WANTED + asked == pytest.approx(grows_to, rel=0.12)
    assert WANTED + asked <= (most or 12.0) + 1e-9
    assert most or along / (0.5 * (WANTED + asked)) <= 0.9
