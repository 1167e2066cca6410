"""How fast a path of closed configurations can be followed: as fast as the motors allow.

Joint speeds, accelerations, torques of the scenario's masses and friction of hands that press are
kept; the wrench between the hands is free in a box, since a closed chain has more motors than
freedoms. Two passes over a grid (:mod:`coopqp.planning.passes`) find the profile; then all limits
are divided by what was exceeded at ten places an interval, and it is found again.

A linear program's wrench jumps from vertex to vertex, so the torques of an instant are those of

    min |tau / tau_max|^2   with the rows kept, x and u given
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.reading import open_bytes
from coopqp.base.spec import Array, array
from coopqp.base.table import csv_text, read_table
from coopqp.grasp import SAFETY
from coopqp.planning.closed_path import FINER, STILL, ClosedPath, closed_path, relative
from coopqp.planning.passes import FORCE, Passes, Profile, Share, Stuck, program
from coopqp.planning.rows import AXES, RowMaker, Rows, bounds_of
from coopqp.recordings.known import read, trace_in
from coopqp.scenario.scenario import Scenario
from coopqp.signal import TURN_COLUMNS, quaternion_of

#: Largest component of an internal wrench; 20 N buy two thirds and more of what any buys.
WRENCH = (40.0, 4.0)  # [N, N m]
#: The same where hands press: squeezing is what holds there, and contacts have bounds of their own.
PRESSING = (200.0, 20.0)  # [N, N m]
#: Intervals of the grid.
POINTS = 200
#: Fewest that rows between them can be told from, and most that memory has room for.
FEWEST, MOST = 8, 20_000
#: Bytes of a header, by which a recorded run is told from a table of joints.
LINE = 1 << 16
#: A limit is active from this share of it on; speeds, whose square counts, somewhat earlier.
ACTIVE, ACTIVE_SPEED = 0.99, 0.98
#: Passes that divide the limits by what was exceeded, until that is less than TOLERATED.
REPEATS, TOLERATED = 3, 1.0005
#: Reciprocal condition of the loops' Jacobian below which a place is singular.
SINGULAR = 1e-3
#: Curvature of lambda beside that of torques, so that the program of an instant has one answer.
SLIGHT = 1e-6
#: Dividing limits leaves this of what holding still takes.
STANDS = 1.0001
#: Shares of a limit by which the program of an instant is loosened until a point is found.
LOOSER = (1e-7, 1e-5, 1e-3)
NOTHING = "nothing"


class Moment(NamedTuple):
    """One instant of a timed path.

    Attributes:
        s: where on the path, and q, v, a: shape (n,) [rad, rad/s, rad/s2; m].
        p_WO, R_WO: pose of the object.
        tau: of the motors, 0 at passive joints, shape (n,) [N m, N].
        internal: wrench of each hand on the object that cancels, shape (A, 6), at the object's
            origin, world axes [N, N m].
    """

    s: float
    q: Array
    v: Array
    a: Array
    p_WO: Array
    R_WO: Array
    tau: Array
    internal: Array


@dataclass(frozen=True, repr=False)
class TimedPath:
    """A path and when to be where on it.

    Attributes:
        path: the closed path.
        maker: of its rows.
        s, x: places and sdot^2 there, shape (N,). u: sddot between them, shape (N - 1,).
        t: when it is there, shape (N,) [s].
        most: largest sdot^2 from which the path can be followed, shape (N,).
        active: by interval, the limit that is active, such as "torque of elbow" or "nothing".
        exceeded: largest share of a limit between the grid's places.
        hold: largest share of a motor, a contact or the wrench that holding still somewhere takes.
        notes: sentences on places that are passed slowly.
    """

    path: ClosedPath
    maker: RowMaker
    s: Array
    x: Array
    u: Array
    t: Array
    most: Array
    active: tuple[str, ...]
    exceeded: float
    hold: float
    notes: tuple[str, ...]

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return float(self.t[-1])

    @cached_property
    def shares(self) -> dict[str, float]:
        """Share of the time in which each limit is active, longest first."""
        found: dict[str, float] = {}
        for name, dt in zip(self.active, np.diff(self.t).tolist(), strict=True):
            found[name] = found.get(name, 0.0) + dt / self.duration
        return dict(sorted(found.items(), key=lambda pair: -pair[1]))

    @property
    def sentences(self) -> list[str]:
        """The result in sentences."""
        path = self.path
        return [
            f"The fastest motion along the path takes {self.duration:.4g} s.",
            f"Holding still along it takes up to {100.0 * self.hold:.0f} % of a motor, "
            "a contact or the internal wrench.",
            f"Between the {len(self.s)} places a limit is used to {100.0 * self.exceeded:.2f} % at "
            f"most, and the loops stand open by {1e3 * path.gap:.1g} mm; the path is up to "
            f"{path.deviation:.1g} rad from the points.",
            *self.notes,
        ]

    def where(self, t: float) -> tuple[float, float, float]:
        """s, sdot and sddot at a time [s]; at rest before the path and after it."""
        i = min(max(int(np.searchsorted(self.t, t, side="right")) - 1, 0), len(self.u) - 1)
        since, sdot = min(max(t - self.t[i], 0.0), self.t[i + 1] - self.t[i]), np.sqrt(self.x[i])
        s = self.s[i] + sdot * since + 0.5 * self.u[i] * since**2
        gone = t < 0.0 or t > self.duration
        rate, u = (0.0, 0.0) if gone else (max(0.0, sdot + self.u[i] * since), self.u[i])
        return float(min(max(s, self.s[0]), self.s[-1])), float(rate), float(u)

    def at(self, t: float) -> Moment:
        """The motion at a time [s], with torques shared by the program of this instant."""
        s, rate, u = self.where(t)
        rows, x = self.maker.at(np.array([s])), rate**2
        along = rows.along
        lam = _wrench(rows, u, x)
        a, b, c = (part[0] for part in self.maker.torques(along))
        J = relative(along.moved.J)[0, self.maker.kept]
        tau = a * u + b * x + c - J.T @ lam
        tau[self.path.chain.passive] = 0.0
        loops = np.zeros(6 * (self.maker.arms - 1))
        loops[self.maker.kept] = lam
        by_arm = loops.reshape(-1, 6)
        internal = np.vstack([by_arm.sum(axis=0), -by_arm])
        q, dq, ddq = along.q[0], along.dq[0], along.ddq[0]
        p, R = along.moved.p[0, 0], along.moved.R[0, 0]
        return Moment(s, q, dq * rate, dq * u + ddq * x, p, R, tau, internal)

    def table(self, dt: float) -> dict[str, Array]:
        """Columns by name every dt [s] and at the end: t, joints, pose, speeds, torques, wrenches.

        ``waypoints: {file: ...}`` reads the first three.
        """
        if not 0.0 < dt < np.inf:
            raise InvalidValueError(f"dt: found {dt:g}, needs more than 0")
        ticks = np.arange(0.0, self.duration - 1e-6 * dt, dt)
        t = np.append(ticks, self.duration)
        moments = [self.at(float(now)) for now in t]
        if lost := [now.s for now in moments if not np.isfinite(now.tau).all()]:
            where = self.path.place(lost[0])
            raise CoopqpError(f"at {where}: no torques keep all limits; give more points")
        joints = self.path.chain.joint_names
        arms = [arm.name for arm in self.path.chain.arms[: self.maker.arms]]
        wrench = [f"internal[{arm}].{part}" for arm in arms for part in _WRENCH]
        pose = [[*m.p_WO, *quaternion_of(m.R_WO)] for m in moments]
        blocks = [
            (("t",), t[:, None]),
            (joints, np.array([m.q for m in moments])),
            (("x", "y", "z", *TURN_COLUMNS), np.array(pose)),
            ([f"v[{name}]" for name in joints], np.array([m.v for m in moments])),
            ([f"tau[{name}]" for name in joints], np.array([m.tau for m in moments])),
            (wrench, np.array([m.internal.ravel() for m in moments])),
        ]
        found: dict[str, Array] = {}
        for names, values in blocks:
            found |= dict(zip(names, values.T, strict=True))
        return found

    def csv(self, dt: float) -> str:
        """The table as text."""
        return csv_text(self.table(dt))


_WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")


def time_along(
    path: Any,
    scenario: Scenario,
    *,
    points: int = POINTS,
    torque: float = 1.0,
    wrench: tuple[float, float] | None = None,
    safety: float = SAFETY,
    speed: tuple[float, float] = (0.0, 0.0),
    controller: str | None = None,
) -> TimedPath:
    """The fastest motion along a path of closed configurations.

    Args:
        path: configurations, shape (N, n) [rad, m]; what has them as ``q``; or a file: a recorded
            run, or a CSV file with a column a joint, such as a plan's; or the folder of these.
        scenario: whose robot, start, grasps, object and limits count.
        points: intervals of the grid.
        torque: share of each motor's limit that may be planned with; the rest is for the loop.
        wrench: largest force and torque by component of each hand's internal wrench [N, N m];
            ``WRENCH`` if omitted, ``PRESSING`` where hands press.
        safety: by which the friction of hands that press is divided.
        speed: along the path at its beginning and its end, the joints' speed |v| [rad/s].
        controller: of a recorded run; the first if omitted.

    Raises:
        InvalidValueError: numbers out of range; a path that jumps, is not closed or leaves the
            limits; a load that cannot be held at rest; speeds that cannot be had. Says where.
        CoopqpError: the file cannot be read.
    """
    chain = scenario.chain
    if wrench is None:
        pressing = any(grasp.contact for grasp in chain.grasps.values())
        wrench = PRESSING if pressing else WRENCH
    _check(points=points, torque=torque, wrench=wrench, safety=safety, speed=speed)
    points = int(points)
    smooth = closed_path(chain, _points(path, scenario, controller))
    maker = RowMaker(smooth, bounds_of(scenario, torque, wrench, safety))
    s = np.linspace(0.0, smooth.length, points + 1)
    rows = maker.at(s)
    held = _held(smooth, rows)
    ends = (np.array(speed) / np.linalg.norm(rows.along.dq[[0, -1]], axis=1)) ** 2
    fine = rows.finer(FINER + 1)
    share = Share(fine)
    limits = {kind: np.ones(points + 1) for kind in ("speed", "acceleration", "force")}
    for _ in range(1 + REPEATS):
        profile = _profile(smooth, rows, limits, ends.tolist(), speed)
        uses = _uses(fine, share, profile)
        if uses.largest < TOLERATED:
            break
        for kind, use in uses.by_kind.items():
            over = np.maximum(1.0, use)
            limits[kind] /= np.maximum(np.append(over, 1.0), np.append(1.0, over))
        limits["force"] = np.maximum(limits["force"], np.minimum(STANDS * held, 1.0))
    t = np.concatenate([[0.0], np.cumsum(_steps(s, profile.x))])
    return TimedPath(
        smooth, maker, s, profile.x, profile.u, t, profile.most,
        uses.active, uses.largest, float(held.max()), tuple(_slow(smooth, rows)),
    )  # fmt: skip


def _check(**given: Any) -> None:
    for name, (shape, low, high, needs) in _ASKED.items():
        found = array(name, given[name])
        fits = found.shape == shape and bool(((low <= found) & (found <= high)).all())
        if not fits or (name == "points" and found % 1.0):
            raise InvalidValueError(f"{name}: found {given[name]}, needs {needs}")


#: Shapes of options, their ends, and what they need in words.
_ASKED: dict[str, tuple[tuple[int, ...], float, float, str]] = {
    "points": ((), FEWEST, MOST, f"a whole number from {FEWEST} to {MOST}"),
    "torque": ((), 1e-9, 1.0, "a share in (0, 1]"),
    "safety": ((), 1.0, 1e9, "a number of at least 1"),
    "wrench": ((2,), 0.0, 1e9, "two numbers of at least 0"),
    "speed": ((2,), 0.0, 1e9, "two numbers of at least 0"),
}


def _points(path: Any, scenario: Scenario, controller: str | None) -> Any:
    """Configurations from whatever has them."""
    if not isinstance(path, str | Path):
        return getattr(path, "q", path)
    joints = scenario.chain.joint_names
    if file := table_of(Path(path)):
        return read_table(file).take(joints)
    run = read(trace_in(Path(path)))
    name = controller or run.controllers[0]
    return run.of(name).joints("q", joints)


def table_of(path: Path) -> Path | None:
    """The file of a table of joints, from its own or its folder's path; None for a run's."""
    if path.is_dir():
        found = list(path.glob("*.csv"))
        return table_of(found[0]) if len(found) == 1 else None
    if path.suffix == ".csv" and path.is_file():
        with open_bytes(path) as stream:
            return None if b"status" in stream.readline(LINE) else path
    return None


def _held(path: ClosedPath, rows: Rows) -> Array:
    """Share of the limits that holding still takes, (N,); refused where that is all."""
    share = Share(rows)
    found, names = zip(*(share.of(i, 0.0, 0.0) for i in range(len(rows.s))), strict=True)
    i = int(np.argmax(found))
    use, name = found[i], names[i]
    if use <= 1.0:
        return np.array(found)
    needs = f"even the best wrench between the hands needs {100.0 * use:.0f} % of {name}"
    if not np.isfinite(use):
        needs = "no wrench between the hands leaves the passive joints free of torque"
    elif not name.startswith(("torque", "internal")):
        needs = f"{name} does not bear it with any wrench between the hands"
    raise InvalidValueError(
        f"path: at {path.place(float(rows.s[i]))}: the object cannot be held at rest: {needs}; "
        "make the object lighter, friction or the wrench that is allowed larger, or lead the path "
        "elsewhere"
    )


def _profile(
    path: ClosedPath,
    rows: Rows,
    limits: dict[str, Array],
    ends: Sequence[float],
    speed: Sequence[float],
) -> Profile:
    quick = rows.kinds == "acceleration"
    of = np.where(quick, limits["acceleration"][:, None], limits["force"][:, None])
    try:
        return Passes(rows, of, limits["speed"]).profile(*ends)
    except Stuck as stuck:
        if stuck.place in (0, len(rows.s) - 1) and np.isfinite(stuck.most):
            end = "beginning" if stuck.place == 0 else "end"
            pace = np.linalg.norm(rows.along.dq[stuck.place])
            low, high = (pace * np.sqrt(max(x, 0.0)) for x in (stuck.least, stuck.most))
            found = speed[0 if stuck.place == 0 else 1]
            raise InvalidValueError(
                f"speed: found {found:g} rad/s at the {end}, needs {low:.4g} to {high:.4g}: from "
                "others the limits along the path cannot be kept"
            ) from None
        raise InvalidValueError(
            f"path: at {path.place(float(rows.s[stuck.place]))}: no speed keeps all limits up to "
            "the next of the grid's places; give more points"
        ) from None


class _Uses(NamedTuple):
    """By interval, the largest share of the limits of a kind and the limit that is active."""

    by_kind: dict[str, Array]
    active: tuple[str, ...]

    @property
    def largest(self) -> float:
        return max(float(use.max()) for use in self.by_kind.values())


def _uses(fine: Rows, share: Share, profile: Profile) -> _Uses:
    """What a profile takes of its limits at the finer places."""
    count = FINER + 1
    u = np.repeat(profile.u, count)
    part = np.tile(np.linspace(0.0, 1.0, count), len(profile.u))
    x = (1.0 - part) * np.repeat(profile.x[:-1], count) + part * np.repeat(profile.x[1:], count)
    speed = np.abs(fine.rates) * np.sqrt(np.maximum(x, 0.0))[:, None] / fine.speeds
    quick = np.flatnonzero(fine.kinds == "acceleration")
    a = np.abs(fine.Ru[:, quick] * u[:, None] + fine.Rx[:, quick] * x[:, None]) / fine.size[quick]
    force, names = share.of_all(u, x, ACTIVE)
    by_kind = {
        "speed": speed.max(axis=1).reshape(-1, count).max(axis=1),
        "acceleration": a.max(axis=1, initial=0.0).reshape(-1, count).max(axis=1),
        "force": force.reshape(-1, count).max(axis=1),
    }
    return _Uses(by_kind, tuple(_active(fine, speed, a, force, names, count)))


def _active(
    fine: Rows, speed: Array, a: Array, force: Array, names: Sequence[str], count: int
) -> list[str]:
    """The limit that is used most in each interval, if any is active."""
    of_speed = [f"speed of {name}" for name in fine.joints]
    of_speed += [f"speed of the object ({axis})" for axis in AXES]
    found = []
    for k in range(0, len(speed), count):
        part = slice(k, k + count)
        best = [(ACTIVE_SPEED, ACTIVE, NOTHING)]
        for uses, least, called in ((speed, ACTIVE_SPEED, of_speed), (a, ACTIVE, fine.names)):
            if uses.shape[1] and (use := float(uses[part].max())) >= least:
                best.append((use, least, called[int(uses[part].max(axis=0).argmax())]))
        if (use := float(force[part].max())) >= ACTIVE:
            best.append((use, ACTIVE, names[k + int(force[part].argmax())]))
        found.append(max(best)[2])
    return found


def _steps(s: Array, x: Array) -> Array:
    rate = np.sqrt(np.maximum(x, 0.0))
    both = rate[1:] + rate[:-1]
    if not both.all():
        raise CoopqpError("the path cannot be followed: the motion stands still between its ends")
    return np.asarray(2.0 * np.diff(s) / both, float)


def _slow(path: ClosedPath, rows: Rows) -> list[str]:
    """Sentences on places where the path turns back or the loops are singular."""
    found = []
    pace = np.linalg.norm(rows.along.dq, axis=1)
    if (k := int(pace.argmin())) is not None and pace[k] < STILL * float(np.median(pace)):
        place = path.place(float(rows.s[k]))
        found.append(f"At {place}, the path stands still or turns back; it is passed slowly.")
    J = rows.along.moved.J
    if J.shape[1] > 1:
        values = np.linalg.svd(relative(J), compute_uv=False)
        rank = min(path.chain.loops.rank, values.shape[1])
        well = values[:, rank - 1] / values[:, 0]
        if well[k := int(well.argmin())] < SINGULAR:
            place = path.place(float(rows.s[k]))
            found.append(f"At {place}, the arms are singular; it is passed slowly.")
    return found


def _wrench(rows: Rows, u: float, x: float) -> Array:
    """The internal wrench of one instant, shape (m,), that is easiest on the motors."""
    m = rows.Rl.shape[2]
    if not m:
        return np.zeros(0)
    felt = rows.Ru[0] * u + rows.Rx[0] * x + rows.Rc[0]
    use, _ = Share(rows).of(0, u, x)
    beyond = max(0.0, use - 1.0 if np.isfinite(use) else 0.0)
    motors = np.flatnonzero((rows.kinds == "torque") & (rows.size > 0.0))
    bound = np.flatnonzero(rows.kinds != "acceleration")
    W = FORCE * rows.Rl[0, motors] / rows.size[motors, None]
    P = W.T @ W + SLIGHT * np.eye(m)
    q = W.T @ (felt[motors] / rows.size[motors])
    unit = np.maximum(rows.unit[bound], 1e-3)
    A = np.ascontiguousarray(FORCE * rows.Rl[0, bound] / unit[:, None])
    free = np.full(m, np.inf)
    for looser in LOOSER:
        size = rows.size[bound] + (beyond + looser) * rows.unit[bound]
        upper = np.concatenate([free, (size - felt[bound]) / unit])
        low = np.where(rows.two_sided[bound], (-size - felt[bound]) / unit, -np.inf)
        found = program(P, q, A, upper, np.concatenate([-free, low]))
        if found is not None:
            return np.asarray(FORCE * found[0], float)
    return np.full(m, np.nan)
