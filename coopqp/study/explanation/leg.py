"""A phase of a run as it was: what was asked in it, and what became of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from coopqp.assessment import Assessment, assess
from coopqp.assessment.thresholds import within
from coopqp.checked import Array
from coopqp.controller import ControlProblem
from coopqp.controller_run import controller_of
from coopqp.errors import InvalidValueError
from coopqp.row import Row
from coopqp.scenario.scenario import Scenario
from coopqp.signal import Followed
from coopqp.solver import Status, causes_of
from coopqp.study.explanation.goal import PartOfTask, parts_of
from coopqp.trace import Failure, InputTrace, PhaseInfo, TaskInfo, Trace, followed, join


@dataclass(frozen=True, kw_only=True)
class Recording:
    """What a trace tells of one controller's run.

    Attributes:
        controller: its name.
        q: shape (T + 1, n). v: shape (T, n) [rad, m; rad/s, m/s].
        status: of each tick, as written.
        errors: at the end of its phase, by the name of each part of a task.
        tau: of each tick, shape (T, n) [N m, N]; empty where there are none.
        loop: largest loop errors, shape (T + 1, 2) [m, rad].
        inputs: what was followed, by name.
        assessment: of a run in memory; one that was read from a file is assessed by what it has.
        place: file and line where the names of errors stand, of a run that was read from one.
    """

    controller: str
    q: Array
    v: Array
    status: tuple[str, ...]
    errors: Mapping[str, float]
    tau: Array
    loop: Array
    inputs: Mapping[str, InputTrace] = field(default_factory=dict)
    assessment: Assessment | None = None
    place: str = ""


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A phase of a run.

    Attributes:
        problem: what the controller was built for; without limits where it heeds none.
        phase: its index in the schedule. name: its name, empty where there is one only.
        first: its first tick.
        q: shape (K + 1, n). v: shape (K, n). tau: shape (K, n), or empty.
        causes: of each tick.
        inputs: what was followed in the whole run, by name.
        parts: of all tasks. errors: at the end, by the parts' order [the part's unit].
    """

    problem: ControlProblem
    phase: int
    name: str
    first: int
    q: Array
    v: Array
    tau: Array
    causes: tuple[tuple[Status, ...], ...]
    parts: tuple[PartOfTask, ...]
    errors: Array
    inputs: Mapping[str, InputTrace]

    def followed(self, k: int) -> Followed:
        """What was made of the inputs in a tick of the leg."""
        return followed(self.inputs, self.first + k)

    @property
    def t_end(self) -> float:
        """Since the phase began [s]."""
        return len(self.v) * self.problem.dt

    @property
    def missed(self) -> tuple[tuple[PartOfTask, float], ...]:
        """Parts that ended outside their tolerance, with their errors.

        Those of hard tasks first, then of scaled ones; of these and of the soft ones the worst.
        """
        found = [
            (part, float(error))
            for part, error in zip(self.parts, self.errors, strict=True)
            if not within(float(error), part.part.tolerance)
        ]
        rank = ("hard", "scaled", "soft").index
        return tuple(
            sorted(found, key=lambda p: (rank(p[0].task.mode), -p[1] / p[0].part.tolerance))
        )


def recording_of(trace: Trace) -> Recording:
    """A run in memory."""
    found = assess(trace)
    return Recording(
        controller=trace.controller,
        q=trace.q,
        v=trace.v,
        status=trace.status,
        errors={task.name: task.error for task in found.tasks},
        tau=trace.signals.get("tau", np.zeros((0, 0))),
        loop=np.column_stack([trace.loop_position, trace.loop_orientation]),
        inputs=trace.inputs,
        assessment=found,
    )


def assessed(scenario: Scenario, run: Recording) -> Assessment:
    """The assessment of a recorded run.

    Args:
        scenario: as the controller holds it, :meth:`Scenario.held_by`.
        run: of the controller.
    """
    if run.assessment:
        return run.assessment
    phases = [
        (PhaseInfo(leg.name, leg.first, ()), _trace(scenario, run, leg))
        for leg in legs(scenario, run)
    ]
    trace = join(phases) if scenario.phases else phases[0][1]
    return assess(replace(trace, inputs=dict(run.inputs)))


