"""What a loop cannot be asked for is refused when it is made, in one error of coopqp's."""

from __future__ import annotations

import copy
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from online_loops import Scripted, follows

import coopqp
from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.online.loop import OnlineLoop
from coopqp.online.real_time import real_time

WRONG: list[tuple[str, Any]] = [
    ("controller", None), ("controller", 3),
    ("speed_up", "a"), ("speed_up", 0.0), ("speed_up", True),
    ("patience", "a"), ("patience", None), ("patience", math.nan), ("patience", -1.0),
    ("keep", "a"), ("keep", 1e12), ("keep", None),
    ("silent_after", "a"), ("silent_after", None), ("silent_after", math.nan),
    ("silent_after", -1.0),
    ("clock", 3), ("clock", lambda: "x"), ("clock", lambda: math.nan), ("clock", lambda: 1 / 0),
    ("out", 3), ("out", ""), ("out", "a\0b"), ("out", b"a"),
    ("record", 3), ("reference", None), ("grasp", ["as_held"]), ("phases", 3),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value"), WRONG)
def test_a_wrong_option_is_named(name: str, value: Any, tmp_path: Path) -> None:
    with pytest.raises(InvalidValueError, match=rf"^{name}: .*") as refused:
        OnlineLoop(follows(), **{name: value})
    assert len(str(refused.value).splitlines()) == 1


def test_a_clock_that_asks_for_something_is_blamed_itself() -> None:
    words = r"^clock: missing a required argument: 'a'; needs a function without arguments$"
    with pytest.raises(InvalidValueError, match=words):
        OnlineLoop(follows(), clock=lambda a: a)  # type: ignore[arg-type,misc]


@pytest.mark.parametrize("scenario", ["point_on_point", None])
def test_what_is_no_scenario_is_refused(scenario: Any) -> None:
    with pytest.raises(InvalidValueError, match=r"scenario: found .*; (use coopqp.load|needs a)"):
        OnlineLoop(scenario, "qp")


@pytest.mark.parametrize(
    "good", [{"speed_up": None}, {"silent_after": np.float32(0.1)}, {"keep": 3}, {"patience": 1}]
)
def test_what_may_be_asked_for(good: Any) -> None:
    OnlineLoop(follows(), **good)


@pytest.mark.parametrize("how", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_loop_is_not_copied(how: Any) -> None:
    with pytest.raises(CoopqpError, match="a loop cannot be copied"):
        how(OnlineLoop(follows(), clock=None))


ARGUMENTS: dict[str, Any] = {
    "loop": None, "robot": None, "inputs": {"target": [0, 0, 0]}, "duration": "a",
}  # fmt: skip


@pytest.mark.parametrize("name", ARGUMENTS)
def test_real_time_refuses_what_it_cannot_run(name: str) -> None:
    given = {"loop": OnlineLoop(follows()), "robot": Scripted(follows().chain.q_start)}
    with pytest.raises(InvalidValueError, match=f"^{name}: "):
        real_time(**{**given, name: ARGUMENTS[name]})


@pytest.mark.parametrize("duration", [math.nan, 0.0, -1.0, math.inf])
def test_a_duration_is_a_time(duration: float) -> None:
    robot = Scripted(follows().chain.q_start)
    with pytest.raises(InvalidValueError, match=r"duration: found .* s; needs a finite time"):
        coopqp.real_time(OnlineLoop(follows()), robot, duration=duration)
    assert not robot.written
