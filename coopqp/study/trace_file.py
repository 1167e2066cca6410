"""What a recorded run tells: the whole run, a tick done again, and what the sensors measured.

A run is given as read, or by its path, with the scenario that it was written for. A file that is
damaged, or of another scenario, is refused with the line that shows it.
"""

import math
from bisect import bisect_right
from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path

import numpy as np

from coopqp.assessment import assess
from coopqp.assessment.assessment import FORCES
from coopqp.assessment.limits import audit
from coopqp.base.errors import CoopqpError, InvalidValueError, UnknownNameError
from coopqp.base.reading import absolute
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem, Law
from coopqp.controllers.qp import QPController
from coopqp.execution.controller_run import controller_of
from coopqp.execution.instants import parts_of, rows_of
from coopqp.model.state import State
from coopqp.plant import Disturbance
from coopqp.plants import Kinematic
from coopqp.recordings import format_of, read
from coopqp.recordings.column import Layout, of_field
from coopqp.recordings.csv_file import CsvFile
from coopqp.recordings.run import OTHER, Run
from coopqp.scenario.input import wanted
from coopqp.scenario.scenario import Scenario
from coopqp.signal import InputValues, Kind
from coopqp.solver import HALTS, Status, causes_of
from coopqp.study.tick_record import TickRecord, record_tick
from coopqp.trace import Failure, InputTrace, PhaseInfo, TaskInfo, Trace, followed, join, no_input

#: What times may be off by, as a share of a tick, and joints that do as told [rad, m].
OF_A_TICK, ROUNDING = 0.01, 1e-9


def trace_from_file(path: Path | Run, scenario: Scenario, controller: str) -> Trace:
    """A controller's whole run, as far as a file tells it; what it does not is left empty."""
    run, held = read(path).of(controller), scenario.held_by(controller)
    ticks = held.ticks
    if len(run) != ticks + 1:
        raise CoopqpError(
            f"{run.place(min(ticks + 1, len(run) - 1))}: '{controller}' has {len(run) - 1} "
            f"ticks, its scenario {ticks}; the file is damaged, of another scenario, or of a live "
            "loop, of which only a tick can be explained: name it with --tick"
        )
    status = run.columns["status"][:ticks].tolist()
    if "" in status:
        raise run.fault(status.index(""), "status: found nothing, needs what became of the tick")
    _check_moves(run, held)
    q = run.joints("q", held.chain.joint_names)
    v = np.nan_to_num(run.joints("v", held.chain.joint_names, empty=True))
    ends, parts = pairwise((*held.first_ticks, ticks)), []
    problems = held.problems(lambda first: q[first])
    for problem, phase, (first, end) in zip(problems, held.schedule, ends, strict=True):
        begin = f"{phase.name}." if held.phases else ""
        v_before = v[first - 1] if first else None
        part = _phase(run.only(slice(first, end + 1)), problem, begin, v_before)
        parts.append((PhaseInfo(phase.name, first, phase.released), part))
    steps = run.only(slice(ticks))
    inputs = {name: _input(steps, name, kind) for name, kind in held.followed().items()}
    signals = {
        "tau": steps.joints("tau", held.chain.joint_names, empty=True),  # passive joints have none
        "held": steps.numbers(["held"], empty=True),
        "push": steps.numbers(of_field("push", Layout(joints=())), empty=True),
    }
    signals = {name: np.nan_to_num(of) for name, of in signals.items() if np.isfinite(of).any()}
    trace = join(parts) if held.phases else parts[0][1]
    supports = controller_of(held, controller).supports
    return replace(trace, inputs=inputs, signals=signals, supports=supports)


def worth_explaining(run: Run, scenario: Scenario) -> Trace:
    """The run of the first controller that falls short, those that solve QPs before others.

    Where all succeed, the first of them.
    """
    own = scenario.controllers
    names = sorted(run.controllers, key=lambda name: not (name in own and own[name].uses_solver))
    for name in names:
        trace = trace_from_file(run, scenario, name)
        if not assess(trace).succeeds:
            return trace
    return trace_from_file(run, scenario, names[0])


