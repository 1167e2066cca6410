"""A smooth path of closed configurations through given ones.

A cubic spline through the given points is projected onto the loops at even knots, which need not
contain the points, and a quintic spline goes through those. Between its knots the loops stand open
by O(h^6); h is halved until that is below ``CLOSED`` at ten places an interval.

Neither q' nor q'' of a spline is tangent to the loops between knots, and internal wrenches would
fight what is left. With J and Jdot of the loops and J^+ of least norm,

    q' <- q' - J^+ J q',   q'' <- q'' - J^+ (J q'' + Jdot q')

The points are an array, a recorded run, or a table in a file.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coopqp.assessment.thresholds import LOOP_CLOSED, LOOP_CLOSED_ANGLE
from coopqp.base.errors import InvalidValueError
from coopqp.base.reading import open_bytes
from coopqp.base.spec import Array, array
from coopqp.base.table import Table, read_table
from coopqp.execution.controller_run import run
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import CLOSED_ORIENTATION, CLOSED_POSITION
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

#: Largest loop error between knots [m, rad].
CLOSED = 1e-5
#: Of given points: ten times the verdict's, as planners and loggers round.
GIVEN_POSITION, GIVEN_ORIENTATION = 10.0 * CLOSED_POSITION, 10.0 * CLOSED_ORIENTATION
#: Distance of knots at first [rad, m], fewest intervals, and how often they are halved.
SPACING, MIN_INTERVALS, HALVINGS = 0.05, 12, 5
#: Places an interval at which closure and limits are looked at.
FINER = 10
#: Points that are nearer to the one before, as a share of the knots' distance, add their rounding.
THINNED = 0.1
#: A step from point to point, and what projection adds to it, that is no path [rad, m].
JUMP, MOVED = 1.5, 0.3
#: A step beside so much smaller ones is a jump, too.
UNLIKE = 30.0
#: How far given points may be beyond the joints' limits, and a smooth path that rounds a corner at
#: one, where a controller stays inside [rad, m].
BEYOND, CUT = 1e-4, 1e-3
#: Points on which recorded ones are averaged, twice, and below which nothing has moved [rad, m].
DENSE, ROUNDING = 10, 1e-9
#: Below this rate of the joints the path turns back or stands still [-].
STILL = 0.05
#: Damping of J J', as a share of its mean, at poses where it is singular.
DAMPING = 1e-10
NEWTON = 12
#: Times that knots, where a spline swings beyond a limit, are put inside and onto the loops.
ALTERNATIONS = 8
#: Bytes of a header, by which a recorded run is told from a table of joints.
LINE = 1 << 16
#: Of a run along poses of the object: its duration [s], its law, and how near it comes [m, rad].
SLOW, LAW, CARRIED, CARRIED_ANGLE = 10.0, "qp", 1e-3, 1e-2


class Moved(NamedTuple):
    """Where each arm carries the object: p (N, A, 3), R (N, A, 3, 3), Jacobians (N, A, 6, n)."""

    p: Array
    R: Array
    J: Array


class Loops:
    """The closed loops of a chain at many configurations Q, shape (N, n)."""

    def __init__(self, chain: ClosedChain, model: Any = None) -> None:
        self.model = chain.model if model is None else model
        self.data = self.model.createData()
        self.frames = chain.frames[: chain.holding]

    def at(self, Q: Array, *, jacobians: bool = True) -> Moved:
        """Poses of the object by each arm, and Jacobians where they are wanted."""
        N, A, axes = len(Q), len(self.frames), pin.LOCAL_WORLD_ALIGNED
        p, R = np.empty((N, A, 3)), np.empty((N, A, 3, 3))
        J = np.empty((N if jacobians else 0, A, 6, Q.shape[1]))
        model, data, frames = self.model, self.data, list(enumerate(self.frames))
        place = pin.computeJointJacobians if jacobians else pin.forwardKinematics
        for k, q in enumerate(Q):
            place(model, data, q)
            for i, frame in frames:
                X = pin.updateFramePlacement(model, data, frame)
                p[k, i], R[k, i] = X.translation, X.rotation
                if jacobians:
                    J[k, i] = pin.getFrameJacobian(model, data, frame, axes)
        return Moved(p, R, J)

    def drift(self, Q: Array, V: Array) -> Array:
        """The object's acceleration by each arm at a = 0, shape (N, A, 6)."""
        found, nothing = np.empty((len(Q), len(self.frames), 6)), np.zeros(Q.shape[1])
        model, data, axes = self.model, self.data, pin.LOCAL_WORLD_ALIGNED
        for k, (q, v) in enumerate(zip(Q, V, strict=True)):
            pin.forwardKinematics(model, data, q, v, nothing)
            for i, frame in enumerate(self.frames):
                found[k, i] = pin.getFrameClassicalAcceleration(model, data, frame, axes).vector
        return found

    def errors(self, Q: Array) -> Array:
        """Largest loop error of position [m] and of orientation [rad] at each, shape (N, 2)."""
        e = _errors(self.at(Q, jacobians=False)).reshape(len(Q), -1, 2, 3)
        return np.asarray(np.linalg.norm(e, axis=-1).max(axis=1, initial=0.0), float)

    def opened(self, Q: Array) -> float:
        """How far straight steps from tick to tick open them, over what counts as closed."""
        errors = self.errors(2.0 * Q[1:-1] - Q[:-2]) / (LOOP_CLOSED, LOOP_CLOSED_ANGLE)
        return float(errors.max(initial=0.0))

    def project(self, Q: Array) -> Array:
        """The same with the loops closed, by Newton steps of least norm."""
        found = Q.copy()
        left = np.arange(len(Q))
        for _ in range(NEWTON):
            moved = self.at(found[left])
            e = _errors(moved)
            open_ = np.abs(e).max(axis=1, initial=0.0) > 1e-11
            left = left[open_]
            if not len(left):
                break
            found[left] -= through(relative(moved.J[open_]), e[open_])
        return found


