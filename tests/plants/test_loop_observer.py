"""The offset of loops where servos sag and grips yield: what is felt, learnt and bounded."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pinocchio as pin
import pytest

import coopqp
from coopqp.base.errors import UnknownNameError
from coopqp.base.rank import null_space
from coopqp.closed_loop.hands import hands, points
from coopqp.controller import Law
from coopqp.controllers import QPController
from coopqp.model import loop_observer
from coopqp.model.loop_observer import LoopObserver, Observer, WeightSag
from coopqp.model.state import State
from coopqp.plant import Disturbance, PlantModel, Slip
from coopqp.plants import QuasiStatic
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status

K, MASS, G = 60.0, 0.6, 9.81
ERRORS = Disturbance(grasp_offset=1e-3, encoder_offset=3e-3)
FIRM = QuasiStatic(stiffness=K, object_compensated=0.0)
CREEPS = replace(FIRM, grip=5e3, creep=5e3)
KNOWN = Observer(stiffness=K)


def scenario(plant: QuasiStatic, observer: Observer, off: Disturbance = ERRORS) -> Scenario:
    given = coopqp.load("point_on_point")
    (task,) = given.tasks
    near = replace(task, goal=(0.15, 0.03, 0.035), profile=replace(task.profile, duration=1.0))
    held = replace(given.held, mass=MASS)
    changed = replace(given, tasks=(near,), secondary=(), held=held, plant=plant)
    return replace(changed, disturbance=off, observer=observer)


def run(
    given: Scenario, seconds: float, engine: Literal["auto", "python"] = "auto"
) -> tuple[Law, PlantModel, State, list[float]]:
    """Until then, and how far the hands' forces differ in each tick."""
    problem = given.problem()
    law = QPController(engine=engine).build(problem)
    plant = given.plant.build(problem, given.seed, given.disturbance)
    state, force = law.start(q_measured=plant.measured), []
    for _ in range(round(seconds / given.dt)):
        plant.step(state, law.tick(state))
        one, other = plant.signals["hand_wrench"].reshape(2, 6)[:, :3]
        force.append(0.5 * float(np.linalg.norm(one - other)))
    return law, plant, state, force


