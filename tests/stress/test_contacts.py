"""The stress test of hands that press: a small share of it, and whether it would see a lie."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from laws import problem
from pads import pressing
from rich.console import Console
from scenario_files import needs_robots

from coopqp.controllers import TorqueQp
from coopqp.controllers.torque_qp import TorqueQpLaw
from coopqp.model.closed_chain import ClosedChain
from coopqp.solver import Status
from coopqp.tasks import PointOnPoint
from stress.contacts import ContactRollout, Seen, contact_rollout, draw_pressing, look
from stress.summary import contact_table, summarize


@pytest.fixture(scope="module")
def few() -> list[ContactRollout]:
    return [contact_rollout(seed) for seed in range(3)]


@needs_robots
def test_a_small_share_breaks_no_promise(few: list[ContactRollout]) -> None:
    assert [(r.seed, r.broken) for r in few if r.broken] == []
    assert {r.outcome for r in few} <= {"held", "lost", "refused"}
    assert any(r.outcome == "held" and r.ticks == 300 for r in few)


def test_draws_are_wide() -> None:
    drawn = [draw_pressing(seed) for seed in range(30)]
    assert {d.grasp for d in drawn} == {"pads", "fingertip"}
    assert {d.errors for d in drawn} == {"none", "push", "friction", "mass", "all"}
    assert all(1.0 <= d.controller.safety <= 2.0 for d in drawn)


def looked_at(chain: ClosedChain) -> tuple[TorqueQpLaw, Seen]:
    """A law of hands that press after a tick, and what is seen of it."""
    held = pressing(chain, 0.2, 0.02)
    stay = PointOnPoint(goal=tuple(held.start_position), gain=10.0)
    law = TorqueQp().build(problem(held, stay, dt=0.002, kappa=50.0))
    assert isinstance(law, TorqueQpLaw)
    state, seen = law.start(), Seen()
    command = law.tick(state)
    assert command.causes == (Status.OPTIMAL,)
    look(law, state, command, seen)
    return law, seen


def test_an_honest_tick_breaks_nothing(chain: ClosedChain) -> None:
    assert looked_at(chain)[1].broken == ()


def test_a_cone_that_is_left_in_silence_is_seen(chain: ClosedChain) -> None:
    """The same answer with a squeeze that is half of it."""
    law, _ = looked_at(chain)
    state, seen = law.start(), Seen()
    command = law.tick(state)
    law.programs[-1].solution.v[law.layout.h] += np.tile([0.0, 0.0, -5.0, 0.0, 0.0, 0.0], 2)
    look(law, state, command, seen)
    assert len(seen.broken) == 2  # by its rows, and by round cones


def test_a_motor_beyond_its_limit_is_seen(chain: ClosedChain) -> None:
    law, _ = looked_at(chain)
    state, seen = law.start(), Seen()
    command = law.tick(state)
    assert command.tau is not None
    command.tau[0] = 1.0 + law.problem.chain.model.effortLimit[0]
    look(law, state, command, seen)
    assert any("torque limit by 1 N m" in words for words in seen.broken)


def test_the_table_counts_every_rollout() -> None:
    """Once by robot, once by grasp, once by errors, once in all; losses by their names."""
    rollouts = [
        ContactRollout(0, "baxter", "pads", "none", outcome="held", ticks=300),
        ContactRollout(1, "baxter", "pads", "push", outcome="lost", cause="push", ticks=20),
        ContactRollout(2, "nao_t14", "pads", "none", outcome="lost", broken=("x",), ticks=5),
        ContactRollout(3, "nao_t14", "fingertip", "none", outcome="refused"),
        ContactRollout(4, broken=("raised",)),
    ]
    lines = {line["kind"]: line for line in summarize(rollouts)}
    assert lines["all"]["count"] == 5
    assert lines["all"]["causes"] == {"no name": 1, "push": 1}
    assert lines["all"]["broken"] == 2
    counts = Counter({kind: line["count"] for kind, line in lines.items()})
    assert counts["baxter"] + counts["nao_t14"] == counts["pads"] + counts["fingertip"] == 4
    console = Console(width=80, record=True)
    console.print(contact_table(list(lines.values())))
    assert "lost by: no name 1, push 1" in console.export_text()