def relative(by_arm: Array) -> Array:
    """Rows of the loops, arm i less arm 0, from rows of the arms (N, A, 6, ...)."""
    found = by_arm[:, 1:] - by_arm[:, :1]
    return found.reshape(len(found), 6 * (by_arm.shape[1] - 1), *by_arm.shape[3:])


def through(J: Array, rows: Array) -> Array:
    """Joint motions of least norm that move loop rows (N, m) by so much, (N, n)."""
    if not J.shape[1]:
        return np.zeros((len(J), J.shape[2]))
    JJ = J @ J.transpose(0, 2, 1)
    m = J.shape[1]
    mean = np.trace(JJ, axis1=1, axis2=2) / m
    inverse = np.linalg.inv(JJ + (DAMPING * mean)[:, None, None] * np.eye(m))
    y = times(inverse, rows)
    y += times(inverse, rows - times(JJ, y))  # what damping has left
    return times(J.transpose(0, 2, 1), y)


def times(matrices: Array, vectors: Array) -> Array:
    """Each matrix (N, r, m) times its vector (N, m)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0], float)


def _errors(moved: Moved) -> Array:
    """(p_i - p_0, log(R_i R_0')) of the arms after the first, shape (N, 6 (A - 1))."""
    R = moved.R[:, 1:] @ moved.R[:, :1].transpose(0, 1, 3, 2)
    w = 0.5 * np.stack(
        [R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1
    )
    sine = np.linalg.norm(w, axis=-1)
    angle = np.arctan2(sine, 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0))
    w *= np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 1.0)[..., None]
    e = np.concatenate([moved.p[:, 1:] - moved.p[:, :1], w], axis=-1)
    return np.asarray(e.reshape(len(e), -1), float)


def on_lines(at: Array, s: Array, q: Array) -> Array:
    """Points of the straight lines between rows of q, which are at s, at other places."""
    return np.array([np.interp(at, s, column) for column in q.T]).T


def lengths(q: Array) -> Array:
    """Length of a path up to each of its rows [rad, m]."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])


class Along(NamedTuple):
    """The path at N places: q and the tangents q', q'' (N, n), the arms, their drift at q'."""

    q: Array
    dq: Array
    ddq: Array
    moved: Moved
    drift: Array


@dataclass(frozen=True)
class ClosedPath:
    """q(s), a quintic spline; s is about the joints' way [rad, m]."""

    chain: ClosedChain
    length: float  # s runs from 0 to it
    spline: Any  # of scipy, q by s
    loop_error: float  # largest one at ten places an interval [m]
    deviation: float  # farthest that a given point is from the path [rad, m]
    points: Array  # s of the given points, shape (N,)

    @cached_property
    def _derivatives(self) -> tuple[Any, Any]:
        return self.spline.derivative(1), self.spline.derivative(2)

    def at(self, s: Array, loops: Loops) -> Along:
        """The path at s, shape (N,)."""
        first, second = self._derivatives
        q, dq, ddq = self.spline(s), first(s), second(s)
        moved = loops.at(q)
        J = relative(moved.J)
        dq = dq - through(J, times(J, dq))
        drift = loops.drift(q, dq)
        ddq = ddq - through(J, times(J, ddq) + relative(drift))
        return Along(q, dq, ddq, moved, drift)

    def place(self, s: float) -> str:
        """Where s is, for messages."""
        return f"{100.0 * s / self.length:.0f} % of the path, {_between(self.points, s)}"


def closed_path(chain: ClosedChain, points: Array, spacing: float = SPACING) -> ClosedPath:
    """A path through closed configurations, shape (N, n) [rad, m].

    Corners are rounded over about ``spacing``, the distance of its knots [rad, m].
    InvalidValueError: points that are no numbers, outside the limits, not closed or too far apart,
    or a path that does not move or leaves loops or limits; says where.
    """
    loops = Loops(chain)
    Q = _checked(chain, loops, points)
    _refuse_jumps(np.linalg.norm(np.diff(Q, axis=0), axis=1))
    way, s, smooth = _thinned(Q, THINNED * spacing)
    length = float(s[-1])
    guess = _spline(s, smooth, 3)
    intervals = max(MIN_INTERVALS, int(np.ceil(length / spacing)))
    for _ in range(HALVINGS):
        at = np.linspace(0.0, length, intervals + 1)
        straight = knots = guess(at)
        for _ in range(ALTERNATIONS if _beyond(chain, knots).max() > 0.0 else 1):
            knots = loops.project(np.clip(knots, chain.lower, chain.upper))
        _refuse_moved(at, way, straight, knots)
        spline = _spline(at, knots, 5)
        fine = np.linspace(0.0, length, FINER * intervals + 1)
        Q_fine = spline(fine)
        errors = loops.errors(Q_fine).max(axis=1, initial=0.0)
        if errors.max(initial=0.0) < CLOSED and _beyond(chain, Q_fine).max() < CUT:
            break
        intervals *= 2
    if errors.max(initial=0.0) > CLOSED:
        k = int(errors.argmax())
        raise InvalidValueError(
            f"path: {_between(way, fine[k])}: the loops stand open by {1e3 * errors[k]:.2g} mm or "
            "mrad however near the knots are; the arms may be stretched there, so lead it past"
        )
    deviation = float(np.linalg.norm(spline(way) - Q, axis=1).max())
    path = ClosedPath(chain, length, spline, float(errors.max(initial=0.0)), deviation, way)
    _refuse_outside(chain, Q_fine, CUT, lambda k: _between(way, fine[k]))
    return path


def still_path(chain: ClosedChain, q: Array, length: float) -> ClosedPath:
    """One configuration all along."""
    s = np.linspace(0.0, length, MIN_INTERVALS)
    spline = _spline(s, np.zeros((MIN_INTERVALS, len(q))), 5)
    spline.c[:] = q
    error = float(Loops(chain).errors(q[None]).max())
    return ClosedPath(chain, length, spline, error, 0.0, s[[0, -1]])


def _spline(s: Array, Q: Array, degree: int) -> Any:
    from scipy.interpolate import make_interp_spline  # nobody else waits for it

    return make_interp_spline(s, Q, k=min(degree, len(s) - 1))


def _checked(chain: ClosedChain, loops: Loops, points: Array) -> Array:
    Q = array("path", points)
    if Q.ndim != 2 or Q.shape[1] != chain.n or len(Q) < 2:
        raise InvalidValueError(
            f"path: found shape {Q.shape}, needs at least 2 configurations of {chain.n} joints: "
            f"{', '.join(chain.joint_names)}"
        )
    for k, q in enumerate(Q):
        if wrong := chain.unusable(q):
            raise InvalidValueError(f"path: point {k}: {wrong}")
    _refuse_outside(chain, Q, BEYOND, "point {}".format)
    errors = loops.errors(Q)
    k = int((errors / (GIVEN_POSITION, GIVEN_ORIENTATION)).max(axis=1).argmax())
    if errors[k, 0] > GIVEN_POSITION or errors[k, 1] > GIVEN_ORIENTATION:
        apart, turned = 1e3 * errors[k]
        raise InvalidValueError(
            f"path: point {k}: the loops are not closed: hands stand {apart:.2g} mm and "
            f"{turned:.2g} mrad apart, needs {1e3 * GIVEN_POSITION:g} and "
            f"{1e3 * GIVEN_ORIENTATION:g}; is it a path of this scenario, with its start?"
        )
    return Q


def _beyond(chain: ClosedChain, Q: Array) -> Array:
    return np.asarray(np.maximum(chain.lower - Q, Q - chain.upper))


def _refuse_outside(chain: ClosedChain, Q: Array, tol: float, place: Callable[[int], str]) -> None:
    beyond = _beyond(chain, Q)
    k, j = np.unravel_index(int(beyond.argmax()), beyond.shape)
    if beyond[k, j] > tol:
        end = chain.upper[j] if Q[k, j] > chain.upper[j] else chain.lower[j]
        unit = chain.joint_units[j]
        advice = "give one inside the limits, and points nearer together where it runs along them"
        if unit == "rad" and np.abs(Q[k, j]) > 2.0 * np.pi:
            advice += "; is it in degrees?"
        raise InvalidValueError(
            f"path: {place(int(k))}: {chain.joint_names[j]} is {beyond[k, j]:.2g} {unit} beyond "
            f"its limit {end:.4g} {unit}; {advice}"
        )


def _thinned(Q: Array, near: float) -> tuple[Array, Array, Array]:
    """The way of the joints up to each point, and of points that are kept, with the points."""
    gone = lengths(Q)
    if not gone[-1] > ROUNDING or np.ptp(Q, axis=0).max() <= ROUNDING:
        raise InvalidValueError(
            "path: its points are all the same, so nothing moves; needs at least 2 that differ"
        )
    kept = _apart(Q, near)
    s, Q = gone[kept], Q[kept]
    if len(kept) > 2 * DENSE and np.median(np.diff(s)) < 2.0 * near:
        even = np.linspace(0.0, s[-1], int(s[-1] / near) + 2)
        Q = _averaged(on_lines(even, s, Q))
        kept = _apart(Q, near)
        s, Q = even[kept], Q[kept]
    way = lengths(Q)
    return np.interp(gone, s, way), way, Q


def _apart(Q: Array, near: float) -> list[int]:
    """Points that are at least so far from the one before, with both ends."""
    kept = [0]
    for k in range(1, len(Q) - 1):
        if np.linalg.norm(Q[k] - Q[kept[-1]]) >= near:
            kept.append(k)
    if len(kept) > 1 and np.linalg.norm(Q[-1] - Q[kept[-1]]) < near:
        kept.pop()
    return [*kept, len(Q) - 1]


def _averaged(Q: Array) -> Array:
    """The moving average, twice; the ends stay. It rounds corners and takes jitter out."""
    k = min(DENSE, len(Q) - 1)
    first, last = 2.0 * Q[0] - Q[k:0:-1], 2.0 * Q[-1] - Q[-2 : -k - 2 : -1]
    weights = np.convolve(np.ones(k + 1), np.ones(k + 1)) / (k + 1) ** 2
    padded = np.vstack([first, Q, last])
    return np.array([np.convolve(column, weights, "valid") for column in padded.T]).T


def _refuse_jumps(steps: Array) -> None:
    k, usual = int(steps.argmax()), float(np.median(steps))
    alone = len(steps) > 9 and steps[k] > max(UNLIKE * usual, 6.0 * SPACING)
    if steps[k] > JUMP or alone:
        others = f", where the others are {usual:.2g} apart" if alone else ""
        raise InvalidValueError(
            f"path: it jumps by {steps[k]:.3g} rad from point {k} to point {k + 1}{others}; give "
            "points in between"
        )


def _refuse_moved(at: Array, way: Array, straight: Array, knots: Array) -> None:
    moved = np.linalg.norm(knots - straight, axis=1)
    k = int(np.nan_to_num(moved, nan=np.inf).argmax())
    if not moved[k] < MOVED:
        raise InvalidValueError(
            f"path: {_between(way, at[k])}: a smooth path through the points leaves the loops by "
            f"{moved[k]:.2g} rad; give points nearer together there"
        )


def _between(way: Array, s: float) -> str:
    k = min(max(int(np.searchsorted(way, s) - 1), 0), len(way) - 2)
    return f"between points {k} and {k + 1}"


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