def test_the_sag_is_that_of_springs_under_half_the_weight_each() -> None:
    """By pinocchio's Jacobians at the hands' points; the loops open as finite differences say."""
    chain = scenario(FIRM, KNOWN).chain
    state, data = State(chain), chain.model.createData()
    state.update()
    sag = WeightSag(chain, np.identity(chain.n) / K)
    sag.update(state)
    pin.computeJointJacobians(chain.model, data, state.q)
    pin.updateFramePlacements(chain.model, data)
    torque = np.zeros(chain.n)
    at = points(hands(chain), state.p_WO, state.R_WO)
    for frame, p in zip(chain.frames, at, strict=True):
        J = pin.getFrameJacobian(chain.model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        lever = p - data.oMf[frame].translation
        torque += 0.5 * (J[:3] - pin.skew(lever) @ J[3:]).T @ np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(sag.sag, -torque / K, atol=0.02 * np.abs(torque / K).max())
    opened = (chain.loop_error(state.q + 1e-4 * sag.sag) - chain.loop_error(state.q)) / 1e-4
    np.testing.assert_allclose(sag.opened, opened, atol=1e-3 * np.abs(opened).max())


def test_what_a_squeeze_bends_is_no_sag() -> None:
    chain = scenario(FIRM, KNOWN).chain
    state, sag = State(chain), WeightSag(chain, np.identity(chain.n) / K)
    state.update()
    along = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    sag.update(state, along)
    bent = -20.0 / K * (along @ state.J_rel)
    sag.straighten(bent)
    np.testing.assert_allclose(bent, 0.0, atol=1e-12)
    assert sag.load(5.0 * sag.sag) == pytest.approx(5.0)


def test_joints_that_sag_far_feel_a_load_only_in_its_shape() -> None:
    """A wall that holds one joint back is no weight; 0.9 by squares leave cos(15 degrees)."""
    chain = scenario(FIRM, KNOWN).chain
    state, sag = State(chain), WeightSag(chain, np.identity(chain.n) / K)
    state.update()
    sag.update(state)
    j = int(np.abs(sag.sag).argmax())
    load = 0.04 / np.abs(sag.sag[j])
    assert sag.load(load * sag.sag) == pytest.approx(load)
    held = load * sag.sag * (np.arange(chain.n) == j)
    assert math.isnan(sag.load(held))
    assert math.isfinite(sag.load(0.4 * held))


def test_servos_that_act_by_inertia_sag_by_its_inverse() -> None:
    chain = scenario(FIRM, KNOWN).chain
    observer = LoopObserver(chain, 0.01, Observer(inertial_stiffness=250.0))
    state = State(chain)
    state.update()
    observer.begin(state)
    state.q[:] += 0.1
    state.update()
    state.q_measured = state.q.copy()
    observer.update(state)
    M = pin.crba(chain.model, chain.model.createData(), state.q)
    M = np.triu(M) + np.triu(M, 1).T
    of = observer.flat()
    driven = np.setdiff1d(np.arange(chain.n), chain.passive)
    at = np.ix_(driven, driven)
    np.testing.assert_allclose(250.0 * M[at] @ of["sag"][driven], -of["torque"][driven])


@pytest.mark.parametrize("times", [1.0, 3.0])
@pytest.mark.parametrize("friction", [0.0, 0.03])
def test_servos_that_act_by_inertia_tell_of_a_load_while_it_moves(
    times: float, friction: float
) -> None:
    """Of another load than is told, soon, beside lag and friction; also where readings miss."""
    chain, dt, stiffness = scenario(FIRM, KNOWN).chain, 0.01, 250.0
    state, data = State(chain), chain.model.createData()
    state.update()
    sticks = friction / (stiffness * pin.crba(chain.model, data, state.q).diagonal())
    band = dict(zip(chain.joint_names, sticks.tolist(), strict=True))
    observer = LoopObserver(chain, dt, Observer(inertial_stiffness=stiffness, dead_band=band))
    observer.begin(state)
    state.v[:] = null_space(state.J_loop)[:, 0]
    for k in range(60):
        state.v[:] = null_space(state.J_loop) @ (null_space(state.J_loop).T @ state.v)
        state.v *= 0.4 / np.abs(state.v).max()
        state.q[:] += dt * state.v
        state.update()
        M = pin.crba(chain.model, data, state.q)
        compliance = np.linalg.inv(np.triu(M) + np.triu(M, 1).T) / stiffness
        sag = WeightSag(chain, compliance)
        sag.update(state)
        behind = 0.04 * state.v + compliance @ (friction * np.sign(state.v))
        behind -= times * MASS * G * sag.sag
        state.q_measured = None if k in (10, 20) else state.q - behind
        observer.update(state)
    assert observer.load == pytest.approx(times * MASS * G, abs=0.4 * MASS * G)


@pytest.mark.parametrize("enabled", [True, False])
@pytest.mark.parametrize("share", [0.0, 0.7, 1.0])
def test_joints_are_judged_by_all_of_the_load_fed_forward_or_not(
    enabled: bool, share: float
) -> None:
    chain = scenario(FIRM, KNOWN).chain
    given = Observer(stiffness=K, enabled=enabled, object_compensated=share)
    observer, state = LoopObserver(chain, 0.01, given), State(chain)
    state.update()
    observer.begin(state)
    state.q_measured = state.q.copy()
    observer.update(state)
    sag = WeightSag(chain, np.identity(chain.n) / K)
    sag.update(state)
    np.testing.assert_allclose(observer.sag(state), MASS * G * sag.sag, atol=1e-12)


@pytest.mark.parametrize("settings", [Observer(stiffness=K), Observer(inertial_stiffness=250.0)])
@pytest.mark.parametrize("reading", [None, [0.0], "no joints"])
def test_what_is_no_reading_teaches_no_load(settings: Observer, reading: object) -> None:
    chain = scenario(FIRM, KNOWN).chain
    observer, state = LoopObserver(chain, 0.01, settings), State(chain)
    state.update()
    observer.begin(state)
    before, state.q_measured = state.observer_state[0], reading  # type: ignore[assignment]
    for _ in range(10):
        observer.update(state)
    assert state.observer_state[0] == before


def test_weight_that_is_fed_forward_makes_nothing_sag() -> None:
    """And what makes it sag is the rest; the load is all of it."""
    fed, off = replace(FIRM, object_compensated=0.8), replace(ERRORS, object_mass=1.5)
    law, _, state, _ = run(scenario(fed, Observer(stiffness=K, object_compensated=0.8), off), 5.0)
    assert law.observer.load == pytest.approx(1.5 * MASS * G, rel=0.05)
    assert state.observer_state[0] == pytest.approx(0.7 * MASS * G, rel=0.1)


@pytest.mark.parametrize("times", [1.0, 1.5])
def test_the_load_is_felt_whatever_the_scenario_says(times: float) -> None:
    law, *_ = run(scenario(FIRM, KNOWN, replace(ERRORS, object_mass=times)), 5.0)
    assert law.observer.load == pytest.approx(times * MASS * G, rel=0.05)


def test_unknown_servos_have_no_load_and_are_unloaded_all_the_same() -> None:
    law, _, state, _ = run(scenario(FIRM, Observer()), 5.0)
    assert math.isnan(law.observer.load)
    assert K * state.observer_state[0] == pytest.approx(MASS * G, rel=0.05)  # K is believed to be 1


@pytest.mark.few(2)
@pytest.mark.parametrize("plant", [FIRM, CREEPS], ids=["firm", "creeps"])
@pytest.mark.parametrize("observer", [KNOWN, Observer()], ids=["known", "felt"])
def test_hands_do_not_pull_and_the_loop_offset_comes_to_rest(
    plant: QuasiStatic, observer: Observer
) -> None:
    state = run(scenario(plant, observer), 8.0)[2]
    law, _, later, more = run(scenario(plant, observer), 10.0)
    assert np.mean(more[-50:]) < 0.05 * MASS * G
    assert np.linalg.norm(later.loop_offset[:3] - state.loop_offset[:3]) < 1e-4
    assert law.observer.at_bound == ()


def weak_wrists() -> QuasiStatic:
    """Creeping grips, and wrists and elbows that are half as stiff as the shoulders."""
    names = scenario(FIRM, KNOWN).chain.joint_names
    stiffness = {name: K if "Shoulder" in name else 0.5 * K for name in names}
    return replace(CREEPS, stiffness=stiffness)


def test_a_grip_that_creeps_is_not_wound_up_by_servos_of_another_stiffness() -> None:
    *_, none = run(scenario(weak_wrists(), Observer(enabled=False)), 8.0)
    _, _, state, force = run(scenario(weak_wrists(), Observer()), 8.0)
    _, _, later, _ = run(scenario(weak_wrists(), Observer()), 10.0)
    assert np.mean(force[-50:]) < np.mean(none[-50:]) + 0.01 * MASS * G
    assert np.linalg.norm(later.loop_offset - state.loop_offset) < 1e-5


def test_a_position_stays_while_the_rotation_is_at_its_bound() -> None:
    law, _, state, _ = run(scenario(weak_wrists(), Observer(most=0.003)), 8.0)
    _, _, later, _ = run(scenario(weak_wrists(), Observer(most=0.003)), 10.0)
    assert law.observer.at_bound == ("left",)
    assert np.linalg.norm((later.loop_offset - state.loop_offset)[:3]) < 1e-5


def test_a_loop_offset_that_stays_moves_when_something_happens_to_the_hands() -> None:
    slips = replace(ERRORS, slip=Slip(at=6.0, by=5e-3))
    _, _, state, _ = run(scenario(weak_wrists(), Observer(), slips), 6.0)
    _, _, later, force = run(scenario(weak_wrists(), Observer(), slips), 9.0)
    assert np.linalg.norm((later.loop_offset - state.loop_offset)[:3]) > 1e-3
    assert np.mean(force[-50:]) < 0.1 * max(force[600:])


@pytest.mark.parametrize("observer", [KNOWN, Observer()], ids=["known", "felt"])
def test_what_happens_to_hands_at_rest_is_followed_sooner(
    observer: Observer, monkeypatch: pytest.MonkeyPatch
) -> None:
    slips = replace(ERRORS, slip=Slip(at=3.0, by=5e-3))
    *_, force = run(scenario(FIRM, observer, slips), 3.5)
    monkeypatch.setattr(loop_observer, "SOONEST", 1.0)
    *_, later = run(scenario(FIRM, observer, slips), 3.5, "python")
    assert max(force[300:]) < 0.9 * max(later[300:])


def test_noise_is_not_followed_sooner() -> None:
    noisy = replace(ERRORS, noise_position=2e-3)
    law, _, state, _ = run(scenario(FIRM, KNOWN, noisy), 3.0)
    share, rng = law.observer._share, np.random.default_rng(0)
    sooner = [
        law.observer._learns(rng.normal(size=(2, 3)), state.observer_state[1]) for _ in range(1000)
    ]
    assert np.mean(np.array(sooner[30:]) > 1.01 * loop_observer.SOONER * share) < 0.002


def test_an_observer_of_the_sag_alone_pulls(monkeypatch: pytest.MonkeyPatch) -> None:
    """The law without the sag ends with d / S between the hands, and winds up where grips creep."""
    _, _, _, force = run(scenario(FIRM, KNOWN), 6.0)
    nothing = lambda observer, state, along, rests: 0.0  # noqa: E731
    monkeypatch.setattr(LoopObserver, "_unload", nothing)
    _, _, _, pulled = run(scenario(FIRM, KNOWN), 6.0, "python")
    assert np.mean(pulled[-50:]) > 5.0 * np.mean(force[-50:])


def test_a_change_beyond_the_bound_is_named() -> None:
    slips = replace(ERRORS, slip=Slip(at=0.5, by=0.015))
    law = run(scenario(FIRM, replace(KNOWN, most=0.005), slips), 2.0)[0]
    assert law.observer.at_bound == ("left",)
    assert Status.OFFSET_AT_BOUND in law.command.causes
    assert "between left and right has changed by 5 mm" in law.command.note


def test_a_disabled_observer_keeps_what_it_began_with() -> None:
    _, _, state, _ = run(scenario(FIRM, Observer(enabled=False)), 0.5)
    begun = run(scenario(FIRM, Observer()), 0.01)[2].observer_state[2:]
    np.testing.assert_allclose(state.loop_offset, begun, atol=1e-12)


def test_a_copied_state_feels_the_same() -> None:
    _, _, state, _ = run(scenario(FIRM, KNOWN), 0.5)
    np.testing.assert_array_equal(copy.deepcopy(state).observer_state, state.observer_state)


def test_a_joint_that_there_is_not_is_refused() -> None:
    given = scenario(FIRM, Observer(stiffness={"RElbowRol": 100.0}))
    with pytest.raises(UnknownNameError, match="RElbowRoll") as caught:
        given.controllers["qp"].build(given.problem())
    assert caught.value.keys == ("observer", "stiffness", "RElbowRol")


def test_a_file_says_it_and_a_loop_may_say_otherwise(tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(coopqp.load("point_on_point").source + "observer: {stiffness: 80.0}\n")
    loop = coopqp.OnlineLoop(coopqp.load(file), clock=None)
    assert loop.law.observer.settings == Observer(stiffness=80.0)
    off = coopqp.OnlineLoop(coopqp.load(file), clock=None, observer=Observer(enabled=False))
    assert not off.law.observer.settings.enabled
    assert '"enabled": false' in off.source
