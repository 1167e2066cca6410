"""How fast a path of closed configurations can be followed: as fast as the motors allow.

Joint speeds, accelerations, torques of the scenario's masses and friction of hands that press are
kept; the wrench between the hands is free in a box, since a closed chain has more motors than
freedoms. Two passes over a grid (``forward_backward_pass.py``) find the profile; then all limits
are divided by what was exceeded between the grid's places, and it is found again.

A linear program's wrench jumps from vertex to vertex, so the torques of an instant are those of

    min |tau / tau_max|^2   with the rows kept, x and u given
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.spec import Array, array
from coopqp.closed_loop.grasp_matrix import COMPONENTS, moved, section
from coopqp.closed_loop.hands import hands, points
from coopqp.grasp import SAFETY
from coopqp.model.closed_chain import ClosedChain
from coopqp.planning.closed_path import (
    STILL,
    ClosedPath,
    closed_path,
    given_path,
    relative,
    still_path,
)
from coopqp.planning.forward_backward_pass import FORCE, Passes, Profile, Share, Stuck, program
from coopqp.planning.path_constraints import AXES, Bounds, RowMaker, Rows, bounds_of
from coopqp.scenario.planned import PHASE
from coopqp.scenario.scenario import Scenario, needs_scenario
from coopqp.signal import POSE, quaternion_of

#: Largest component of an internal wrench; 20 N buy two thirds and more of what any buys.
WRENCH = (40.0, 4.0)  # [N, N m]
#: The same where hands press: squeezing is what holds there, and contacts have bounds of their own.
PRESSING = (200.0, 20.0)  # [N, N m]
#: Intervals of the grid.
POINTS = 200
#: Fewest that rows between them can be told from, and most that memory has room for.
MIN_POINTS, MAX_POINTS = 8, 20_000
#: A limit is active from this share of it on; speeds, whose square counts, somewhat earlier.
ACTIVE, ACTIVE_SPEED = 0.99, 0.98
#: Passes that divide the limits by what was exceeded, until that is less than TOLERATED.
REPEATS, TOLERATED = 3, 1.0005
#: Parts of an interval at whose ends limits are looked at; a grid is halved that exceeds them more.
BETWEEN, COARSE = 10, 1.002
#: Reciprocal condition of the loops' Jacobian below which a place is singular.
SINGULAR = 1e-3
#: Curvature of lambda beside that of torques, so that the program of an instant has one answer.
SLIGHT = 1e-6
#: Dividing limits leaves this of what holding still takes.
STANDS = 1.0001
#: Shares of a limit by which the program of an instant is loosened until a point is found.
LOOSER = (1e-7, 1e-5, 1e-3)
#: Steps in which accelerations change; how often, and by how much at least, a motion is slowed.
RISE_STEPS, SLOWER, EASIER = 12, 40, 1.001
#: What would do: how much more of a limit is tried, of how many, and what a lighter load is called.
MORE, TRIED, LIGHTER = 1.2, 6, "load 20 % lighter"
NOTHING, KINDS = "nothing", ("speed", "acceleration", "force")


class Moment(NamedTuple):
    """One instant of a timed path; wrenches are at the object's origin, world axes."""

    s: float  # where on the path
    q: Array  # shape (n,) [rad, m]
    v: Array  # shape (n,) [rad/s, m/s]
    a: Array  # shape (n,) [rad/s2, m/s2]
    p_WO: Array
    R_WO: Array
    tau: Array  # of the motors, 0 at passive joints, shape (n,) [N m, N]
    load: Array  # wrench that moves the object, shape (6,) [N, N m]
    internal: Array  # what of each hand's wrench cancels, shape (A, 6) [N, N m]

    def section(self, chain: ClosedChain) -> Array:
        """Squeeze, shear, twist and bend between two hands that share the load alike, (6,)."""
        at = points(hands(chain), self.p_WO, self.R_WO)
        at_hands = [
            moved(0.5 * self.load + part, self.p_WO, place)
            for part, place in zip(self.internal, at, strict=True)
        ]
        return section(*at).of(np.array(at_hands))


