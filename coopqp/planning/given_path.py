"""The configurations of a path that somebody gives: an array, a recorded run, a table in a file."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.base.errors import InvalidValueError
from coopqp.base.reading import Table, open_bytes, read_table
from coopqp.base.spec import Array
from coopqp.execution.controller_run import run
from coopqp.model.profile import Profile
from coopqp.plant import Disturbance
from coopqp.plants import Kinematic
from coopqp.recordings import read, trace_in
from coopqp.scenario.planned import PHASE, rows_of_phases
from coopqp.scenario.scenario import Scenario
from coopqp.signal import POSE, quaternion_of
from coopqp.signals import Waypoints
from coopqp.task import Task
from coopqp.tasks import Pose
from coopqp.trace import Trace

#: Bytes of a header, by which a recorded run is told from a table of joints.
LINE = 1 << 16
#: Of a run along poses of the object: its duration [s], its law, and how near it comes [m, rad].
SLOW, LAW, CARRIED, CARRIED_ANGLE = 10.0, "qp", 1e-3, 1e-2


def given_path(path: Any, scenario: Scenario, controller: str | None) -> list[Any]:
    """Configurations from whatever has them; those of each phase of a plan with phases."""
    if not isinstance(path, str | Path):
        return [getattr(path, "q", path)]
    joints = scenario.chain.joint_names
    if file := table_of(Path(path)):
        if controller is not None:
            words = "is a table of joints, which no controller ran; leave it out"
            raise InvalidValueError(f"controller: found {controller!r}, and {file} {words}")
        table = read_table(file)
        if set(POSE.columns) <= set(table.columns) and not set(joints) & set(table.columns):
            if others := table.columns.keys() - {"t", PHASE, *POSE.columns}:
                words = f"has columns that are no joints of {scenario.robot_model.name}"
                raise InvalidValueError(f"{file}: {words}: {', '.join(sorted(others)[:3])} ...")
            return [_carried(scenario, table)]
        q, phases = table.take(joints), sum(not one.leads for one in scenario.schedule)
        if PHASE not in table.columns:
            return [q]
        return [q[rows] for rows in rows_of_phases(table, phases)]
    recorded = read(trace_in(Path(path)))
    return [recorded.of(controller or recorded.controllers[0]).joints("q", joints)]


def table_of(path: Path) -> Path | None:
    """The file of a table of joints, from its own or its folder's path; None for a run's."""
    if path.is_dir():
        found = sorted(path.glob("*.csv"))
        tables = [table for table in found if table_of(table)]
        if len(tables) == len(found) > 1:
            names = " and ".join(table.name for table in tables)
            raise InvalidValueError(f"'{path}' has {names}; give one of them, not the folder")
        return tables[0] if len(tables) == len(found) == 1 else None
    if path.suffix == ".csv" and path.is_file():
        with open_bytes(path) as stream:
            return None if b"status" in stream.readline(LINE) else path
    return None


def calm_run(scenario: Scenario, tasks: tuple[Task, ...], seconds: float, law: str = LAW) -> Trace:
    """A law's run with other tasks, by kinematics alone."""
    calm = replace(
        scenario, tasks=tasks, plant=Kinematic(), disturbance=Disturbance(), duration=seconds
    )
    return run(calm, controller=law, timed=False)


def _carried(scenario: Scenario, table: Table) -> Array:
    """Configurations along poses of the object, as the law brings it there slowly.

    Raises:
        InvalidValueError: a pose from which it stays farther than ``CARRIED``; says which.
    """
    chain, poses = scenario.chain, table.take(POSE.columns)
    first = chain.object_pose(chain.q_start)
    values = [[*first.translation, *quaternion_of(first.rotation)], *poses.tolist()]
    t = SLOW * np.linspace(0.0, 1.0, len(values))
    task = Pose(goal=Waypoints(times=t.tolist(), values=values), profile=Profile(kind="step"))
    trace, at = calm_run(scenario, (task,), SLOW), np.rint(t[1:] / scenario.dt).astype(int)
    off, angle = trace.task_error[at].T
    for k in np.flatnonzero((off > CARRIED) | (angle > CARRIED_ANGLE))[:1].tolist():
        raise InvalidValueError(
            f"{table.place(k)}: the law brings the object no nearer than {1e3 * off[k]:.3g} mm "
            f"and {1e3 * angle[k]:.3g} mrad; lead it elsewhere, or plan a way"
        )
    return np.asarray(trace.q[at[0] :], float)
