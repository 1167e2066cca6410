"""End stops: joints stay where they end, and what pushes on them squeezes the object."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import coopqp
from coopqp.assessment import assess
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.execution.comparison import summarize
from coopqp.metrics.internal_force import InternalForce
from coopqp.model.closed_chain import ClosedChain
from coopqp.plants import Mujoco, RigidBody
from coopqp.plants.rigid_body import STOP_ANGLE, EndStops
from coopqp.scenario.scenario import Scenario
from coopqp.trace import Trace

PLANTS = {"rigid_body": RigidBody, "mujoco": Mujoco}


def on(plant: str, *, stops: bool = True) -> Scenario:
    if plant == "mujoco":
        pytest.importorskip("mujoco")
    return replace(coopqp.load("point_on_point"), plant=PLANTS[plant](end_stops=stops))


@cache
def carried(plant: str, controller: str, *, stops: bool = True) -> Trace:
    return coopqp.run(on(plant, stops=stops), controller=controller)


def beyond(trace: Trace) -> float:
    return float(np.maximum(trace.lower - trace.q, trace.q - trace.upper).max())


def squeeze(trace: Trace) -> float:
    force = InternalForce().measure(trace)
    assert force is not None
    return force["end"]


@pytest.mark.full
@pytest.mark.few(1)
@pytest.mark.parametrize("plant", PLANTS)
def test_the_pseudoinverse_is_stopped_where_the_qp_does_not_go(plant: str) -> None:
    """Without stops it gets there, through them; with stops it ends off, and squeezes."""
    ghost = carried(plant, "pseudoinverse", stops=False)
    assert beyond(ghost) > 0.1
    assert assess(ghost).errors[0] < 1e-3
    stopped = carried(plant, "pseudoinverse")
    assert beyond(stopped) < 3.0 * STOP_ANGLE, "other joints push it too"
    assert assess(stopped).errors[0] > 0.01
    saturated = (stopped.signals["saturated"].max(axis=1) > 0.0).mean()
    assert 0.4 < saturated < 0.7
    assert squeeze(stopped) > 5.0
    kept = carried(plant, "qp")
    assert assess(kept).errors[0] < 1e-3
    assert squeeze(kept) < 0.1


def test_both_plants_agree_on_where_it_ends() -> None:
    ends = [carried(plant, "pseudoinverse") for plant in PLANTS]
    np.testing.assert_allclose(ends[0].position[-1], ends[1].position[-1], atol=2e-3)
    assert squeeze(ends[0]) == pytest.approx(squeeze(ends[1]), rel=0.1)


def test_the_qp_reaches_its_goal_on_rigid_bodies() -> None:
    trace = carried("rigid_body", "qp")
    found = summarize(on("rigid_body"), {"qp": trace}).metrics["qp"]
    assert found["reached"]
    assert max(found["loop_error_max"].values()) < 1e-9
    np.testing.assert_allclose(trace.position[-1], [0.13, 0.05, 0.03], atol=5e-4)


def test_runs_on_rigid_bodies_tell_torques_and_energy() -> None:
    for controller in ("qp", "pseudoinverse"):
        trace = carried("rigid_body", controller)
        assert trace.signals["tau"].shape == (trace.ticks, 10)
        assert trace.signals["energy"].shape == (trace.ticks, 2)
        assert np.all(np.abs(trace.signals["tau"]) <= trace.effort)
        assert np.all(trace.signals["energy"][:, 0] >= 0)


def test_full_torque_presses_a_joint_in_by_the_stop_angle(chain: ClosedChain) -> None:
    stops, dynamics = EndStops(chain, 1e-3), ClosedLoopDynamics(chain)
    still = np.zeros(chain.n)
    dynamics.update(chain.q_start, still)
    stops.update(dynamics)
    pressed = stops.torque(chain.upper + STOP_ANGLE, still)
    effort = chain.model.effortLimit
    assert (pressed <= 0.0).all()
    assert (-pressed <= effort * (1.0 + 1e-12)).all()
    assert np.isclose(-pressed, effort).sum() >= chain.n // 2, "unless the step asks for less"
    np.testing.assert_array_equal(stops.torque(chain.upper - 1e-9, still), still)
    np.testing.assert_array_equal(stops.torque(chain.lower + 1e-9, still), still)


def test_a_stop_only_pushes_back(chain: ClosedChain) -> None:
    stops, dynamics = EndStops(chain, 1e-3), ClosedLoopDynamics(chain)
    dynamics.update(chain.q_start, np.zeros(chain.n))
    stops.update(dynamics)
    for speed in (-10.0, -0.1, 0.1, 10.0):
        v = np.full(chain.n, speed)
        assert (stops.torque(chain.upper + 1e-3, v) <= 0.0).all()
        assert (stops.torque(chain.lower - 1e-3, v) >= 0.0).all()


def test_a_joint_that_starts_beyond_its_limit_has_its_stop_there(chain: ClosedChain) -> None:
    q = chain.upper + 0.2
    stops, dynamics = EndStops(chain.moved(q), 1e-3), ClosedLoopDynamics(chain)
    dynamics.update(chain.q_start, np.zeros(chain.n))
    stops.update(dynamics)
    np.testing.assert_array_equal(stops.torque(q, np.zeros(chain.n)), np.zeros(chain.n))
