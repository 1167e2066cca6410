"""Run one controller through all phases of a scenario, or from many starts on several threads.

A comparison, the page of ``coopqp play`` and the loop for robots differ in who measures and who
sends inputs. How a phase begins, ends and hands over is the same: the next phase begins at the
measured joints, with their speed, and the hands that then hold the object hold it where it is.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from coopqp.base.errors import CoopqpError, InternalError, InvalidValueError, UnknownNameError
from coopqp.base.spec import Array, array, finite
from coopqp.base.wording import by_user, raised
from coopqp.controller import MAX_TICKS, Controller, ControlProblem, Law
from coopqp.execution.rollout import rollout
from coopqp.model.state import State
from coopqp.plant import PlantModel
from coopqp.scenario.input import Feed, Inputs
from coopqp.scenario.scenario import Phase, Scenario, needs_scenario
from coopqp.solver import Status
from coopqp.trace import PhaseInfo, TickBatch, Trace, join

#: After these there is no next phase.
ENDED = (Status.PLANT_FAILED.value, Status.OBJECT_LOST.value)

Progress = Callable[[str, int], None]
"""Called now and then with the controller's name and the number of ticks it has done."""


class Measured(NamedTuple):
    """A robot that replaces the plant."""

    q: Array | None  # as measured, shape (n,) [rad, m]; the chain's start when None
    observed: bool  # whether q stays a measurement, from which commands may differ
    X_WO: pin.SE3 | None = None  # where the standing object was seen; where it was put when None

    def start(self, law: Law) -> State:
        """The state of a law's first tick there."""
        return law.start(q_measured=self.q) if self.observed else law.start(self.q)


@dataclass
class PhaseRun:
    """A phase while it runs."""

    scenario: Scenario  # as the controller holds it, :meth:`Scenario.held_by`
    controller: Controller
    index: int  # of the phase in the schedule
    first: int  # number of ticks of the phases before it
    problem: ControlProblem
    law: Law
    plant: PlantModel | None  # None where a robot takes its place
    inputs: Inputs
    state: State  # now; whoever runs the phase leaves it at its end
    ticks: int = 0  # number of ticks done

    @property
    def phase(self) -> Phase:
        return self.scenario.schedule[self.index]

    @property
    def since(self) -> float:
        """Its start in the time of the scenario [s]."""
        return self.first * self.problem.dt

    @property
    def over(self) -> bool:
        return self.ticks >= self.phase.ticks(self.problem.dt)

    @property
    def is_last(self) -> bool:
        return self.index + 1 == len(self.scenario.schedule)

    @property
    def q(self) -> Array:
        """Where the joints are, by the sensors where there are any, shape (n,) [rad, m]."""
        measured = self.plant.measured if self.plant else self.state.q_measured
        return self.state.q if measured is None else measured

    def feed(self) -> Feed | None:
        """The scenario's senders to the inputs; None where nothing follows any."""
        return Feed(self.scenario.inputs, self.inputs, self.since) if self.inputs.move else None


def begin_phase(
    scenario: Scenario,
    controller: Controller,
    before: PhaseRun | None = None,
    *,
    robot: Measured | None = None,
    timed: bool = True,
) -> PhaseRun:
    """Build what a phase needs, of a scenario as the controller holds it.

    ``before`` has been run; ``robot`` replaces the plant. Where ticks are ``timed`` none may wait
    for what is built late. CoopqpError: the law or the plant cannot be built, or a task wants an
    input that is not there, or as what it cannot be.
    """
    index = before.index + 1 if before else 0
    phase, chain = scenario.schedule[index], None
    if before:
        where = before.q if robot is None or robot.q is None else robot.q
        seen = robot.X_WO if robot else None
        chain = before.problem.chain.handed_over(where, phase.released, seen)
    problem = scenario.problem(phase, chain)
    law = controller.build(problem) if timed else controller.unprepared(problem)
    plant = None
    if robot:
        if law.force_control and not robot.observed:
            raise InvalidValueError(
                'reference: found "measured"; hands that squeeze by admittance need "commanded", '
                "because what they press is how far the commands lead"
            )
        state = robot.start(law)
    else:
        plant = scenario.simulated(law.problem)
        if law.force_control and plant.hand_wrench is None:
            raise InvalidValueError(
                f"controller '{controller.name}' squeezes by measured forces, and this plant "
                "tells none (signal hand_wrench); use plant: mujoco or plant: rigid_body"
            )
        if before and before.plant:  # the new plant begins where that one has ended
            plant.resume(before.plant)
        state = law.start(q_measured=plant.measured, hand_wrench=plant.hand_wrench)
    if before:
        state.v[:], state.observer_state[0] = before.state.v, before.state.observer_state[0]
    return PhaseRun(
        scenario=scenario,
        controller=controller,
        index=index,
        first=before.first + before.ticks if before else 0,
        problem=problem,
        law=law,
        plant=plant,
        inputs=Inputs(scenario.inputs, problem.all_tasks, state, problem.dt),
        state=state,
    )