def _phase(run: Run, problem: ControlProblem, begin: str, v_before: Array | None) -> Trace:
    """The rows of one phase, with its end; with ``begin`` the names of its tasks begin there."""
    chain, dt, steps = problem.chain, problem.dt, run.only(slice(-1))
    joints, ticks, nothing = chain.joint_names, len(steps), np.zeros((len(run), 0))
    q, v = run.joints("q", joints), steps.joints("v", joints)
    loop = run.numbers(["loop_position", "loop_orientation"])
    every = (*problem.tasks, *problem.wrenches)
    tasks, rows = tuple(info for info, _ in parts_of(every, chain)), rows_of(every, chain)
    layout = Layout(
        joints=(),
        tasks=tuple(begin + of.name for of in tasks),
        rows=tuple(begin + row for row in rows),
    )
    e, rate = (run.numbers(of_field(name, layout), empty=True) for name in ("e", "rate"))
    causes = [causes_of(word)[0] for word in steps.columns["status"]]
    failed = (Failure(k, cause.value) for k, cause in enumerate(causes) if not cause.usable)
    return Trace(
        controller=run.controllers[0], solver=None, engine=None, dt=dt, kappa=problem.kappa,
        joints=joints, units=chain.joint_units, lower=chain.lower, upper=chain.upper,
        velocity=chain.velocity, effort=chain.model.effortLimit.copy(),
        tasks=tasks, manipulability=np.ones(len(tasks)),
        t=np.arange(ticks + 1.0) * dt, q=q, v=v, commanded=q[:-1], measured=q[:-1],
        loop_offset=nothing[1:], memory=nothing[1:], position=nothing, rotation=nothing,
        loop_position=loop[:, 0], loop_orientation=loop[:, 1],
        task_error=_errors(run, layout, tasks), goal_error=nothing,
        task_rows=rows, e=e, rate=rate,
        status=tuple(steps.columns["status"].tolist()), scale=np.ones(ticks),
        compiled=np.zeros(ticks, bool), tick_us=np.zeros(ticks), points={}, supports=frozenset(),
        failures=tuple(failed),
        **vars(audit(problem.limits, chain, q, v, dt, v_before)),
    )  # fmt: skip


def _errors(run: Run, layout: Layout, tasks: Sequence[TaskInfo]) -> Array:
    """Of each part of each task, shape (ticks + 1, parts); forces may be told by nobody."""
    columns = of_field("error", layout)
    for name, column in zip(layout.tasks, columns, strict=True):
        if column not in run.columns:
            raise CoopqpError(f"{run.header}: has no error of '{name}'; {OTHER}")
    errors, known = run.numbers(columns, empty=True), [of.unit not in FORCES for of in tasks]
    usable = np.array([bool(word) and causes_of(word)[0].usable for word in run.columns["status"]])
    lost = np.argwhere(np.isnan(errors) & known & usable[:, None])
    if len(lost):
        k, i = lost[0].tolist()
        raise run.fault(k, f"{columns[i]}: found nothing, needs a finite number")
    return errors


def check_trace(run: Run, scenario: Scenario, controller: str) -> None:
    """Refuse a controller's run that is damaged, or of another scenario.

    A live loop's run, which is in no CSV file, is as long as it was, with gaps where nobody ticked.
    """
    if isinstance(format_of(run.path), CsvFile):
        trace_from_file(run, scenario, controller)


def _check_moves(run: Run, scenario: Scenario) -> None:
    """Refuse what no run can have had: q + v dt is the next q where joints do exactly as told."""
    dt, t, joints = scenario.dt, run.numbers(["t"])[:, 0], scenario.chain.joint_names
    off = np.abs(t - dt * np.arange(len(t))) > OF_A_TICK * dt
    if off.any():
        k = int(off.argmax())
        words = f"t: found {t[k]:g}, needs {k * dt:g} at a dt of {dt:g} s"
        raise CoopqpError(f"{run.place(k)}: {words}; {OTHER}")
    if not isinstance(scenario.plant, Kinematic) or scenario.disturbance != Disturbance():
        return
    q, v = run.joints("q", joints), run.only(slice(-1)).joints("v", joints)
    expected = np.vstack([scenario.chain.q_start, q[:-1] + dt * v])
    moved = np.abs(q - expected) > ROUNDING * np.maximum(1.0, np.abs(q))
    moved[[first + 1 for first in scenario.first_ticks[1:]]] = False  # hands may have let go
    moved[1:][(q[1:] == q[:-1]).all(axis=1)] = False  # the plant broke down
    if moved.any():
        k, i = np.argwhere(moved)[0].tolist()
        words = f"q[{joints[i]}]: found {q[k, i]:g}, but it was moved to {expected[k, i]:g}"
        raise CoopqpError(f"{run.place(k)}: {words}; {OTHER}")


