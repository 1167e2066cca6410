"""Reading a scenario evaluates every task and limit once, and says which promise is broken."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scenario_files import LOADABLE

from coopqp import CoopqpError, Limit, LimitRows, Row, ScenarioError, State, Task, TaskRows, spec
from coopqp.limit import Clearance, Tighten
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import load
from coopqp.scenario.trial import Places, try_limit, try_task
from coopqp.task import Evaluate, Part
from coopqp.tasks import Distance, LineOnPlane, Orientation, Pointing, PointOnCircle, Revolute

HEAD = """
from coopqp import *
import numpy as np

@spec
class Lift(Task):
    \"\"\"The object rises.\"\"\"
    height: float = 0.1
    \"\"\"[m]\"\"\"
"""

ROWS = """
    def rows(self, chain):
        return ("y", "z")
"""

BIND = """
    def bind(self, start):
        y, z = start.p_WO[1:] + np.array([0.0, self.height])
        def evaluate(state, rows):
            s = min(state.t, 1.0)
            rows.e[:] = state.p_WO[1] - y, state.p_WO[2] - z + self.height * (1.0 - s)
            rows.J[:] = state.J_task[1:3]
            rows.rate[:] = 0.0, self.height * (s < 1.0)
        return evaluate
"""

RIGHT = HEAD + ROWS + BIND

SCENARIO = """robot: nao_t14
start_deg: {right: [40, -20, 60, 50, 0], left: [40, 20, -60, -50, 0]}
tasks:
  - lift: {}
duration: 1.0
"""


def answer(folder: Path, task: str) -> list[str]:
    """What is said of a user's own task, a line each."""
    (folder / "mine").mkdir()
    (folder / "mine" / "lift.py").write_text(task)
    (folder / "lift.yaml").write_text(SCENARIO)
    try:
        load(folder / "lift.yaml", Catalog((folder / "mine",)))
    except ScenarioError as error:
        return str(error).splitlines()
    return []


def test_a_users_task_that_keeps_its_promises_is_taken(tmp_path: Path) -> None:
    assert answer(tmp_path, RIGHT) == []