@dataclass(frozen=True, repr=False)
class TimedPath:
    """A path and when to be where on it."""

    maker: RowMaker  #: Of the path's rows.
    profile: Profile  #: When to be where on it.
    #: By interval, the limit that is active, such as "torque of elbow" or "nothing".
    active: tuple[str, ...]
    exceeded: float  #: Largest share of a limit between the grid's places.
    hold: float  #: Largest share of a motor, contact or the wrench that holding still takes.
    notes: tuple[str, ...]  #: Sentences on places that are passed slowly.
    speed: tuple[float, float] = (0.0, 0.0)  #: Along the path at its two ends, |v| [rad/s].
    rise: float = 0.0  #: Time over which accelerations change [s].

    @property
    def path(self) -> ClosedPath:
        return self.maker.path

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return float(self.profile.t[-1])

    @cached_property
    def shares(self) -> dict[str, float]:
        """Share of the time in which each limit is active, longest first."""
        found: dict[str, float] = {}
        for name, dt in zip(self.active, np.diff(self.profile.t).tolist(), strict=True):
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
            f"Looked at in {BETWEEN} places of each of {len(self.profile.u)} intervals, a limit is "
            f"used to {100.0 * self.exceeded:.2f} % at most, and the loops stand open by "
            f"{1e3 * path.loop_error:.1g} mm; "
            f"the path is up to {path.deviation:.1g} rad from the points.",
            *self.notes,
        ]

    def where(self, t: float) -> tuple[float, float, float]:
        """s, sdot and sddot at a time [s]; at rest before the path, and from its end on."""
        s, x, u, times = self.profile.s, self.profile.x, self.profile.u, self.profile.t
        i = min(max(int(np.searchsorted(times, t, side="right")) - 1, 0), len(u) - 1)
        since, rate = min(max(t - times[i], 0.0), times[i + 1] - times[i]), np.sqrt(x[i])
        place = s[i] + rate * since + 0.5 * u[i] * since**2
        gone = t < 0.0 or t > self.duration or (t == self.duration and x[-1] == 0.0)
        rate, push = (0.0, 0.0) if gone else (max(0.0, rate + u[i] * since), u[i])
        return float(min(max(place, s[0]), s[-1])), float(rate), float(push)

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
        load = np.array([u, x, 1.0]) @ self.maker.loads(along)[:, 0]
        return Moment(s, q, dq * rate, dq * u + ddq * x, p, R, tau, load, internal)

    def table(self, dt: float) -> dict[str, Array]:
        """Columns by name every dt [s]: t, joints, pose, speeds, torques, wrenches.

        It is at rest in the last row, at the path's end, or ends with the speed it has there.
        ``waypoints: {file: ...}`` reads the first three, and of two hands the wrench between them,
        ``waypoints: {file: ..., column: squeeze}``.
        """
        if not 0.0 < dt < np.inf:
            raise InvalidValueError(f"dt: found {dt:g}, needs more than 0")
        t = dt * np.arange(np.ceil(self.duration / dt - 1e-6) + 1.0)
        t[-1] = end = self.duration if self.speed[1] else t[-1]
        last = self.at(end if self.speed[1] else np.inf)
        moments = [*map(self.at, t[:-1].tolist()), last]
        if lost := [now.s for now in moments if not np.isfinite(now.tau).all()]:
            where = self.path.place(lost[0])
            raise CoopqpError(f"at {where}: no torques keep all limits; give more points")
        joints = self.path.chain.joint_names
        arms = [arm.name for arm in self.path.chain.arms[: self.maker.arms] if self.maker.arms > 1]
        wrench = [f"internal[{arm}].{part}" for arm in arms for part in _WRENCH]
        names = ["t", *joints, *POSE.columns, *(f"v[{name}]" for name in joints)]
        names += [*(f"tau[{name}]" for name in joints), *wrench]
        rows = [
            np.hstack([now, m.q, m.p_WO, quaternion_of(m.R_WO), m.v, m.tau, *m.internal])
            for now, m in zip(t, moments, strict=True)
        ]
        found = dict(zip(names, np.array(rows).T, strict=False))  # one arm has no internal wrench
        if self.maker.arms == 2:
            between = np.array([m.section(self.path.chain) for m in moments])
            found |= dict(zip(COMPONENTS, between.T, strict=True))
        return found

    def coarse(self, dt: float) -> str:
        """Whether ticks of dt [s] are too long for loops to stay closed; empty if they are not."""
        s = [self.where(t)[0] for t in np.arange(0.0, self.duration, dt).tolist()]
        opened = self.maker.loops.opened(self.path.spline(s)) if len(s) > 2 else 0.0
        words = f"Straight steps of {1e3 * dt:g} ms open the loops {opened:.2g} times as far as "
        words += f"counts as closed; a dt of {1e3 * dt / max(opened, 1.0) ** 0.5:.1g} ms does not."
        return words if opened > 1.0 else ""


_WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")


def time_along(
    path: Any,
    scenario: Scenario,
    *,
    phase: int | None = None,
    points: int = POINTS,
    torque: float = 1.0,
    wrench: tuple[float, float] | None = None,
    safety: float = SAFETY,
    speed: tuple[float, float] = (0.0, 0.0),
    rise: float = 0.0,
    controller: str | None = None,
) -> TimedPath:
    """The fastest motion along a path of closed configurations.

    Args:
        path: configurations, shape (N, n) [rad, m]; what has them as ``q``; or a file: a recorded
            run, or a CSV file with a column a joint, such as a plan's, or with way-points of the
            object alone (x, y, z, qx, qy, qz, qw); or the folder of these.
        scenario: whose robot, start, grasps, object and limits count.
        phase: which one, from 0 on, of a plan that leads through several, with the arms that hold
            the object then; nothing may move in it.
        points: intervals of the grid at least: no fewer than the path has knots, and twice as many
            where that turns out to be too coarse.
        torque: share of each motor's limit that may be planned with; the rest is for the loop.
        wrench: largest force and torque by component of each hand's internal wrench [N, N m];
            ``WRENCH`` if omitted, ``PRESSING`` where hands press.
        safety: by which the friction of hands that press is divided.
        speed: along the path at its beginning and its end, the joints' speed |v| [rad/s].
        rise: time over which accelerations change [s], as servos do not follow jumps; rest to rest.
        controller: of a recorded run; the first if omitted.

    Raises:
        InvalidValueError: numbers out of range; a path that jumps, is not closed or leaves the
            limits; a load that cannot be held at rest; speeds that cannot be had. Says where.
        CoopqpError: the file cannot be read.
    """
    needs_scenario(scenario)
    box = WRENCH if wrench is None else wrench
    _check(points=points, torque=torque, wrench=box, safety=safety, speed=speed, rise=rise)
    phases = [one for one in scenario.schedule if not one.leads]
    parts, chain = given_path(path, scenario, controller), scenario.chain
    if len(parts) == 1 and len({one.released for one in phases}) > 1:
        words = "arms let go between them; give a plan, which says what leads to which"
        raise InvalidValueError(f"path: found one for {len(phases)} phases: {words}")
    if phase not in range(len(parts)) and (phase is not None or len(parts) > 1):
        raise InvalidValueError(f"phase: found {phase}, needs 0 to {len(parts) - 1}")
    for before, after in zip(parts[: phase or 0], phases[1:], strict=False):
        chain = chain.handed_over(before[-1], after.released)
    if wrench is None and any(grasp.contact for grasp in chain.grasps.values()):
        box = PRESSING
    q, problem = parts[phase or 0], scenario.problem(phases[phase or 0], chain)
    bounds = bounds_of(problem, torque, box, safety)
    if phase is not None and not np.ptp(q, axis=0).any():
        return _still(RowMaker(still_path(chain, q[0], scenario.dt), bounds))
    return eased(fastest(RowMaker(closed_path(chain, q), bounds), int(points), speed), rise)


