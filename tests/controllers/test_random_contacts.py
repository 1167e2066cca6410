"""Random ticks of hands that press: what the torque QP says it keeps, it keeps."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from chains import closed_states
from laws import problem
from pads import friction_for, pressing

from coopqp.base.errors import GraspError
from coopqp.base.spec import Array
from coopqp.controllers import TorqueQp
from coopqp.controllers.torque_qp import TorqueQpLaw
from coopqp.grasps.surface_contact import NEAR
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.solver import Status
from coopqp.tasks import PointOnPoint

PROBLEMS, STATES, DT = 40, 25, 0.002
KEPT = 1e-6  # [N]
#: What a tick may say of itself when it did not do all that was asked.
NAMED = {Status.TASKS_RELAXED, Status.CONTACT_GIVEN_UP, Status.INFEASIBLE, Status.INACCURATE}


def law_of(rng: np.random.Generator, chain: ClosedChain) -> TorqueQpLaw | None:
    """Random mass, friction, pads, safety and goal; None where it is refused."""
    mass, friction = rng.uniform(0.05, 0.5), rng.uniform(0.2, 1.0)
    held = pressing(chain, mass, rng.uniform(0.01, 0.04), friction=friction)
    goal = held.start_position + rng.uniform(-0.05, 0.05, 3)
    reach = PointOnPoint(
        goal=tuple(goal), gain=rng.uniform(2.0, 60.0), profile=Profile(kind="step")
    )
    try:
        law = TorqueQp(safety=rng.uniform(1.0, 2.0)).build(problem(held, reach, dt=DT, kappa=50.0))
    except GraspError:
        return None
    assert isinstance(law, TorqueQpLaw)
    return law


def coulomb_keeps(law: TorqueQpLaw, h: Array, R_WO: Array, safety: float) -> bool:
    """Whether round cones at the corners bear what each hand does."""
    for hand, did in zip(law.hands.hands, h.reshape(-1, 6), strict=True):
        assert hand.contact
        R = (R_WO @ hand.X_OC.rotation).T
        needed = friction_for(hand.contact, np.concatenate([R @ did[:3], R @ did[3:]]))
        if needed > hand.contact.friction / safety * (1.0 + 1.2 * NEAR):
            return False
    return True


@pytest.mark.full
def test_cones_and_motors_are_kept_in_random_ticks_or_it_is_said(chain: ClosedChain) -> None:
    rng, seen, refused = np.random.default_rng(16), Counter[str](), 0
    states = closed_states(chain, STATES)
    for _ in range(PROBLEMS):
        law = law_of(rng, chain)
        if law is None:
            refused += 1
            continue
        effort = law.problem.chain.model.effortLimit
        for q, v in states:
            state = law.start(q)
            state.v[:] = 0.2 * v
            command = law.tick(state)
            assert command.tau is not None
            assert (np.abs(command.tau) <= effort + 1e-9).all()
            seen[command.status.name] += 1
            if command.causes != (Status.OPTIMAL,):
                assert set(command.causes) <= NAMED
                continue
            h = law.solution.v[law.layout.h]
            assert (law.hands.cones @ h <= law.hands.upper + KEPT).all()
            assert not law.solution.v[law.layout.sigma].any()
            if seen["OPTIMAL"] % 5 == 0:
                assert coulomb_keeps(law, h, state.R_WO, law.settings.safety)
    assert seen["OPTIMAL"] > 0.5 * sum(seen.values())
    assert sum(seen.values()) == (PROBLEMS - refused) * STATES
    assert refused < PROBLEMS / 2
