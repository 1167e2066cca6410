"""The observer of the surroundings' wrench, on rigid bodies that are pushed while they move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import coopqp
from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.profile import Profile
from coopqp.model.state import Memory, State
from coopqp.plant import Disturbance, Push
from coopqp.torque_law.hand_wrenches import MomentumObserver
from coopqp.trace import Trace

FORCE, BEGIN, GAIN = np.array([0.6, 0.0, -0.8]), 0.3, 50.0  # [N], [s], [1/s]


@pytest.fixture(scope="module")
def pushed() -> Trace:
    """NAO carries the box on its way and is pushed by 1 N; the controller is not told."""
    scenario = coopqp.load("passive_grasp_pose")
    push = Push(force=tuple(FORCE), start=BEGIN, duration=1.0)
    tasks = tuple(replace(task, profile=Profile(duration=0.6)) for task in scenario.tasks)
    short = replace(scenario, duration=0.6, tasks=tasks, disturbance=Disturbance(push=push))
    return coopqp.run(short, controller="torque_qp")


def observed(trace: Trace, held: HeldObject | None = None) -> Array:
    """The wrench after each tick, shape (T, 6)."""
    scenario = coopqp.load("passive_grasp_pose")
    chain = replace(scenario, held=held or scenario.held).chain
    dynamics = ClosedLoopDynamics(chain)
    observer = MomentumObserver(dynamics, gain=GAIN, dt=trace.dt)
    state, found = State(chain, memory=Memory(observer.memory_sizes)), []
    at_rest, before = np.zeros((1, chain.n)), np.zeros((1, chain.n))
    for q, v, tau in zip(
        trace.q,
        np.vstack([at_rest, trace.v]),
        np.vstack([before, trace.signals["tau"]]),
        strict=True,
    ):
        dynamics.update(q, v)
        state.q[:], state.v[:], state.memory["observer.tau"][:] = q, v, tau
        found.append(observer.update(state).copy())
    return np.array(found[1:])


def test_a_push_is_told_within_five_per_cent_after_three_time_constants(pushed: Trace) -> None:
    found, t = observed(pushed), pushed.t[1:]
    before, late = t <= BEGIN, t >= BEGIN + 3.0 / GAIN
    size = np.linalg.norm(FORCE)
    assert np.abs(found[before, :3]).max() < 0.02 * size
    assert np.linalg.norm(found[late, :3] - FORCE, axis=1).max() < 0.05 * size + 1e-3
    # After one time constant it is at 63 %.
    once = int(np.argmin(np.abs(t - BEGIN - 1.0 / GAIN)))
    assert found[once, :3] @ FORCE / size**2 == pytest.approx(1.0 - np.exp(-1.0), abs=0.05)


def test_a_wrong_mass_is_told_as_a_force(pushed: Trace) -> None:
    """Two per cent of 0.2 kg that are not there, m g: the model is what it goes by."""
    box = coopqp.load("passive_grasp_pose").held
    right, wrong = observed(pushed), observed(pushed, replace(box, mass=0.98 * box.mass))
    told = (wrong - right)[-1, :3]
    assert told == pytest.approx([0.0, 0.0, -0.02 * box.mass * 9.81], abs=0.005)


def test_gains_that_overshoot_are_refused(pushed: Trace) -> None:
    chain = coopqp.load("passive_grasp_pose").chain
    with pytest.raises(InvalidValueError, match=r"at most 1/dt = 500 1/s"):
        MomentumObserver(ClosedLoopDynamics(chain), gain=600.0, dt=0.002)