def time_phases(path: Any, scenario: Scenario, **how: Any) -> list[TimedPath]:
    """Each phase of a plan as :func:`time_along` has it; one where it has no phases."""
    needs_scenario(scenario)
    parts, speed = given_path(path, scenario, how.get("controller")), how.get("speed", (0.0, 0.0))
    if len(parts) == 1:
        return [time_along(parts[0], scenario, **how)]
    if any(speed):
        raise InvalidValueError(f"speed: found {speed}, needs 0 at the ends of phases")
    return [time_along(path, scenario, phase=k, **how) for k in range(len(parts))]


def table_of_phases(parts: Sequence[TimedPath], dt: float) -> dict[str, Array]:
    """The tables of phases one after the other, dt [s] apart, with the column of their number."""
    tables = [part.table(dt) for part in parts]
    if len(tables) == 1:
        return tables[0]
    found: dict[str, Array] = {}
    for name in dict.fromkeys(name for one in tables for name in one):
        found[name] = np.concatenate([one.get(name, 0.0 * one["t"]) for one in tables])
    counts = [len(one["t"]) for one in tables]
    ends = np.cumsum([0.0, *(one["t"][-1] + dt for one in tables[:-1])])
    found["t"] += np.repeat(ends, counts)
    return found | {PHASE: np.repeat(1.0 + np.arange(len(parts)), counts)}


def _still(maker: RowMaker) -> TimedPath:
    """Nothing moves in a phase; s is the time."""
    s, one = np.array([0.0, maker.path.length]), np.ones(2)
    profile = Profile(s, one, np.zeros(1), one, np.zeros((1, 2, len(maker.kept))))
    return TimedPath(maker, profile, (NOTHING,), 0.0, float(_held(maker.at(s)).max()), ())


def fastest(
    maker: RowMaker, points: int = POINTS, speed: tuple[float, float] = (0.0, 0.0),
    max_x: Array | None = None,
) -> TimedPath:  # fmt: skip
    """The fastest motion along a closed path by its rows, with sdot^2 <= max_x at the places.

    Else as :func:`time_along`.
    """
    points = max(points, len(maker.path.spline.t))  # between two places it may not bend twice
    places = np.linspace(0.0, maker.path.length, points + 1)
    rows = maker.at(places)
    held = _held(rows)
    ends = (np.array(speed) / np.linalg.norm(rows.along.dq[[0, -1]], axis=1)) ** 2
    between = np.diff(places)[:, None] * np.linspace(0.0, 1.0, BETWEEN + 1)
    fine = maker.at((places[:-1, None] + between).ravel())
    share = Share(fine)
    limits = {kind: np.ones(points + 1) for kind in KINDS}
    if max_x is not None:
        limits["speed"] = np.minimum(1.0, np.sqrt(max_x / rows.x_max))
    for _ in range(1 + REPEATS):
        profile = _profile(rows, limits, ends.tolist(), speed)
        uses = _uses(fine, share, profile)
        if uses.largest < TOLERATED:
            break
        for kind, use in uses.by_kind.items():
            over = np.maximum(1.0, use)
            limits[kind] /= np.maximum(np.append(over, 1.0), np.append(1.0, over))
        limits["force"] = np.maximum(limits["force"], np.minimum(STANDS * held, 1.0))
    else:
        if uses.largest > COARSE and max_x is None and 2 * points <= MAX_POINTS:
            return fastest(maker, 2 * points, speed)
    active = tuple(_active(fine, share, uses))
    hold, notes = float(held.max()), tuple(_slow(rows))
    return TimedPath(maker, profile, active, uses.largest, hold, notes, speed)


