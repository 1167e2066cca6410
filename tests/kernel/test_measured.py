"""Ticks with measured joints: the kernel learns what the observer in Python learns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from side_by_side import needs_kernel

import coopqp
from coopqp.controller import Law
from coopqp.controllers import QPController
from coopqp.kernel import native
from coopqp.kernel.law import KernelLaw
from coopqp.limits import FollowingError
from coopqp.model import loop_observer
from coopqp.model.loop_observer import LoopObserver, Observer
from coopqp.model.state import State
from coopqp.online.following import NOISE, SINGULAR
from coopqp.solver import Status

pytestmark = needs_kernel

TICKS, BOUND = 150, 1e-4
SCENARIOS = ("point_on_point", "two_pandas", "three_ur", "tiago_torso")


class InPython(LoopObserver):
    """The same, which the kernel does not know."""


def law(name: str, observer: Observer, kind: type[LoopObserver], *limits: object) -> KernelLaw:
    given = coopqp.load(name)
    problem = replace(given, observer=observer, limits=(*given.limits, *limits)).problem()
    made = QPController(engine="kernel").build(problem)
    assert isinstance(made, KernelLaw)
    made.observer = kind(problem.chain, problem.dt, observer)
    return made


def told(one: Law, state: State) -> np.ndarray:
    """What a tick commands and learns."""
    return np.concatenate([
        one.command.v, state.loop_offset, state.observer_state, state.drift, state.loop_error,
        state.p_WO, [one.observer.load, one.observer.doubt, one.command.scale, one.command.drift],
        *one.observer.flat()["stalled"],
    ])  # fmt: skip


@pytest.mark.few(6)
@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("observer", [
    Observer(most=0.1), Observer(stiffness=80.0, most=0.1), Observer(stiffness=80.0, most=BOUND),
    Observer(enabled=False), Observer(most=0.1, dead_band=2e-3),
    Observer(most=0.1, inertial_stiffness=300.0, object_compensated=0.5, dead_band=2e-4),
], ids=["felt", "known", "at bound", "disabled", "dead band", "by inertia"])  # fmt: skip
def test_what_is_learnt_is_what_python_learns(
    name: str, observer: Observer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Joints that sag, with noise and lag, and sensors that fail now and then; short spans."""
    monkeypatch.setattr(loop_observer, "SPAN", 0.05)
    rng = np.random.default_rng(3)
    laws = [law(name, observer, kind) for kind in (LoopObserver, InPython)]
    states = [one.start(q_measured=one.problem.chain.q_start) for one in laws]
    n, dt = laws[0].problem.chain.n, laws[0].problem.dt
    off, lagging = 3e-3 * rng.standard_normal(n), states[0].q.copy()
    by_python, update = [], laws[0].observer.update
    laws[0].observer.update = lambda *given: by_python.append(1) or update(*given)  # type: ignore[func-returns-value, method-assign]
    for k in range(TICKS):
        lagging += 0.3 * (states[0].q - lagging)
        reading = lagging + off * min(1.0, k * dt) + 2e-4 * rng.standard_normal(n)
        reading[k % n] = np.nan if k % 37 == 5 else reading[k % n]
        given = reading.tolist() if k % 29 == 7 else reading if k % 31 else None
        for one, state in zip(laws, states, strict=True):
            state.q_measured = given  # type: ignore[assignment]
            state.corrected = 0.5 if k % 41 == 11 else state.corrected
            one.observer.paused = k % 43 > 38
            one.tick(state)
        assert laws[0].command.causes == laws[1].command.causes
        np.testing.assert_allclose(
            told(laws[0], states[0]), told(laws[1], states[1]), rtol=1e-9, atol=1e-11
        )
        np.testing.assert_allclose(
            states[0].loop_offset, states[1].loop_offset, rtol=0.0, atol=1e-12
        )
        for one, state in zip(laws, states, strict=True):
            state.advance(0.0 * one.command.v if k > 110 else one.command.v, dt)
    assert len(by_python) < 0.5 * TICKS or observer.most == BOUND
    if observer.enabled:
        assert states[0].loop_offset.any()


def test_a_tick_without_an_answer_has_learnt_once() -> None:
    """Python then decides, and does not learn a second time."""
    laws = [law("point_on_point", Observer(), kind) for kind in (LoopObserver, InPython)]
    found = []
    for one in laws:
        state = one.start(q_measured=one.problem.chain.q_start)
        state.q_measured = state.q + 1e-3
        one.tick(state)
        state.q_measured = state.q + 2e-3
        state.q[3] = one.problem.chain.upper[3] + 0.3  # no recovery keeps the loops
        state._commanded[:] = state.q
        one.tick(state)
        found.append(told(one, state))
    assert not laws[0].compiled
    np.testing.assert_allclose(found[0], found[1], atol=1e-11)