BROKEN = {
    "a sign of J": (
        ("rows.J[:] = state.J_task[1:3]", "rows.J[:] = [[1], [-1]] * state.J_task[1:3]"),
        r"row z: J v is (-?[\d.e-]+), finite differences of e say (-?[\d.e-]+)",
    ),
    "no J": (("rows.J[:] = state.J_task[1:3]", "pass"), r"row [yz]: J v is 0, finite"),
    "a frozen J": (
        ("rows.J[:] = state.J_task[1:3]", "rows.J[:] = J_0"),
        r"row [yz]: J v is .*, finite differences of e say",
    ),
    "no rate": (
        ("rows.rate[:] = 0.0, self.height * (s < 1.0)", "rows.rate[:] = 0.0"),
        r"row z: rate is 0, finite differences of e say 0\.1",
    ),
    "NaN": (
        ("rows.e[:] = state.p_WO[1] - y,", "rows.e[:] = np.log(-1.0),"),
        r"row y: e is nan, needs a finite number",
    ),
    "infinite J": (
        ("rows.J[:] = state.J_task[1:3]", "rows.J[:] = np.inf"),
        r"row y: J of \w+ is inf, needs a finite number",
    ),
    "a wrong shape": (
        ("rows.J[:] = state.J_task[1:3]", "rows.J[:] = state.J_task[:3]"),
        r":20: raises ValueError: could not broadcast",
    ),
    "a zero divided by": (
        ("s = min(state.t, 1.0)", "s = 1 / 0"),
        r":18: raises ZeroDivisionError: division by zero",
    ),
    "no function": (("return evaluate", "return None"), r"bind\(\) gives None, needs to return"),
    "no rows": (('return ("y", "z")', "return ()"), r"rows\(\) names 0 rows"),
    "a text": (('("y", "z")', '("up")'), r"rows\(\) gives 'up', needs a tuple of names"),
    "not in place": (
        ("rows.J[:] = state.J_task[1:3]", "rows.J = state.J_task[1:3]"),
        r":20: raises FrozenInstanceError: .*rows are written in place: rows\.e\[:\] = \.\.\.$",
    ),
    "an error of its own": (
        ("y, z = start", "raise InvalidValueError('lift.height: too high')"),
        r"lift\.yaml:4: tasks\[0\]: lift\.height: too high$",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("change", "words"), BROKEN.values(), ids=list(BROKEN))
def test_a_users_broken_task_gets_one_line_with_both_files(
    change: tuple[str, str], words: str, tmp_path: Path
) -> None:
    task = RIGHT.replace("y, z = start", "J_0 = start.J_task[1:3].copy()\n        y, z = start")
    old, new = change
    assert old in task
    if old == "y, z = start":
        new += "\n        y, z = start"
    (line,) = answer(tmp_path, task.replace(old, new))
    assert line.startswith(f"{tmp_path}/lift.yaml:4: tasks[0]: ")
    assert re.search(words, line), line
    if "too high" not in line:
        assert f"{tmp_path}/mine/lift.py" in line


def test_the_line_tells_what_j_says_and_what_is_so(tmp_path: Path) -> None:
    change, words = BROKEN["a sign of J"]
    task = RIGHT.replace(*change)
    found = re.search(words, answer(tmp_path, task)[0])
    assert found
    said, so = map(float, found.groups())
    assert said == pytest.approx(-so, rel=1e-3)
    assert abs(so) > 1e-3


@pytest.mark.parametrize(
    ("addition", "words"),
    [
        ("    @property\n    def end(self):\n        return 1 / 0\n", r"lift\.py:\d+: raises Zero"),
        ("    def __post_init__(self):\n        1 / 0\n", r"lift\.py:\d+: raises Zero"),
        (
            "    def parts(self, chain):\n        return (Part('', 3, 'm', 1e-3),)\n",
            r"rows\(\) names 2 rows, parts\(\) has 3",
        ),
        ("    def rows(self, chain):\n        return 1 / 0\n", r"lift\.py:\d+: raises Zero"),
    ],
)
def test_whatever_else_a_task_raises_gets_a_line_too(
    addition: str, words: str, tmp_path: Path
) -> None:
    (line,) = answer(tmp_path, RIGHT + addition)
    assert line.startswith(f"{tmp_path}/lift.yaml:")
    assert re.search(words, line), line


# In Python, kind by kind.


@pytest.fixture(scope="module")
def places() -> Places:
    return Places(load("point_on_point").chain)


@spec
class _Joints(Task):
    """Joints go where e says; J is as given."""

    joint_space = True

    scale: float = 1.0
    """Of J."""
    wish: bool = True
    """Whether e is no error whose derivative J is."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return chain.joint_names

    def bind(self, start: State) -> Evaluate:
        def evaluate(state: State, rows: TaskRows) -> None:
            rows.e[:] = state.q**3 if self.wish else state.q
            rows.J[:] *= self.scale

        return evaluate


@pytest.mark.parametrize("scale", [0.0, 1.0])
def test_what_joints_wish_has_no_derivative(scale: float, places: Places) -> None:
    try_task(_Joints(scale=scale), places, 1.0)


def test_joint_space_needs_the_identity(places: Places) -> None:
    with pytest.raises(CoopqpError, match="joint_space needs J to be the identity"):
        try_task(_Joints(scale=2.0), places, 1.0)


@spec
class _Glide(Task):
    """The object glides."""

    asks_velocity = True

    error: float = 0.0
    """What e is."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return ("x",)

    def bind(self, start: State) -> Evaluate:
        def evaluate(state: State, rows: TaskRows) -> None:
            rows.e[0], rows.J[0], rows.rate[0] = self.error, state.J_task[0], 0.1

        return evaluate


def test_a_velocity_asked_for_is_the_derivative_of_nothing(places: Places) -> None:
    try_task(_Glide(), places, 1.0)
    with pytest.raises(CoopqpError, match=r"row x: e is 0\.1, but a task that asks_velocity"):
        try_task(_Glide(error=0.1), places, 1.0)


@spec
class _Slow(Task):
    """Asks for rest, J v = 0, unless it is given a rate."""

    wanted: float = 0.0
    """J v."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return ("x",)

    def parts(self, chain: ClosedChain) -> tuple[Part, ...]:
        return (Part("", 1, "m/s", 1.0),)

    def bind(self, start: State) -> Evaluate:
        def evaluate(state: State, rows: TaskRows) -> None:
            rows.J[0], rows.rate[0] = state.J_task[0], self.wanted

        return evaluate


def test_rest_needs_no_error_but_a_velocity_must_be_declared(places: Places) -> None:
    try_task(_Slow(), places, 1.0)
    with pytest.raises(CoopqpError, match=r"row x: J v is .*finite differences of e say 0"):
        try_task(_Slow(wanted=0.1), places, 1.0)


# Limits.


HOW: dict[str, Callable[[LimitRows, State], object]] = {
    "tightens": lambda rows, _: np.minimum(rows.ub, 0.5, out=rows.ub),
    "widens": lambda rows, _: np.copyto(rows.lb, -1.0),
    "is NaN": lambda rows, _: np.copyto(rows.lb, np.nan),
    "forgets": lambda rows, _: np.copyto(rows.h[1:], np.nan),
    "goes up": lambda rows, _: np.copyto(rows.lb, 2.0),
    "no G": lambda rows, _: np.copyto(rows.G[1:], np.inf),
    "shape": lambda rows, state: np.copyto(rows.G, state.J_task[:3]),
    "never": lambda rows, _: np.copyto(rows.h, -np.inf),
    "upside down": lambda rows, _: np.copyto(rows.ub, -np.inf),
}


@spec
class _Bound(Limit):
    """Bounds, right or wrong."""

    how: str = "tightens"
    """What it does."""

    def rows(self, chain: ClosedChain) -> tuple[Row, ...]:
        return tuple(Row(name=f"bound.{axis}", kind="limit", unit="m/s") for axis in "xy")

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        def tighten(state: State, rows: LimitRows) -> None:
            rows.G[:], rows.h[:] = state.J_task[:2], 0.5
            rows.ub[:] = rows.ub.clip(max=1.0)
            HOW[self.how](rows, state)

        return tighten


def test_a_limit_that_keeps_its_promises_is_taken(places: Places) -> None:
    try_limit(_Bound(), places, 0.01)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("widens", r"joint \w+: .*widens the bounds; tighten them by np.maximum"),
        ("is NaN", r"joint \w+: nan <= v <= 1: needs a number or -inf below"),
        ("forgets", r"row bound\.y: h is nan or not written, needs a number"),
        ("goes up", r"joint \w+: 2 <= v <= 1: leaves no velocity at a start inside the limits"),
        ("no G", r"row bound\.y: G of \w+ is inf, needs a finite number"),
        ("shape", r"test_validate\.py:\d+: raises ValueError: could not broadcast"),
        ("never", r"row bound\.x: h is -inf"),
        ("upside down", r"<= v <= -inf: needs a number or -inf below"),
    ],
)
def test_a_broken_limit_is_told_with_its_file(how: str, words: str, places: Places) -> None:
    with pytest.raises(CoopqpError, match=words) as caught:
        try_limit(_Bound(how=how), places, 0.01)
    assert str(caught.value).startswith(__file__)
    assert "\n" not in str(caught.value)


@spec
class _Damper(Limit):
    """The object stays below a height, or does not."""

    left: Callable[[float], object]
    """What is said to be left below it."""

    def rows(self, chain: ClosedChain) -> tuple[Row, ...]:
        return (Row(name="limit.ceiling", kind="limit", unit="m", of_place=True),)

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        def tighten(state: State, rows: LimitRows) -> None:
            rows.G[0], rows.h[0] = state.J_task[2], 1.0

        return tighten

    def clearance(self, chain: ClosedChain) -> Clearance:
        return lambda state: self.left(state.p_WO[2])  # type: ignore[return-value]


def test_rows_of_a_limit_are_rows(places: Places) -> None:
    class Texts(_Damper):
        def rows(self, chain: ClosedChain) -> Any:
            return ("limit.ceiling",)

    with pytest.raises(
        CoopqpError, match=r"rows\(\) gives \('limit.ceiling',\), needs a tuple of Rows"
    ):
        try_limit(Texts(left=lambda z: [z]), places, 0.01)


def test_rows_of_a_limit_in_space_are_how_fast_its_clearance_shrinks(places: Places) -> None:
    try_limit(_Damper(left=lambda z: np.array([1.0 - z])), places, 0.01)
    try_limit(_Damper(left=lambda z: [np.inf]), places, 0.01)  # which is far
    for left, words in (
        (lambda z: [z], r"row limit\.ceiling: G v is .*finite differences of clearance\(\) say"),
        (
            lambda z: 1.0 - z,
            r"clearance\(\) gives the shape \(\), needs a list of at most 1 number",
        ),
        (lambda z: [1.0 - z, 1.0], r"clearance\(\) gives the shape \(2,\), needs"),
        (lambda z: 1.0 / 0.0, r"test_validate\.py:\d+: raises ZeroDivisionError"),
    ):
        with pytest.raises(CoopqpError, match=words):
            try_limit(_Damper(left=left), places, 0.01)


# What is shipped.


@pytest.mark.parametrize("name", LOADABLE)
def test_no_shipped_task_or_limit_is_refused_at_any_motion_law(name: str) -> None:
    scenario = load(name)
    places = Places(scenario.chain)
    for kind in ("step", "constant_velocity", "trapezoid", "quintic"):
        for task in scenario.schedule[0].tasks:
            if hasattr(task, "profile"):
                profile = Profile(kind=kind, duration=0.7, delay=0.1)  # type: ignore[arg-type]
                task = replace(task, profile=profile)  # type: ignore[call-arg]
            try_task(task, places, 1.0)


@pytest.mark.parametrize("kind", ["step", "quintic"])
def test_a_task_may_start_where_it_is_singular(kind: str, places: Places) -> None:
    """There rows hold other promises than e_dot = J v - rate, see docs/tasks.md."""
    axis, start = (0.3, -0.5, 0.6), places.start
    against, here = tuple(-start.R_WO @ np.array(axis)), tuple(start.p_WO)
    profile = Profile(kind=kind)  # type: ignore[arg-type]
    turned = pin.exp3(np.pi * np.array(axis) / np.linalg.norm(axis)) @ start.R_WO
    tasks: list[Task] = [
        Pointing(direction=against, axis=axis, profile=profile),
        Revolute(direction=against, through=here, axis=axis, profile=profile),
        LineOnPlane(normal=against, through=here, axis=axis, profile=profile),
        Orientation(rpy=tuple(pin.rpy.matrixToRpy(turned)), profile=profile),
        Distance(to=here, length=0.1, profile=profile),
        PointOnCircle(center=here, normal=axis, radius=0.05, profile=profile),
    ]
    for task in tasks:
        try_task(task, places, 2.0)