def eased(found: TimedPath, rise: float) -> TimedPath:
    """The motion with s(t) averaged over a time, and slowed down until it keeps all limits.

    Accelerations then change over the time ``rise`` [s], and a note says what that costs.
    InvalidValueError: the motion is not from rest to rest, or no pace keeps the limits.
    """
    if not rise:
        return found
    if any(found.speed):
        raise InvalidValueError(f"rise: found {rise:g} s, needs a speed of 0 at both ends")
    if rise < found.duration / len(found.profile.u):
        shortest = found.duration / len(found.profile.u)
        words = f"0, or at least {shortest:.3g} s, the time of an interval of the grid"
        raise InvalidValueError(f"rise: found {rise:g} s, needs {words}")
    path, maker, x, hold = found.path, found.maker, found.profile.x, found.profile.max_x.copy()
    for k in np.flatnonzero((x[1:-1] <= x[:-2]) & (x[1:-1] <= x[2:])) + 1:
        near = np.abs(found.profile.t - found.profile.t[k]) <= 0.5 * rise
        hold[near] = np.minimum(hold[near], x[k])  # where it slows down, the mean would not
    duration, found = found.duration, fastest(maker, len(x) - 1, max_x=hold)
    count = int(np.ceil(found.duration / rise)) + 1
    t = rise / RISE_STEPS * np.arange(min(RISE_STEPS * count, MAX_POINTS) + 1)
    t *= (found.duration + rise) / t[-1]
    s, before = (np.array([found.where(float(now))[0] for now in t - gone]) for gone in (0.0, rise))
    x = ((s - before) / rise) ** 2
    s = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(t) * (np.sqrt(x[1:]) + np.sqrt(x[:-1])))])
    s *= path.length / s[-1]
    max_x = np.interp(s, found.profile.s, found.profile.max_x)
    fine = maker.at(np.repeat(s, 2)[1:-1])
    share, wrench = Share(fine), np.zeros((len(s) - 1, 2, fine.Rl.shape[2]))
    for _ in range(SLOWER):
        profile = Profile(s, x, np.diff(x) / (2.0 * np.diff(s)), max_x, wrench)
        uses = _uses(fine, share, profile)
        if uses.largest < TOLERATED:
            break
        x = x / max(uses.largest, EASIER)
    else:
        raise InvalidValueError(f"rise: found {rise:g} s, needs less: no pace keeps all limits")
    a = fine.along.dq * np.repeat(profile.u, 2)[:, None]
    a += fine.along.ddq * np.repeat(x, 2)[1:-1, None]
    jerk = np.abs(np.diff(0.5 * (a[::2] + a[1::2]), axis=0)) / np.diff(profile.t)[1:, None]
    longer = float(profile.t[-1]) - duration
    words = f"Accelerations change over {rise:g} s, which takes {longer:.3g} s more; "
    words += f"the joints' jerk is at most {jerk.max():.3g} rad/s3."
    active = tuple(_active(fine, share, uses))
    return replace(
        found, profile=profile, active=active, exceeded=uses.largest, rise=rise,
        notes=(*found.notes, words),
    )  # fmt: skip


def would_do(found: TimedPath) -> dict[str, float]:
    """Durations with a fifth more of each active limit, or a lighter load: tried, not guessed [s].

    An active limit promises nothing, since the next one may be near. By the name that the limit has
    in ``TimedPath.shares``, those that are active longest first, then by ``LIGHTER``.
    """
    maker, points = found.maker, POINTS if found.rise else len(found.profile.u)
    took = dict[str, float]()
    if found.active == (NOTHING,):
        return {}
    tried = [name for name in found.shares if name != NOTHING][:TRIED]
    bounds = {name: _raised(maker, name) for name in tried}
    bounds[LIGHTER] = replace(maker.bounds, load=(2.0 - MORE) * maker.bounds.load)
    for name, more in bounds.items():
        quick = eased(fastest(RowMaker(maker.path, more), points, found.speed), found.rise)
        # What keeps a limit keeps a larger one; slowing down for a rise does not know that.
        took[name] = min(quick.duration, np.inf if name == LIGHTER else found.duration)
    return took