def test_an_unusual_reading_takes_nothing_back() -> None:
    """Of what the tick before has learnt, in an array that the kernel has read before."""
    one = law("point_on_point", Observer(), LoopObserver)
    state = one.start(q_measured=one.problem.chain.q_start)
    state.q_measured = reading = state.q + 1e-3
    for _ in range(3):
        one.tick(state)
    loop_offset, felt = state.loop_offset.copy(), state.observer_state.copy()
    reading[2] = np.nan
    assert Status.NOT_MEASURED in one.tick(state).causes
    np.testing.assert_array_equal(state.loop_offset, loop_offset)
    np.testing.assert_array_equal(state.observer_state, felt)


def test_a_joint_that_was_overwritten_is_told() -> None:
    one = law("point_on_point", Observer(), LoopObserver)
    state = one.start(q_measured=one.problem.chain.q_start)
    state.q_measured = state.q.copy()
    state.advance(one.tick(state).v, one.problem.dt)
    assert one.tick(state).causes == (Status.OPTIMAL,)
    state.q[0] += 1e-3
    assert Status.OVERWRITTEN in one.tick(state).causes


def test_what_was_felt_may_be_put_back() -> None:
    """As from a record: an array of the same numbers is learnt on, one of others is refused."""
    laws = [law("point_on_point", Observer(most=1.0), kind) for kind in (LoopObserver, InPython)]
    states = [one.start(q_measured=one.problem.chain.q_start) for one in laws]
    for one, state in zip(laws, states, strict=True):
        state.q_measured = state.q + 3e-3
        for _ in range(20):
            one.tick(state)
        state.observer_state = state.observer_state.copy()
        state.observer_state[0] += 3.0
        one.tick(state)
    first, second = (told(*both) for both in zip(laws, states, strict=True))
    np.testing.assert_allclose(first, second, rtol=0.0, atol=1e-11)
    states[0].observer_state = states[0].observer_state[:-1].copy()
    assert laws[0].tick(states[0]).causes == (Status.WRONG_STATE,)


def test_readings_that_are_no_real_numbers_bound_nothing() -> None:
    n = len(law("point_on_point", Observer(), LoopObserver).problem.chain.q_start)
    for given in (np.ones(n) * 1j, "joints", ["a"] * n, np.ma.masked_all(n), [None] * n):
        for kind in (LoopObserver, InPython):
            one = law("point_on_point", Observer(), kind, FollowingError(max=1e-3))
            state = one.start(q_measured=one.problem.chain.q_start)
            alone = law("point_on_point", Observer(), kind)
            state.q_measured = given  # type: ignore[assignment]
            assert one.tick(state).causes == (Status.NOT_MEASURED,)
            np.testing.assert_allclose(one.command.v, alone.tick(alone.start()).v, atol=1e-9)


def test_a_limit_of_following_is_the_kernels() -> None:
    """It binds where the readings stay behind, and only while there are any."""
    most = FollowingError(max=1e-3)
    laws = [law("point_on_point", Observer(), kind, most) for kind in (LoopObserver, InPython)]
    states = [one.start(q_measured=one.problem.chain.q_start) for one in laws]
    behind = states[0].q.copy()
    for k in range(40):
        for one, state in zip(laws, states, strict=True):
            state.q_measured = behind if k < 30 else None
            one.tick(state)
            assert one.compiled
        np.testing.assert_allclose(laws[0].command.v, laws[1].command.v, atol=1e-11)
        for one, state in zip(laws, states, strict=True):
            state.advance(one.command.v, one.problem.dt)
        if k < 30:
            assert np.abs(states[0].q - behind).max() < 1e-3 + 1e-9
    assert np.abs(states[0].q - behind).max() > 1.1e-3


@pytest.mark.few(3)
@pytest.mark.parametrize(("n", "m"), [(10, 6), (14, 6), (56, 42), (6, 3), (6, 8), (5, 1)])
def test_what_internal_wrenches_leave_is_that_of_lapack(n: int, m: int) -> None:
    """With parallel columns, and rows of very different size; at rest all variances are alike."""
    rng, found = np.random.default_rng(n), native.module()
    assert found
    still, own = (np.zeros((5, n)), np.zeros((5, n))), list(range(n))
    samples = found.Samples(*still, own, [], 1, 1, [1, 2], 4, [1.0] * n, 0.02, 7, 0.01, 0.0)
    for _ in range(4):
        samples.add(np.zeros(n), np.zeros(n))
    for case in range(20):
        A = rng.standard_normal((n, m)) * 10.0 ** rng.uniform(-0.1 * case, 0.1 * case, (n, 1))
        A[:, m // 2] = A[:, 0]
        W = np.empty(n * n)
        d = samples.whiten(2, 0, A.T.copy(), np.zeros((m, n)), np.zeros(n), W)
        V, wanted, _ = np.linalg.svd(A)
        rank = int(np.sum(wanted > SINGULAR * wanted[0]))
        assert d == n - rank
        W = NOISE * W[: n * d].reshape(n, d)
        np.testing.assert_allclose(W.T @ W, np.eye(d), atol=1e-12)
        np.testing.assert_allclose(W @ W.T, V[:, rank:] @ V[:, rank:].T, atol=1e-9)