def _input(run: Run, name: str, kind: Kind) -> InputTrace:
    """What was followed, and when it was sent."""
    layout = Layout(joints=(), inputs={name: kind})
    value, rate = (
        run.numbers(of_field(key, layout), empty=True) for key in ("followed", "followed_rate")
    )
    sent = run.numbers([f"input[{name}].sent"], empty=True)[:, 0]
    return replace(no_input(kind, len(run)), value=value, rate=rate, sent=sent)


def recorded_tick(
    path: Path | Run, scenario: Scenario, controller: str | None = None, tick: int | None = None
) -> TickRecord:
    """Do a tick of a trace again and keep it.

    Where a live loop came to rest instead, its law's problem is kept, with what the loop said.
    Without a controller it is the first QP controller of the trace, without a tick the first that
    relaxed something, else the last.
    """
    run, known = read(path), scenario.controllers
    solving = [name for name in run.controllers if isinstance(known.get(name), QPController)]
    if not solving:
        raise InvalidValueError(f"{run.path}: no controller here solves a QP in velocities")
    chosen = controller or solving[0]
    if chosen not in solving:
        raise UnknownNameError("QP controller", chosen, solving, f"{run.path}: ")
    k = blocked_tick(run, chosen) if tick is None else tick
    held, plugin = scenario.held_by(chosen), known[chosen]
    assert isinstance(plugin, QPController)
    law = plugin.plain(held.problem())
    phase = max(0, bisect_right(held.first_ticks, k) - 1)
    if phase:
        # The arms that hold from here on took hold where the trace says that they were.
        problems = held.problems(lambda first: state_from_trace(run, chosen, first, law).q)
        law = plugin.plain(next(islice(problems, phase, None)))
    state = state_from_trace(run, chosen, k, law, held.first_ticks[phase] * held.dt)
    name = absolute(run.path.parent).name
    record = record_tick(law, state, scenario=name, controller=chosen, tick=k)
    rested = _halted(run, chosen, k)
    return replace(record, status=rested) if rested else record


def off_the_record(path: Path | Run, record: TickRecord) -> float:
    """How far a tick that was done again is from the velocities that were recorded [rad/s, m/s].

    More than rounding says that its scenario is not the one that was run, or that the code is not.
    """
    run = read(path).of(record.controller)
    row = _row_of(run, record.tick)
    if row is None or _halted(run, record.controller, record.tick):
        return 0.0  # the law did not make it
    joints = [x.joint for x in record.variables if x.joint]
    was = run.only([row]).joints("v", joints, empty=True)[0]
    now = np.array([x for x, of in zip(record.answer, record.variables, strict=True) if of.joint])
    return float(np.nanmax(np.abs(was - now), initial=0.0))