def run(
    scenario: Scenario, *, controller: str, progress: Progress | None = None, timed: bool = True
) -> Trace:
    """Run one controller of a scenario.

    Args:
        scenario: from :func:`coopqp.load`.
        controller: its name in the scenario, or any controller's type name.
        progress: called every few ticks.
        timed: whether ticks are timed; if not, many are computed at once on plants without errors,
            which is faster, and :attr:`Trace.tick_us` is NaN.

    Raises:
        UnknownNameError: no such controller.
        CoopqpError: the controller or the plant cannot be built for this scenario.
    """
    needs_scenario(scenario)
    chosen = controller_of(scenario, controller)
    check_plant(scenario, chosen, controller)
    scenario.check_size()
    parts: list[tuple[PhaseInfo, Trace]] = []
    begun: PhaseRun | None = None

    with _one_line_errors(controller):
        held = scenario.held_by(controller)
        for phase in held.schedule:
            begun = begin_phase(held, chosen, begun, timed=timed)
            assert begun.plant is not None  # no robot takes its place
            begun.ticks = phase.ticks(held.dt)
            trace = rollout(
                begun.law,
                begun.plant,
                begun.ticks,
                controller=controller,
                solver=scenario.solver_name if chosen.uses_solver else None,
                supports=chosen.supports,
                progress=progress and partial(_advance, progress, controller, begun.first),
                state=begun.state,
                feed=begun.feed(),
                timed=timed,
            )
            parts.append((PhaseInfo(phase.name, begun.first, phase.released), trace))
            if not begun.is_last and trace.failures and trace.failures[-1].cause in ENDED:
                words = f"phase '{phase.name}' does not end: {trace.failures[-1].note}"
                raise InvalidValueError(f"{controller}: {words}")
        return join(parts) if scenario.phases else parts[0][1]


def _advance(progress: Progress, controller: str, first: int, k: int) -> None:
    progress(controller, first + k)


def built(scenario: Scenario, controller: str) -> PhaseRun:
    """The first phase of a run, built and not run; arguments and errors as for :func:`run`."""
    chosen = controller_of(scenario, controller)
    check_plant(scenario, chosen, controller)
    with _one_line_errors(controller):
        return begin_phase(scenario.held_by(controller), chosen)


def check_plant(scenario: Scenario, chosen: Controller, name: str) -> None:
    """Raise InvalidValueError for a torque controller where the plant takes no torques."""
    if chosen.commands_torques and not scenario.plant.takes_torques:
        raise InvalidValueError(
            f"controller '{name}' commands torques, which this plant does not take; use "
            "plant: rigid_body or plant: mujoco"
        )


@contextmanager
def _one_line_errors(controller: str) -> Iterator[None]:
    """Turn unexpected errors into one line, so that other controllers can be run all the same."""
    try:
        yield
    except (CoopqpError, KeyboardInterrupt):
        raise
    except BaseException as error:
        kind = InvalidValueError if by_user(error) else InternalError
        raise kind(f"{controller}: {raised(error)}") from error


def controller_of(scenario: Scenario, name: str) -> Controller:
    """A controller of a scenario, or of its catalogue by type name; or UnknownNameError."""
    if name in scenario.controllers:
        return scenario.controllers[name]
    known = scenario.catalog.entries("controllers")
    if name not in known:
        raise UnknownNameError("controller", str(name), {*known, *scenario.controllers})
    chosen = known[name].cls()
    assert isinstance(chosen, Controller)  # what the catalogue holds there
    return chosen


#: Motions that a thread takes at a time, and their ticks: so long Ctrl-C waits.
CHUNK, AT_ONCE = 16, 200_000