def _raised(maker: RowMaker, name: str) -> Bounds:
    """The bounds with more of an active limit."""
    bounds, joints = maker.bounds, list(maker.chain.joint_names)
    kind, _, who = name.partition(" of ")
    if kind == "internal wrench":
        return replace(bounds, wrench=MORE * bounds.wrench)
    if kind not in ("speed", "acceleration", "torque"):
        return replace(bounds, safety=bounds.safety / MORE)
    if who in joints:
        at = joints.index(who)
    else:
        kind, at = "twist", [f"the object ({axis})" for axis in AXES].index(who)
    found = getattr(bounds, kind).copy()
    found[at] *= MORE
    return replace(bounds, **{kind: found})


def _check(**given: Any) -> None:
    for name, (shape, low, high, needs) in _OPTIONS.items():
        found = array(name, given[name])
        fits = found.shape == shape and bool(((low <= found) & (found <= high)).all())
        if not fits or (name == "points" and found % 1.0):
            raise InvalidValueError(f"{name}: found {given[name]}, needs {needs}")


#: Shapes of options, their ends, and what they need in words.
_OPTIONS: dict[str, tuple[tuple[int, ...], float, float, str]] = {
    "points": ((), MIN_POINTS, MAX_POINTS, f"a whole number from {MIN_POINTS} to {MAX_POINTS}"),
    "torque": ((), 1e-9, 1.0, "a share in (0, 1]"),
    "safety": ((), 1.0, 1e3, "a number from 1 to 1000"),
    "wrench": ((2,), 0.0, 1e6, "two numbers from 0 to 1e6"),
    "speed": ((2,), 0.0, 1e3, "two numbers from 0 to 1000"),
    "rise": ((), 0.0, 1e2, "a time from 0 to 100 s"),
}


def _held(rows: Rows) -> Array:
    """Share of the limits that holding still takes, (N,); refused where that is all."""
    share = Share(rows)
    found, names = zip(*(share.of(i, 0.0, 0.0) for i in range(len(rows.s))), strict=True)
    path, i = rows.maker.path, int(np.argmax(found))
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
    rows: Rows, limits: dict[str, Array], ends: Sequence[float], speed: Sequence[float]
) -> Profile:
    path, quick = rows.maker.path, rows.maker.kinds == "acceleration"
    of = np.where(quick, limits["acceleration"][:, None], limits["force"][:, None])
    try:
        return Passes(rows, of, limits["speed"]).profile(*ends)
    except Stuck as stuck:
        if stuck.place in (0, len(rows.s) - 1) and np.isfinite(stuck.upper):
            end = "beginning" if stuck.place == 0 else "end"
            pace = np.linalg.norm(rows.along.dq[stuck.place])
            low, high = (pace * np.sqrt(max(x, 0.0)) for x in (stuck.lower, stuck.upper))
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
    """What a profile takes of its limits at the finer places; a row an interval in each array."""

    u: Array
    x: Array
    speed: Array
    acceleration: Array
    force: Array

    @property
    def by_kind(self) -> dict[str, Array]:
        """By interval, the largest share of the limits of a kind."""
        of_joints = self.speed.max(axis=(1, 2)), self.acceleration.max(axis=(1, 2), initial=0.0)
        return dict(zip(KINDS, (*of_joints, self.force.max(axis=1)), strict=True))

    @property
    def largest(self) -> float:
        return max(float(use.max()) for use in self.by_kind.values())