def state_from_trace(run: Run, controller: str, tick: int, law: Law, t_start: float = 0.0) -> State:
    """The state that a tick of a recorded run decided from; the law's tick repeats it.

    The observer had made the loop offset of the measured joints already, and who squeezes of the
    forces, so neither adds to it. The law gives the joints; its phase began at t_start [s].
    """
    run = run.of(controller).ticks
    joints, state = law.problem.chain.joint_names, law.start()
    own, before = _row_of(run, tick), _row_of(run, tick - 1)
    if own is None or (before is None and tick):
        words = f"has tick {tick}, but not the one before it, which it follows from"
        if own is None:
            last = max(run.columns["tick"].tolist(), default=0)
            words = f"has no tick {tick}; it has 0 to {last}"
        raise InvalidValueError(f"{run.path}: controller '{controller}' {words}")
    row = run.only([own])
    state.t = max(0.0, float(row.numbers(["t"])[0, 0]) - t_start)  # of the phase, but for rounding
    commanded = np.isfinite(row.joints("commanded", joints, empty=True)).any()
    state.q[:] = row.joints("commanded" if commanded else "q", joints)
    if before is not None:
        state.v[:] = run.only([before]).joints("v", joints)
    kept = {"loop_offset": state.loop_offset, "memory": state.memory.numbers}
    layout = Layout(joints=joints, loops=len(kept["loop_offset"]) // 6, memory=len(kept["memory"]))
    for name, numbers in kept.items():
        numbers[:] = np.nan_to_num(row.numbers(of_field(name, layout), empty=True))
    if np.isfinite(run.joints("measured", joints, empty=True)).any():
        state.q_measured = row.joints("measured", joints, empty=True)[0]
        state.corrected = 0.0
    causes = causes_of(row.columns["status"][0])
    if Status.FORCE_NOT_MEASURED not in causes:
        state.hand_wrench = np.zeros(6 * len(law.problem.chain.robot.arms))
    state.inputs = _followed(row, law, causes)
    state.update()
    return state


def _followed(row: Run, law: Law, causes: Collection[Status]) -> InputValues:
    """What was made of the inputs in a tick."""
    asked = wanted(law.problem.all_tasks, law.start()).items()
    found = followed({name: _input(row, name, kind) for name, (kind, _) in asked}, 0)
    found.stale = tuple(found) if Status.INPUT_STALE in causes else ()
    found.refused = tuple(found) if Status.INPUT_REFUSED in causes else ()
    return found


def _row_of(run: Run, tick: int) -> int | None:
    rows = np.flatnonzero(run.columns["tick"] == tick)
    return int(rows[0]) if len(rows) else None


def _halted(run: Run, controller: str, tick: int) -> str:
    """The causes of a tick at rest, in which a live loop's time stands still; empty of others."""
    run = run.of(controller)
    row, t = _row_of(run.ticks, tick), run.columns["t"]
    status = "" if row is None else str(run.columns["status"][row])
    stands = row is not None and row + 1 < len(run) and t[row + 1] <= t[row]
    return status if stands or (status and HALTS.intersection(causes_of(status))) else ""


def blocked_tick(run: Run, controller: str) -> int:
    """The tick worth explaining: the first that gave something up or failed, else the last."""
    run = run.of(controller).ticks
    fine = np.isin(run.columns["status"], (Status.OPTIMAL.name, Status.INACCURATE.name))
    ticks = run.columns["tick"]
    return int(ticks[fine.argmin()] if not fine.all() else ticks[-1]) if len(ticks) else 0


def measured_run(
    path: Path | Run, scenario: Scenario, controller: str | None = None
) -> tuple[str, Array]:
    """The controller's name, and where sensors said that its joints are, shape (T, n) [rad, m].

    The real loops are closed. An arm that has let go takes hold otherwise than before, so that what
    comes after is of another grasp. On the plant ``kinematic`` nothing holds the hands together:
    only the first tick counts. Without a controller it is the first for which sensors measured
    something.
    """
    run, phases = read(path), zip(scenario.schedule, scenario.first_ticks, strict=True)
    arms = set(scenario.schedule[0].released)
    anew = next((first for phase, first in phases if set(phase.released) != arms), math.inf)
    for name in run.controllers if controller is None else (controller,):
        own = run.of(name)
        joints = scenario.held_by(name).chain.joint_names
        own.joints("q", joints)  # else it is of another scenario
        q = own.only(own.columns["tick"] < anew).joints("measured", joints, empty=True)
        q = q[np.isfinite(q).all(axis=1)]
        if len(q):
            return name, q[:1] if isinstance(scenario.plant, Kinematic) else q
    raise InvalidValueError(
        f"{run.path}: nothing to calibrate: no sensors say where the joints are; joints of the "
        "plant kinematic do exactly as told unless the scenario has a disturbance"
    )
