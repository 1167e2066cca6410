"""What the stress test sees of joints that oscillate, and of hard tasks worse than soft ones.

Motions are made up, so that the detectors are tested and not the law. What the law does with the
scenarios in ``firmness/`` is asked at the end.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from laws import problem
from numpy.typing import NDArray

from coopqp.assessment.oscillation import MIN_RANGE, Oscillation, oscillation
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem, Law
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.scenario.loader import load
from coopqp.solver import Status
from coopqp.tasks import PointOnPoint, Twist
from coopqp.trace import TickBatch
from stress.draw import LAW
from stress.driving import LONGEST, drive_on, record_of, turns
from stress.ending import PartErrors
from stress.firmness import as_soft, missed_hard_tasks, worse_than_soft
from stress.signs import Record

FILES = Path(__file__).parent / "firmness"
DT = 0.005
T = DT * np.arange(round(LONGEST / DT) + 1)
FREQUENCIES = (0.2, 0.5, 1.0, 3.0, 10.0, 50.0)  # [Hz]


def record(
    *joints: NDArray[np.floating[Any]], rest: int = 0, longest: float = math.inf, unit: str = "rad"
) -> Record:
    """Joints that went this way."""
    q = np.stack(joints, axis=1)
    n, far = q.shape[1], np.full(q.shape[1], 1e3)
    units, v = (unit,) * n, np.diff(q, axis=0) / DT
    return Record(-far, far, far, units, DT, rest, longest, q, v, [(Status.OPTIMAL,)] * len(v))


def oscillates(seen: Record, noise: float = 0.0) -> Oscillation | None:
    """As the stress test asks."""
    q = seen.q[seen.rest :]
    return oscillation(q, seen.units, seen.dt, longest=seen.longest, noise=noise)


def turning(seen: Record) -> bool:
    """As the stress test asks."""
    return turns(seen.q[seen.rest :], seen.units)


def sine(frequency: float, size: float = 0.01) -> Array:
    """A range of 2 size."""
    out: Array = size * np.sin(2.0 * np.pi * frequency * T)
    return out


# Seen.


@pytest.mark.parametrize("frequency", FREQUENCIES)
@pytest.mark.parametrize("size", [2e-4, 0.01, 1.0])
@pytest.mark.parametrize("phase", [0.0, 1.0, 2.0, 4.0])
def test_a_lasting_oscillation_is_seen(frequency: float, size: float, phase: float) -> None:
    q: Array = size * np.sin(2.0 * np.pi * frequency * T + phase)
    seen = oscillates(record(np.zeros(len(T)), q))
    assert seen is not None
    assert seen.joint == 1
    # Four ticks a period may miss the peaks by 30 %.
    assert seen.size == pytest.approx(2.0 * size, rel=0.3)
    assert seen.frequency == pytest.approx(frequency, rel=0.35)


@pytest.mark.parametrize("frequency", FREQUENCIES)
def test_who_may_oscillate_is_not_ended(frequency: float) -> None:
    if frequency == 0.2:  # turns every 2.5 s; that is seen from 5 s on
        assert turning(record(sine(frequency)[:1001]))
    else:
        assert turning(record(sine(frequency)[:501]))


def test_chatter_of_one_joint_on_its_way_is_seen() -> None:
    """From tick to tick by 1 mrad, on a ramp of 20 mrad/s."""
    chatter = np.where(np.arange(len(T)) % 2, 5e-4, -5e-4)
    way = 0.02 * T
    seen = oscillates(record(way, way + chatter, sine(0.0)))
    assert seen is not None
    assert seen.joint == 1


def test_a_relaxation_is_seen() -> None:
    """Off in a tick, back in a second, every 2 s."""
    assert oscillates(record(0.05 * np.exp(-np.mod(T, 2.0) / 0.3))) is not None


def test_bursts_are_seen() -> None:
    """10 Hz in one second of three."""
    assert oscillates(record(sine(10.0) * (np.mod(T, 3.0) < 1.0))) is not None


def test_an_oscillation_after_a_long_way_is_seen() -> None:
    assert oscillates(record(np.exp(-T) + sine(3.0, 1e-3))) is not None


def test_what_oscillates_slowly_growing_is_seen() -> None:
    assert oscillates(record(sine(2.0) * np.exp(T / 20.0))) is not None


# Not seen.


@pytest.mark.parametrize("frequency", FREQUENCIES)
def test_an_oscillation_that_fades_is_none(frequency: float) -> None:
    """To a third in 7 s: the range in the last third is then 0.4 of that in the second."""
    assert oscillates(record(sine(frequency) * np.exp(-T / 7.0))) is None


@pytest.mark.parametrize(
    "q",
    [
        0.0 * T,
        0.3 * T,
        np.exp(-T),
        np.exp(-T / 10.0),
        np.minimum(T, 12.0),
        np.exp(-T) * np.cos(6.0 * T),
        1.0 - np.abs(T / 12.0 - 1.0),
        0.3 * np.sqrt(T),
    ],
    ids=["rest", "ramp", "approach", "slow approach", "stop", "spiral", "there and back", "creep"],
)
def test_what_arrives_is_no_oscillation(q: Array) -> None:
    assert oscillates(record(q)) is None


@pytest.mark.parametrize("unit", ["rad", "m"])
def test_an_oscillation_too_small_to_see_is_none(unit: str) -> None:
    half = 0.5 * MIN_RANGE[unit]
    assert oscillates(record(sine(3.0, 0.9 * half), unit=unit)) is None
    assert oscillates(record(sine(3.0, 1.1 * half), unit=unit)) is not None
    assert oscillates(record(sine(3.0, 1.1 * half), unit=unit), noise=1e-4) is None


def test_rounding_is_no_oscillation(rng: np.random.Generator) -> None:
    assert oscillates(record(np.exp(-T) + 1e-9 * rng.normal(size=len(T)))) is None


def test_what_follows_a_moving_reference_is_none() -> None:
    """Before it rests anything goes; targets with a velocity never rest, but are slow."""
    followed = np.where(T < 12.0, sine(1.0), np.exp(12.0 - T))
    assert oscillates(record(followed[:2400])) is not None
    assert oscillates(record(followed, rest=round(12.0 / DT))) is None
    slow = sine(0.2)
    assert oscillates(record(slow)) is not None
    assert oscillates(record(slow, longest=2.0 / DT)) is None
    assert oscillates(record(sine(2.0), longest=2.0 / DT)) is not None


def test_few_ticks_say_nothing() -> None:
    assert oscillates(record(sine(50.0)[:20])) is None
    assert not turning(record(sine(50.0)[:8]))


# The law.


@cache
def asked(name: str) -> tuple[ControlProblem, int]:
    """A scenario's problem, and which of its tasks is hard."""
    found = next(load(FILES / f"{name}.yaml").problems(lambda tick: np.zeros(0)))
    return found, [task.mode for task in found.tasks].index("hard")