def _trace(scenario: Scenario, run: Recording, leg: Leg) -> Trace:
    """What an assessment needs of a phase; what no file has is left empty."""
    chain, dt, ticks = leg.problem.chain, leg.problem.dt, len(leg.v)
    loop = run.loop[leg.first : leg.first + ticks + 1]
    margins: dict[Row, Array] = {}
    starts: dict[Row, Array] = {}
    for limit in scenario.limits:
        margins |= limit.margins(chain, leg.q, leg.v, dt)
        starts |= limit.margins(chain, leg.q[[0, 0]], np.zeros_like(leg.q[:1]), dt)
    usable = [causes[0].usable for causes in leg.causes]
    some = np.zeros((ticks + 1, 0))
    return Trace(
        controller=run.controller, solver=None, engine=None, dt=dt, kappa=leg.problem.kappa,
        joints=chain.joint_names, units=chain.joint_units, lower=chain.lower, upper=chain.upper,
        velocity=chain.velocity, effort=chain.model.effortLimit.copy(),
        tasks=tuple(
            TaskInfo(p.name, p.part.unit, p.part.tolerance, p.task.end) for p in leg.parts
        ),
        leverage=np.ones(len(leg.parts)), t=np.arange(ticks + 1.0, dtype=float) * dt,
        q=leg.q, v=leg.v,
        commanded=leg.q[:-1], measured=leg.q[:-1], gap=some[1:], memory=some[1:],
        position=some, rotation=some, loop_position=loop[:, 0], loop_orientation=loop[:, 1],
        task_error=np.tile(leg.errors, (ticks + 1, 1)), goal_error=some, task_rows=(), e=some,
        rate=np.ones((ticks + 1, 1)),  # whether references move is not recorded
        usable=np.array(usable, bool), inaccurate=np.zeros(ticks, bool),
        status=run.status[leg.first : leg.first + ticks], scale=np.ones(ticks), margins=margins,
        starts={row: float(left[0]) for row, left in starts.items()},
        compiled=np.zeros(ticks, bool), tick_us=np.zeros(ticks), points={},
        heeds=controller_of(scenario, run.controller).heeds,
        failures=tuple(
            Failure(k, causes[0].value) for k, causes in enumerate(leg.causes) if not usable[k]
        ),
        signals={"tau": leg.tau} if leg.tau.size else {},
    )  # fmt: skip


def legs(scenario: Scenario, run: Recording) -> Iterator[Leg]:
    """The phases of a run, each with its own chain.

    Args:
        scenario: as the controller holds it, :meth:`Scenario.held_by`.
        run: of the controller.
    """
    ends = (*scenario.first_ticks, scenario.ticks)
    problems = scenario.problems(lambda first: run.q[first])
    heeds = "limits" in controller_of(scenario, run.controller).heeds
    spans = zip(problems, scenario.schedule, pairwise(ends), strict=True)
    for i, (problem, phase, (first, end)) in enumerate(spans):
        parts = tuple(parts_of(phase.tasks, problem.chain))
        begin = f"{phase.name}." if scenario.phases else ""
        names = [begin + part.name for part in parts]
        for name in names:
            if name not in run.errors:
                words = "the trace is of another scenario than the one beside it"
                where = f"{run.place}: " if run.place else ""
                raise InvalidValueError(f"{where}no error of '{name}' in the trace; {words}")
        ticks = slice(first, end)
        yield Leg(
            problem=problem if heeds else replace(problem, limits=()),
            phase=i,
            name=phase.name,
            first=first,
            q=run.q[first : end + 1],
            v=run.v[ticks],
            tau=run.tau[ticks],
            causes=tuple(causes_of(word) for word in run.status[ticks]),
            parts=parts,
            errors=np.array([run.errors[name] for name in names], float),
            inputs=run.inputs,
        )
