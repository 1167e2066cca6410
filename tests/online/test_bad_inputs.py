"""What cannot be numbers, at every input, at the force sensors and as measured joints."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from decimal import Decimal
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from online_loops import follows, go, simulated

import coopqp
from coopqp import OnlineLoop, Status
from coopqp.online.simulated import SimulatedRobot
from coopqp.scenario.scenario import Scenario


class NoFloat:
    """Has no number."""

    def __float__(self) -> float:
        raise ZeroDivisionError


class NoArray:
    """Has no array, and cannot say what it is."""

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise SystemExit

    def __repr__(self) -> str:
        raise RuntimeError


class Numbers(np.ndarray[Any, Any]):
    """Of another class, whose arithmetic fails."""

    def __array_ufunc__(self, *_: Any, **__: Any) -> Any:
        raise RuntimeError


class BadMapping(Mapping[str, Any]):
    """Fails wherever it is asked."""

    def __getitem__(self, key: str) -> Any:
        raise RuntimeError

    def __iter__(self) -> Iterator[str]:
        raise RuntimeError

    def __len__(self) -> int:
        raise RuntimeError


def nested(depth: int) -> list[Any]:
    """A list in a list in a list."""
    found: list[Any] = []
    for _ in range(depth):
        found = [found]
    return found


def junk(n: int) -> dict[str, Any]:
    """What n numbers are not."""
    long: Any = np.longdouble
    return {
        "huge integers": [10**400] * n,
        "integers that cannot be written": [10**5000] * n,
        "no float": [NoFloat()] * n,
        "no array": NoArray(),
        "no arrays": [NoArray()] * n,
        "decimals without end": [Decimal("1e999")] * n,
        "decimals that are none": [Decimal("nan")] * n,
        "nested": nested(5000),
        "too deep": np.zeros((1,) * 30).tolist(),
        "bytes": b"x" * n,
        "texts": ["0.1"] * n,
        "texts as objects": np.array(["0.1"] * n, object),
        "complex": [0.1 + 0j] * n,
        "booleans": [True] * n,
        "a boolean": [0.1] * (n - 1) + [True],
        "infinite": [np.inf] * n,
        "as good as infinite": [1e300] * n,
        "long doubles": np.full(n, long("1e4000")),
        "NaN": [0.1] * (n - 1) + [np.nan],
        "masked": np.ma.array([0.1] * n, mask=[True] + [False] * (n - 1)),
        "masked in a list": [np.ma.masked] * n,
        "too few": [0.1] * (n - 1),
        "too many": [0.1] * (n + 1),
        "ragged": [[0.1], [0.1, 0.2], 3],
        "a generator": (0.1 for _ in range(n)),
        "a set": {0.1, 0.2},
        "a mapping": {"x": 0.1},
        "times": np.full(n, "2020-01-01", "M8[D]"),
        "records": np.zeros(n, [("x", float)]),
        "a class": float,
        "nothing": None,
        "a pair of nothing": (None, None),
        "stamped by text": ([0.1] * n, "now"),
        "stamped by a huge integer": ([0.1] * n, 10**400),
        "stamped by NaN": ([0.1] * n, np.nan),
    }


JUNK = tuple(junk(3))
#: Each kind of input, and how many numbers it has.
KINDS = {
    "point": ("point_on_point: {goal: {input: given}}", 3),
    "direction": ("pointing: {axis: [0, 0, 1], direction: {input: given}}", 3),
    "rotation": ("orientation: {goal: {input: given}}", 4),
    "pose": ("pose: {goal: {input: given}}", 7),
    "joints": ("posture: {goal: {input: given}}", 10),
    "velocity": ("twist: {components: [x, z], velocity: {input: given}}", 2),
}
SCENARIO = """
robot: nao_t14
start: {right: [0.7, -0.2, 1.2, 0.9, 0.1], left: [0.7, 0.2, -1.2, -0.9, -0.1]}
tasks:
  - TASK
inputs: {given: {stale_after: 10.0}}
controllers: [qp]
plant: kinematic
duration: 1.0
"""


@cache
def hears(task: str) -> Scenario:
    """A scenario with an input of a kind."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "hears.yaml"
        path.write_text(SCENARIO.replace("TASK", task), encoding="utf-8")
        return coopqp.load(path)


@pytest.fixture(autouse=True)
def strict() -> Iterator[None]:
    """As a user may have it: numpy raises, and warnings are errors."""
    with np.errstate(all="raise"), warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_number_is_refused_at_every_input(kind: str) -> None:
    task, n = KINDS[kind]
    loop, robot = simulated(hears(task))
    go(loop, robot, 5)
    for name, value in junk(n).items():
        before = loop.command.v.copy()
        go(loop, robot, 1, {"given": value})
        assert Status.INPUT_REFUSED in loop.command.causes, (name, loop.note)
        assert Status.RAISED not in loop.command.causes
        assert "given: " in loop.note
        assert np.abs(loop.command.v - before).max() < 0.5, name


