"""What linear cones cost against round ones: a share of ``benchmarks/cones.py``."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chains import closed_states
from laws import problem
from pads import pressing

from coopqp.controllers import TorqueQp
from coopqp.controllers.torque_qp import TorqueQpLaw
from coopqp.grasps import PointContact, SurfaceContact
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.solver import Status
from coopqp.tasks import PointOnPoint

STATES = 15


@pytest.fixture(scope="module")
def bench() -> Iterator[Any]:
    pytest.importorskip("clarabel")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
        yield importlib.import_module("cones")


def fingertip(pads: ClosedChain) -> ClosedChain:
    """The same with a point for the first pad."""
    first, pad = next(iter(pads.grasps.items()))
    assert isinstance(pad, SurfaceContact)
    tip = PointContact(normal=pad.normal, along=pad.along, friction=pad.friction)
    held = replace(pads.held, pose=None)
    return ClosedChain.attach(pads.robot, pads.q_start, {**pads.grasps, first: tip}, held)


def law_of(chain: ClosedChain) -> TorqueQpLaw:
    goal = tuple(chain.start_position + np.array([0.0, 0.01, 0.02]))
    task = PointOnPoint(goal=goal, gain=10.0, profile=Profile(kind="step"))
    law = TorqueQp().build(problem(chain, task, dt=0.002, kappa=50.0))
    assert isinstance(law, TorqueQpLaw)
    return law


@pytest.mark.parametrize(("point", "torsion"), [(False, 1.0), (False, 0.5), (True, 1.0)])
def test_the_cost_lies_between_those_of_round_cones(
    bench: Any, chain: ClosedChain, point: bool, torsion: float
) -> None:
    """Round cones with all of the friction cost less, and those inside the linear ones more.

    Soft pads are 2 cm from the mass, so that their yaw is what they lack.
    """
    held = pressing(chain, 0.2, 0.02, torsion=torsion)
    if torsion < 1.0:
        aside = replace(held.held, com=(0.02, 0.0, 0.0), pose=None)
        held = ClosedChain.attach(held.robot, held.q_start, held.grasps, aside)
    held = fingertip(held) if point else held
    law, compared, dear = law_of(held), 0, 0
    for q, v in closed_states(held, STATES):
        state = law.start(q)
        state.v[:] = 0.1 * v
        if law.tick(state).causes != (Status.OPTIMAL,):
            continue
        found = bench.costs(law, state)
        assert np.isfinite([found.round, found.narrow, found.free]).all()
        assert found.between
        compared += 1
        dear += found.loss > 0.01
    assert compared > STATES // 2
    assert dear  # the comparison can tell: somewhere the linear cones do cost
