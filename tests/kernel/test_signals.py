"""Tasks that follow signals: the kernel moves the joints as the plain law does."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from chains import ring
from following import NAMES, following, one_of_each, way
from laws import LIMITS, problem
from side_by_side import drive, needs_kernel

from coopqp.base.spec import Array
from coopqp.controllers import QPController
from coopqp.execution.controller_run import run
from coopqp.kernel.law import KernelLaw
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.scenario.input import InputSettings
from coopqp.scenario.loader import load
from coopqp.signal import POINT, InputValues, Kind, Signal, Trajectory
from coopqp.signals import Circle, Input, Line
from coopqp.solver import Status
from coopqp.task import Task, TaskStack
from coopqp.tasks import JointCentering, PointOnPoint
from coopqp.trace import Trace

pytestmark = needs_kernel

SAME = 1e-10  # [rad/s, m/s]
#: Impedances are for laws that command torques.
BY_VELOCITY = [name for name in NAMES if name != "impedance"]
#: Whose references the kernel reads, and does not have their rows filled.
READ = (
    "distance", "line_on_line", "line_on_plane", "plane_on_plane", "point_on_circle",
    "point_on_line", "point_on_plane", "point_on_point", "pointing", "prismatic", "revolute",
)  # fmt: skip


def slow(task: Task, chain: ClosedChain) -> Task:
    """It follows way-points, so slowly that no tick opens the loops."""
    make = way(chain, "cubic", "round")

    def slowly(key: str, kind: Kind) -> Signal:
        signal = make(key, kind)
        return replace(signal, times=[4.0 * t for t in signal.times])

    return replace(following(task, chain, slowly), gain=1.0)


@pytest.mark.parametrize("name", BY_VELOCITY)
def test_rows_of_what_follows_way_points_are_those_of_python(
    name: str, chain: ClosedChain, closed_loop_walk: Any
) -> None:
    """Errors, Jacobians and rates at random states, of what the kernel evaluates."""
    task = slow(one_of_each(chain)[name], chain)
    law = QPController(engine="kernel").build(problem(chain, task, kappa=0.0))
    assert isinstance(law, KernelLaw)
    program = task.program(State(chain))
    assert (program is not None and all(p.compiles for p in program)) == (name in READ)
    stack = TaskStack([task], State(chain))
    for q, t in zip(closed_loop_walk(chain, 4), (0.1, 0.8, 1.9, 4.6), strict=True):
        state = State(chain, q, t)
        stack.update(state)
        law.tick(State(chain, q, t))
        found = np.reshape(law.whole.engine.rows(0), (-1, chain.n + 2))
        np.testing.assert_allclose(found[:, 0], stack.e, atol=1e-12)
        np.testing.assert_allclose(found[:, 1:-1], stack.J, atol=1e-12)
        np.testing.assert_allclose(found[:, -1], stack.rate, atol=1e-12)


@pytest.mark.few(8)
@pytest.mark.parametrize("name", BY_VELOCITY)
def test_what_follows_way_points_moves_alike(name: str) -> None:
    """Arms with room to move; where NAO's get stuck the optimum itself has fewer digits."""
    chain = ring(2, 7)
    if name == "relative_motion":  # a closed loop contradicts it
        chain = chain.handed_over(chain.q_start, [chain.arms[1].name])
    task = slow(one_of_each(chain)[name], chain)
    seen = drive(problem(chain, task, secondary=[JointCentering(gain=0.5)], limits=LIMITS), 150)
    assert seen.decided == 150, dict(seen.left)
    assert seen.v < SAME


def both(feed: Line | None) -> dict[str, Trace]:
    """A scenario whose goal is an input, by either engine."""
    scenario = load("point_on_point")
    task = replace(scenario.tasks[0], goal=Input(name="target"))
    inputs = {"target": InputSettings(feed=feed, velocity=0.1)}
    scenario = replace(scenario, tasks=(task,), inputs=inputs, duration=2.0)
    return {
        engine: run(
            replace(scenario, controllers={"qp": QPController(engine=engine)}), controller="qp"
        )
        for engine in ("kernel", "python")
    }


@pytest.mark.parametrize("sends", [True, False])
def test_inputs_move_alike_and_are_found_stale(sends: bool) -> None:
    way_there = Line(start=[0.16, -0.02, 0.05], end=[0.16, 0.02, 0.08], period=1.5)
    found = both(way_there if sends else None)
    assert found["kernel"].compiled.all()
    assert found["kernel"].status == found["python"].status
    np.testing.assert_allclose(found["kernel"].q, found["python"].q, atol=1e-9)
    moved: Array = np.ptp(found["kernel"].position, axis=0)
    assert (np.linalg.norm(moved) > 0.03) == sends


def test_what_is_refused_is_said_of_a_tick_without_python(chain: ClosedChain) -> None:
    """Nobody follows the input, and the kernel needs no Python; it is said all the same."""
    law = QPController(engine="kernel").build(problem(chain, one_of_each(chain)["pose"]))
    state = law.start()
    state.inputs.refused = ("target: no such input",)
    assert law.tick(state).causes == (Status.INPUT_REFUSED,)
    assert law.command.note == "target: no such input"
    state.inputs.refused, state.inputs.stale = (), ("target",)
    assert law.tick(state).causes == (Status.INPUT_STALE,)


def test_the_kernel_reads_an_input_itself_wherever_its_arrays_are(chain: ClosedChain) -> None:
    """A target that is written, replaced, of a wrong shape, and gone again: as the plain law."""
    reach = PointOnPoint(name="reach", gain=5.0, goal=Input(name="target"))
    given = problem(chain, reach, limits=LIMITS)
    laws = [QPController(engine=engine).build(given) for engine in ("kernel", "python")]
    states = [law.start() for law in laws]
    statuses: list[Status] = []
    for k in range(60):
        found = []
        for law, state in zip(laws, states, strict=True):
            if k == 0:
                state.inputs = InputValues()
            elif k in (10, 40):  # another object
                state.inputs["target"] = Trajectory(POINT, state.p_WO)
            elif k == 20:  # another array
                state.inputs["target"].value = state.inputs["target"].value.copy()
            elif k == 30:
                state.inputs["target"] = Trajectory(Kind("pair", 2), np.zeros(2))
            elif k == 50:
                del state.inputs["target"]
            if k > 10 and not 30 <= k < 40 and k < 50:
                state.inputs["target"].value[2] += 1e-3
            command = law.step(state)
            found.append(command.v.copy())
            statuses.append(command.status)
        assert laws[0].compiled == (not 30 <= k < 40)
        np.testing.assert_allclose(found[0], found[1], atol=SAME)
    assert statuses.count(Status.RAISED) == 20  # ten ticks of each


def test_a_step_in_which_a_signal_raises_once_is_told(
    chain: ClosedChain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tick that decides instead does not ask it again and hide that."""
    x, y, z = chain.start_position.tolist()
    round_ = PointOnPoint(goal=Circle(center=(x, y, z), radius=0.01, period=4.0))
    law = QPController(engine="kernel").build(problem(chain, round_))
    assert isinstance(law, KernelLaw)
    follow, calls = law.whole.follow, iter(range(1000))

    def fails(state: State) -> None:
        if next(calls) == 3:
            raise TimeoutError("no transform")
        follow(state)

    monkeypatch.setattr(law.whole, "follow", fails)
    state = law.start()
    said = [law.step(state).status for _ in range(8)]
    assert said.count(Status.RAISED) == 1
    assert said.count(Status.OPTIMAL) == 7