@dataclass(frozen=True)
class Motions:
    """M motions of T ticks each."""

    q: Array  #: Joints before each tick and at the end, shape (M, T + 1, n) [rad, m].
    v: Array  #: Commands, shape (M, T, n) [rad/s, m/s].
    outcomes: NDArray[np.uint8]  #: Of each tick, an index of ``causes``, shape (M, T).
    causes: tuple[tuple[Status, ...], ...]  #: All outcomes; the first is OPTIMAL alone.
    compiled: NDArray[np.bool_]  #: Whether the kernel decided the tick, shape (M, T).

    def share(self, status: Status) -> float:
        """Share of all ticks with a status."""
        among = [i for i, causes in enumerate(self.causes) if status in causes]
        return float(np.isin(self.outcomes, among).mean()) if self.outcomes.size else 0.0


def run_many(
    scenario: Scenario,
    starts: ArrayLike,
    *,
    controller: str = "qp",
    ticks: int | None = None,
    threads: int | None = None,
) -> Motions:
    """Run one controller from many starts, on ideal joints and without inputs from outside.

    Each motion is ``law.run(law.start(q), ticks)``, bit for bit, whatever the number of threads.
    Where nothing of the tasks, limits and signals is Python's, it is computed in C++ as a whole and
    without Python's lock.

    Args:
        scenario: from :func:`coopqp.load`, without phases; references set out from its own start.
        starts: joints, shape (M, n) [rad, m].
        controller: its name in the scenario, or any controller's type name.
        ticks: of each motion; the scenario's when omitted.
        threads: one a processor when omitted.

    Raises:
        InvalidValueError: an argument is none of these, or the controller commands torques.
        CoopqpError: the controller cannot be built for this scenario.
    """
    needs_scenario(scenario)
    chosen, n = controller_of(scenario, controller), scenario.chain.n
    if scenario.phases or chosen.commands_torques:
        what = "phases" if scenario.phases else "torques"
        raise InvalidValueError(f"run_many: found {what}, needs one motion in velocities")
    given = np.ascontiguousarray(finite("starts", array("starts", starts)))
    if given.ndim != 2 or given.shape[1] != n:
        raise InvalidValueError(f"starts: found shape {given.shape}, needs (M, {n})")
    count = _whole("threads", threads, os.cpu_count() or 1, 1)
    steps = _whole("ticks", ticks, scenario.ticks, 0)
    problem = scenario.held_by(controller).problem()
    useful = max(1, -(-len(given) // CHUNK))
    return _run_all([chosen.unprepared(problem) for _ in range(min(count, useful))], given, steps)


def _run_all(laws: Sequence[Law], starts: Array, ticks: int) -> Motions:
    m, n = starts.shape
    try:
        q, v = np.empty((m, ticks + 1, n)), np.empty((m, ticks, n))
        outcomes = np.zeros((m, ticks), np.uint8)
    except MemoryError:
        words = f"found {m} motions of {ticks} ticks, needs fewer: they do not fit into memory"
        raise InvalidValueError(f"starts: {words}") from None
    size = max(1, min(CHUNK, AT_ONCE // max(ticks, 1)))
    free, plain = deque(laws), dict[int, TickBatch]()

    def run(first: int) -> None:
        law, part = free.pop(), slice(first, first + size)
        try:
            done = law.run_starts(starts[part], q[part], v[part], outcomes[part])
            for i in (first + np.flatnonzero(done < ticks)).tolist():  # in which Python decides
                plain[i] = law.run(law.start(starts[i]), ticks)
        finally:
            free.append(law)

    with ThreadPoolExecutor(len(laws)) as pool:
        list(pool.map(run, range(0, m, size)))
    compiled, index = np.ones((m, ticks), bool), np.zeros(256, np.uint8)
    causes: dict[tuple[Status, ...], int] = {(Status.OPTIMAL,): 0}
    by_kernel = np.isin(np.arange(m), list(plain), invert=True)
    for outcome in np.unique(outcomes[by_kernel]).tolist():
        index[outcome] = causes.setdefault(laws[0].outcomes[outcome], len(causes))
    outcomes[by_kernel] = index[outcomes[by_kernel]]
    for i, made in sorted(plain.items()):
        q[i], v[i], compiled[i] = made.q, made.v, made.compiled
        outcomes[i] = [causes.setdefault(all_of, len(causes)) for all_of in made.causes]
    return Motions(q, v, outcomes, tuple(causes), compiled)


def _whole(name: str, value: int | None, omitted: int, lower: int) -> int:
    found = omitted if value is None else value
    if type(found) is not int or not lower <= found <= MAX_TICKS:
        words = f"found {value!r}, needs a whole number, {lower} to {MAX_TICKS}"
        raise InvalidValueError(f"{name}: {words}")
    return found