@pytest.mark.parametrize("given", [BadMapping(), 5, "target", [1.0], {5: 1}, {NoArray(): 1}])
def test_inputs_that_are_no_mapping_of_values_are_refused(given: Any) -> None:
    loop, robot = simulated(follows())
    go(loop, robot, 5, {"target": [0.15, 0.0, 0.06]})
    go(loop, robot, 1, given)
    assert Status.INPUT_REFUSED in loop.command.causes
    go(loop, robot, 1, {"target": [0.15, 0.0, 0.06]})
    assert loop.status is Status.OPTIMAL


@pytest.mark.few(12)
@pytest.mark.parametrize("name", [x for x in JUNK if "stamped" not in x])
def test_measured_joints_that_are_no_numbers_are_not_measured(name: str) -> None:
    n = follows().chain.n
    for reference in ("commanded", "measured"):
        loop, robot = simulated(follows(), reference=reference)
        go(loop, robot, 20, {"target": [0.15, 0.0, 0.06]})
        fast = np.abs(loop.command.v).max()
        wanted = Status.ROBOT_SILENT if name == "nothing" else Status.NOT_MEASURED
        for _ in range(3):
            command = loop.tick(junk(n)[name])
            assert wanted in command.causes
            assert name == "nothing" or loop.note
        assert fast > 0.0
        assert np.abs(command.v).max() < fast
        go(loop, robot, 1, {"target": [0.15, 0.0, 0.06]})
        assert loop.status is Status.OPTIMAL


@pytest.mark.parametrize("name", [x for x in JUNK if "stamped" not in x])
def test_laws_alone_do_not_measure_by_what_is_no_number(name: str) -> None:
    problem = follows().held_by("qp").problem()
    law = coopqp.controllers.QPController().build(problem)
    state = law.start()
    state.q_measured = junk(problem.chain.n)[name]
    command = law.tick(state)
    assert command.status.usable
    assert (Status.NOT_MEASURED in command.causes) == (name != "nothing")


@pytest.mark.few(12)
@pytest.mark.parametrize("name", [x for x in JUNK if "stamped" not in x])
def test_what_hands_cannot_have_felt_is_not_measured(name: str) -> None:
    loop = OnlineLoop(coopqp.load("position_pair"), "qp", clock=None)
    robot = SimulatedRobot(loop)
    go(loop, robot, 3, {"hand_wrench": np.zeros(12)})
    go(loop, robot, 1, {"hand_wrench": junk(12)[name]})
    assert Status.FORCE_NOT_MEASURED in loop.command.causes, loop.note
    assert "hand_wrench" in loop.note
    assert np.isfinite(loop.command.v).all()


def test_numbers_of_any_other_class_are_numbers() -> None:
    loop, robot = simulated(follows())
    go(loop, robot, 5)
    x = [0.15, 0.0, 0.06]
    given = [tuple(x), np.array(x, np.float32), [Decimal("0.15"), 0, 0], np.array(x).view(Numbers)]
    for value in (*given, np.ma.array(x), [np.float64(0.1), 0, np.int8(0)], np.array(x, object)):
        go(loop, robot, 1, {"target": value})
        assert loop.status is Status.OPTIMAL, loop.note


def test_a_session_of_all_that_is_wrong_raises_nothing_and_keeps_the_limits(
    rng: np.random.Generator,
) -> None:
    said: list[Any] = [None, "x", np.nan, np.inf, 10**400, 1e300, True, -5.0, [1.0], NoFloat()]
    k = [0]

    def clock() -> Any:
        return said[rng.integers(len(said))] if k[0] > 5 and rng.random() < 0.1 else 0.01 * k[0]

    scenario = follows()
    loop = OnlineLoop(scenario, clock=clock, patience=1e6)
    robot, n = SimulatedRobot(loop), scenario.chain.n
    most, statuses = scenario.chain.velocity + 1e-9, set[Status]()
    for k[0] in range(600):
        names = rng.choice(JUNK, 2)
        q = junk(n)[names[0]] if rng.random() < 0.1 else robot.read()
        inputs: Any = {"target": [0.15, 0.01 * np.sin(0.05 * k[0]), 0.06]}
        if rng.random() < 0.2:
            inputs = {"target": junk(3)[names[1]], str(names[0]): 1}
        command = loop.tick(q, BadMapping() if rng.random() < 0.02 else inputs)
        robot.write(loop.setpoint, command.v)
        statuses.update(command.causes)
        assert (np.abs(command.v) <= most).all()
        assert (loop.setpoint >= scenario.chain.lower - 1e-9).all()
        assert (loop.setpoint <= scenario.chain.upper + 1e-9).all()
        assert Status.RAISED not in command.causes, loop.note
    wrong = {Status.CLOCK_WRONG, Status.NOT_MEASURED, Status.INPUT_REFUSED, Status.ROBOT_SILENT}
    assert wrong | {Status.OPTIMAL} <= statuses