def _uses(fine: Rows, share: Share, profile: Profile) -> _Uses:
    """The best wrench is looked for only where that between the ends' takes more than is there."""
    N, made = len(profile.u), fine.maker
    part = np.linspace(0.0, 1.0, len(fine.s) // N)
    u = np.repeat(profile.u, len(part))
    x = np.outer(profile.x[:-1], 1.0 - part) + np.outer(profile.x[1:], part)
    x = np.maximum(x, 0.0).ravel()
    speed = np.abs(fine.rates) * np.sqrt(x)[:, None] / made.speeds
    quick = made.kinds == "acceleration"
    a = np.abs(fine.values(u, x)[:, quick]) / made.size[quick]
    ends = np.stack([1.0 - part, part], axis=1)
    force = share.with_wrench((ends @ profile.wrench).reshape(len(u), -1), u, x)
    for i in np.flatnonzero(force > TOLERATED).tolist():
        force[i] = share.of(i, u[i], x[i])[0]
    return _Uses(
        *(found.reshape(N, len(part), *found.shape[1:]) for found in (u, x, speed, a, force))
    )


def _active(fine: Rows, share: Share, uses: _Uses) -> Iterator[str]:
    """The limit that is used most in each interval, if any is active."""
    joints, names = fine.maker.chain.joint_names, fine.maker.names
    of_speed = [f"speed of {name}" for name in joints]
    of_speed += [f"speed of the object ({axis})" for axis in AXES]
    for k, by_kind in enumerate(zip(uses.speed, uses.acceleration, strict=True)):
        best = [(ACTIVE_SPEED, NOTHING)]
        for use, called in zip(by_kind, (of_speed, names), strict=True):
            if use.size:
                best.append((float(use.max()), called[int(use.max(axis=0).argmax())]))
        count = uses.force.shape[1]
        for i in (0, count - 1, int(uses.force[k].argmax())):  # passes keep the rows of both ends
            if max(best)[1] == NOTHING and uses.force[k, i] >= ACTIVE:
                use, name = share.of(k * count + i, uses.u[k, i], uses.x[k, i])
                best.append((use, name) if use >= ACTIVE else best[0])
        yield max(best)[1]


def _slow(rows: Rows) -> Iterator[str]:
    """Sentences on places where the path turns back or the loops are singular."""
    path, J = rows.maker.path, rows.along.moved.J
    pace = np.linalg.norm(rows.along.dq, axis=1)
    where = path.place(float(rows.s[pace.argmin()]))
    if pace.min() < STILL * float(np.median(pace)):
        yield f"At {where}, the path stands still or turns back; it is passed slowly."
    if J.shape[1] > 1:
        values = np.linalg.svd(relative(J), compute_uv=False)
        rank = min(path.chain.loops.rank, values.shape[1])
        well = values[:, rank - 1] / values[:, 0]
        if well.min() < SINGULAR:
            where = path.place(float(rows.s[well.argmin()]))
            yield f"At {where}, the arms are singular; it is passed slowly."


def _wrench(rows: Rows, u: float, x: float) -> Array:
    """The internal wrench of one instant, shape (m,), that is easiest on the motors."""
    m, made = rows.Rl.shape[2], rows.maker
    if not m:
        return np.zeros(0)
    values = rows.values(np.array([u]), np.array([x]))[0]
    use, _ = Share(rows).of(0, u, x)
    beyond = max(0.0, use - 1.0 if np.isfinite(use) else 0.0)
    motors = np.flatnonzero((made.kinds == "torque") & (made.size > 0.0))
    bound = np.flatnonzero(made.kinds != "acceleration")
    W = FORCE * rows.Rl[0, motors] / made.size[motors, None]
    P = W.T @ W + SLIGHT * np.eye(m)
    q = W.T @ (values[motors] / made.size[motors])
    unit = np.maximum(made.unit[bound], 1e-3)
    A = np.ascontiguousarray(FORCE * rows.Rl[0, bound] / unit[:, None])
    free = np.full(m, np.inf)
    for looser in LOOSER:
        size = made.size[bound] + (beyond + looser) * made.unit[bound]
        upper = np.concatenate([free, (size - values[bound]) / unit])
        low = np.where(made.two_sided[bound], (-size - values[bound]) / unit, -np.inf)
        found = program(P, q, A, upper, np.concatenate([-free, low]))
        if found is not None:
            return np.asarray(FORCE * found[0], float)
    return np.full(m, np.nan)
