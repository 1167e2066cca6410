"""A tick of a written trace, whole: the law that made it and the state that it began with."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from coopqp.controllers.qp import QPController
from coopqp.errors import InvalidValueError, UnknownNameError
from coopqp.qp_law.law import QPLaw
from coopqp.reading import absolute
from coopqp.recordings.known import read
from coopqp.recordings.run import Run
from coopqp.scenario.scenario import Scenario
from coopqp.study.tick_record import TickRecord, record_tick
from coopqp.study.trace_file import blocked_tick, halted, row_of, state_from_trace


def recorded_tick(
    path: Path | Run, scenario: Scenario, controller: str | None = None, tick: int | None = None
) -> TickRecord:
    """Do a tick of a trace again and keep it.

    Where a live loop came to rest instead, its law's problem is kept, with what the loop said.

    Args:
        path: of ``trace.csv``, or of a run in another format; or the run, as read.
        scenario: that it was written for.
        controller: whose; the first QP controller of the trace when None.
        tick: which; the first that gave something up when None, else the last.

    Raises:
        CoopqpError: no such file, controller or tick; no controller that solves a QP.
    """
    run = read(path)
    laws = _qp_laws(scenario, run.controllers)
    if not laws:
        raise InvalidValueError(f"{run.path}: no controller here solves a QP in velocities")
    chosen = controller or next(iter(laws))
    if chosen not in laws:
        raise UnknownNameError("QP controller", chosen, laws, f"{run.path}: ")
    k = blocked_tick(run, chosen) if tick is None else tick
    held, law = scenario.held_by(chosen), laws[chosen]
    phase = max(0, bisect_right(held.first_ticks, k) - 1)
    if phase:
        # The arms that hold from here on took hold where the trace says that they were.
        problems = held.problems(lambda first: state_from_trace(run, chosen, first, law).q)
        plugin = scenario.controllers[chosen]
        assert isinstance(plugin, QPController)  # as in the first phase
        law = plugin.plain(next(islice(problems, phase, None)))
    state = state_from_trace(run, chosen, k, law, held.first_ticks[phase] * held.dt)
    name = absolute(run.path.parent).name
    record = record_tick(law, state, scenario=name, controller=chosen, tick=k)
    rested = halted(run, chosen, k)
    return replace(record, status=rested) if rested else record


def off_the_record(path: Path | Run, record: TickRecord) -> float:
    """How far a tick that was done again is from the velocities that were recorded [rad/s, m/s].

    More than rounding says that its scenario is not the one that was run, or that the code is not.

    Args:
        path: from where it was recorded; or the run, as read.
        record: of the tick.

    Raises:
        CoopqpError: as :func:`recorded_tick`.
    """
    run = read(path).of(record.controller)
    row = row_of(run, record.tick)
    if row is None or halted(run, record.controller, record.tick):
        return 0.0  # the law did not make it
    joints = [x.joint for x in record.variables if x.joint]
    was = run.only([row]).joints("v", joints, empty=True)[0]
    now = np.array([x for x, of in zip(record.answer, record.variables, strict=True) if of.joint])
    return float(np.nanmax(np.abs(was - now), initial=0.0))


def _qp_laws(scenario: Scenario, names: Sequence[str]) -> dict[str, QPLaw]:
    """The laws of a scenario's controllers that solve a QP in velocities."""
    laws = {}
    for name in names:
        plugin = scenario.controllers.get(name)
        if isinstance(plugin, QPController):
            laws[name] = plugin.plain(scenario.held_by(name).problem())
    return laws
