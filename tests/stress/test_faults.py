"""A small share of the rollouts with faults, and what must not pass there."""

from __future__ import annotations

import numpy as np
import pytest

from coopqp.plant import FAULTS
from coopqp.plants import RigidBody
from coopqp.solver import Status
from coopqp.study.engine import Engine
from stress.draw import draw
from stress.faults import draw_faults, faulty_rollout, untrue
from stress.summary import summarize
from stress.test_wide import made_up
from stress.trial import stress


def test_a_small_share_keeps_what_is_promised_of_commands() -> None:
    done = stress(20, faulty_rollout, engine=Engine(jobs=1))
    assert [(r.seed, r.broken) for r in done if r.broken] == []
    assert {r.outcome for r in done} == {"silent", "spoken"}
    assert summarize(done)[-1]["count"] == 20


def test_so_does_one_on_bodies() -> None:
    assert faulty_rollout(0, plant=RigidBody(time_step=0.0025)).broken == ()


def test_all_kinds_are_drawn_and_equal_seeds_draw_alike() -> None:
    problem = draw(3).problem
    drawn = [draw_faults(seed, problem, forces=True) for seed in range(200)]
    assert {fault.kind for faults in drawn for fault in faults} == set(FAULTS)
    assert drawn[7] == draw_faults(7, problem, forces=True)
    kinematic = [f.kind for k in range(200) for f in draw_faults(k, problem, forces=False)]
    assert set(kinematic) == {kind for kind in FAULTS if not kind.startswith("force")}


@pytest.mark.parametrize(
    ("cause", "speed", "lost", "words"),
    [
        (Status.PLANT_FAILED, 0.0, False, "tick 0 says PLANT_FAILED"),
        (Status.INFEASIBLE, 0.1, False, "tick 0 moves though it is INFEASIBLE"),
        (Status.OPTIMAL, 0.1, True, "tick 0 does not say NOT_MEASURED"),
        (Status.NOT_MEASURED, 0.1, False, "tick 0 says NOT_MEASURED"),
        (Status.NOT_MEASURED, 0.1, True, None),
        (Status.OPTIMAL, 0.1, False, None),
    ],
)
def test_what_is_not_so_is_found(cause: Status, speed: float, lost: bool, words: str) -> None:
    record = made_up(np.array([speed]), (cause,))
    assert list(untrue(record, [lost])) == ([words] if words else [])