def driven(wanted: ControlProblem) -> tuple[Law, State, Record]:
    law = LAW.unprepared(wanted)
    state, seen = law.start(), record_of(wanted)
    drive_on(law, state, seen, PartErrors(wanted, state))
    return law, state, seen


@pytest.mark.parametrize("name", ["oscillates_hard", "hard_worse_than_soft"])
def test_soft_tasks_of_priority_0_come_to_rest(name: str) -> None:
    wanted, i = asked(name)
    _, _, seen = driven(as_soft(wanted, wanted.tasks[i]))
    assert oscillates(seen) is None


@pytest.mark.skip(reason="the law does not keep this yet")
@pytest.mark.parametrize("name", ["oscillates_hard", "hard_worse_than_soft"])
def test_unreachable_hard_tasks_rest_as_near_as_soft_ones(name: str) -> None:
    wanted, i = asked(name)
    law, state, seen = driven(wanted)
    assert oscillates(seen) is None
    assert list(worse_than_soft(law, state, i)) == []


def test_as_soft_moves_the_others_one_priority_down() -> None:
    wanted, i = asked("hard_worse_than_soft")
    before, after = wanted.tasks, as_soft(wanted, wanted.tasks[i]).tasks
    assert [(t.mode, t.priority) for t in before] == [
        ("soft", 9), ("soft", 0), ("soft", 9), ("hard", 9), ("soft", 0)
    ]  # fmt: skip
    assert [t.priority for t in after] == [9, 1, 9, 0, 1]
    assert {t.mode for t in after} == {"soft"}
    scaled = replace(wanted, tasks=(*before[:2], replace(before[2], mode="scaled"), *before[3:]))
    assert as_soft(scaled, scaled.tasks[i]).tasks[2] == scaled.tasks[2]


class Standing:
    """A law that stands still."""

    def __init__(self, problem: ControlProblem) -> None:
        self.problem = problem

    def run(self, state: State, ticks: int) -> TickBatch:
        made = TickBatch.empty(ticks, len(state.q), 0)
        made.q[:] = state.q
        return made


def test_a_hard_task_that_rests_farther_off_is_seen(chain: ClosedChain) -> None:
    """A law that stands where it began leaves it 4 cm off, and none at its goal."""
    reach = PointOnPoint(name="reach", goal=(0.13, 0.05, 0.03), mode="hard")
    asked_for = problem(chain, reach, limits=(JointPosition(), JointVelocity()))
    stands, start = cast("Law", Standing(asked_for)), State(chain, t=5.0)
    start.update()
    seen = replace(record_of(asked_for), q=chain.q_start[None])
    assert missed_hard_tasks(asked_for, start, seen) == [0]
    (words,) = worse_than_soft(stands, start, 0)
    assert words.startswith("reach rests ")
    assert np.array_equal(start.q, chain.q_start)
    LAW.build(as_soft(asked_for, asked_for.tasks[0])).run(start, 400)
    assert missed_hard_tasks(asked_for, start, seen) == []
    assert list(worse_than_soft(stands, start, 0)) == []


def test_who_moves_or_stops_for_good_is_not_compared(chain: ClosedChain) -> None:
    reach = PointOnPoint(name="reach", goal=(0.13, 0.05, 0.03), mode="hard")
    asked_for = problem(chain, reach, limits=(JointPosition(), JointVelocity()))
    seen = replace(record_of(asked_for), q=chain.q_start[None])
    start = State(chain, t=5.0)
    start.update()
    moves = replace(seen, v=np.ones((20, chain.n)))
    assert missed_hard_tasks(asked_for, start, moves) == []
    assert missed_hard_tasks(replace(asked_for, on_infeasible="hold"), start, seen) == []
    turns = Twist(name="turn", velocity={"z": 0.1})
    assert missed_hard_tasks(replace(asked_for, tasks=(reach, turns)), start, seen) == []
