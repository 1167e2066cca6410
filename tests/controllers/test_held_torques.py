"""What the torque QP foresees of a tick in which torques are held, against rigid bodies."""

from __future__ import annotations

import numpy as np
from laws import problem
from pads import pressing

from coopqp.base.spec import Array
from coopqp.closed_loop.hands import into_contacts
from coopqp.controllers import TorqueQp
from coopqp.controllers.torque_qp import TorqueQpLaw
from coopqp.execution.rollout import drive
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.plant import Disturbance
from coopqp.plants import RigidBody
from coopqp.solver import Status
from coopqp.tasks import PointOnPoint
from coopqp.torque_law.program import AHEAD

TICKS = 40


def turned(law: TorqueQpLaw, h: Array, state: State, *, back: bool = False) -> Array:
    """Wrenches of the hands from world axes into those of the contacts, or back."""
    axes = into_contacts(law.hands.hands, state.R_WO)
    pairs = zip(axes.transpose(0, 2, 1) if back else axes, h.reshape(2, 2, 3), strict=True)
    return np.concatenate([[*R @ force, *R @ torque] for R, (force, torque) in pairs])


def lively(chain: ClosedChain, half: float) -> TorqueQpLaw:
    """Pads, and a task that throws the box about."""
    held = pressing(chain, 0.2, half)
    goal = tuple(held.start_position + np.array([0.01, 0.02, 0.05]))
    task = PointOnPoint(goal=goal, gain=30.0, profile=Profile(kind="quintic", duration=0.1))
    law = TorqueQp().build(problem(held, task, dt=0.002, kappa=50.0))
    assert isinstance(law, TorqueQpLaw)
    return law


def test_the_end_of_a_tick_is_foreseen_as_it_was(chain: ClosedChain) -> None:
    """By how much rows were tightened is what a simulation says the hands came to."""
    law = lively(chain, 0.02)
    plant = RigidBody().build(law.problem, 0, Disturbance())
    state, before, moved = law.start(), None, 0.0
    for command, _ in drive(law, plant, state, TICKS):
        hands = law.hands
        if before is not None:
            came_to = turned(law, plant.signals["hand_wrench"], state)
            change = turned(law, came_to - before, state, back=True)
            rows = hands.in_cone * np.maximum(hands.cones @ change, 0.0)
            foreseen = (hands.stated - hands.upper) / AHEAD
            assert np.allclose(foreseen, rows, atol=1e-5)
            moved = max(moved, float(foreseen.max()))
        assert command.causes == (Status.OPTIMAL,)
        before = turned(law, law.solution.v[law.layout.h], state)
    assert moved > 0.01  # it matters [N]


def test_after_other_torques_nothing_is_foreseen(chain: ClosedChain) -> None:
    law = lively(chain, 0.02)
    state = law.start()
    law.tick(state)
    assert state.memory["answer"].any()
    law.hold_still(state)
    assert not state.memory["answer"].any()
    law.tick(state)
    assert np.array_equal(law.hands.upper, law.hands.stated)
