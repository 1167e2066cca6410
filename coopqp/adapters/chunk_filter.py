"""A filter of action chunks for two arms: the nearest chunk that keeps all limits.

A policy's chunk says where each motor shall be at each frame. Frame after frame k the filter gives

    minimise |q_k - x_k|,   q_k = q_k-1 + dt v_k

inside the joints' ranges and speeds, with the arms' bodies apart (also between frames) and, while
both grippers hold, with the loop closed: one hand in the other stays as it was when the second
gripper closed. v_k is the answer of the QP of :mod:`coopqp.qp_law` for a tick of a frame's length,
shortened where bodies would come too near. It is the nearest for each frame from where the last one
leads, not of all frames at once. Frames that keep all of it are passed on as they are.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from coopqp.adapters.motors import ARMS, GRIPPERS, KEYS, MotorUnits
from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.qp import Row
from coopqp.base.spec import Array, NonNegative, Positive, real, spec
from coopqp.base.wording import said
from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.kernel import native
from coopqp.kernel.free_space import FreeSpace, Told
from coopqp.kernel.trajectory_evaluation import joint_points, survey
from coopqp.limit import DistanceBounds, Limit, Tighten
from coopqp.limits import JointPosition, JointVelocity, SelfCollision
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.scenario.scenario import Scenario
from coopqp.signal import Trajectory, of_joints
from coopqp.signals import Input
from coopqp.solver import Budget
from coopqp.solvers import Daqp
from coopqp.tasks import Posture

#: A law keeps so much more of a distance than is checked, for what linear rows leave out [m].
SLACK = 1e-3
#: On the way to a frame distances are checked each time a joint has gone so far [rad].
LOOK = 0.05
#: Shares of a step that are tried.
SHARES = 0.5, 0.25, 0.125, 1 / 32, 1 / 128
#: Farther apart, bodies are not slowed down; a step is looked at before it is made [m].
WITHIN = 0.06
#: What rounding may add to a limit [rad; % of grippers].
ROUNDING = 1e-9
OPEN = 100.0  # of a gripper [%]
#: A start is no start where a joint is farther from zero: four turns [rad].
FARTHEST = 8.0 * np.pi


@spec
class FilterSettings:
    """What a filter keeps."""

    fps: Positive = 30.0
    """Frames of a chunk in a second."""
    speed: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    """Share of the joints' speed limits that may be used."""
    gripper_speed: Positive = 250.0
    """[% of its range in a second]"""
    distance: NonNegative = 0.01
    """Kept free between two bodies of the arms [m]."""
    holds_below: Annotated[float, Field(ge=0.0, le=OPEN)] = 30.0
    """A gripper that is told to be open so far, or less, holds [%]."""
    loop_position: Positive = 1e-3
    """By which a hand may be off from how both hold [m]."""
    loop_orientation: Positive = 1e-2
    """The same for angles [rad]."""
    squeeze: NonNegative = 0.0
    """Where both hold, hands may be told to come closer by so much along the line between them [m];
    the servos make a force of it."""


@dataclass(frozen=True)
class Change:
    """Why a frame was changed.

    Attributes:
        frame: from 0.
        limit: "not_finite", "joint_position", "joint_velocity", "self_collision" or "loop".
        names: keys of the action, or of two bodies or arms.
        by: how far the frame as given is beyond the limit, in the action's units, of bodies and
            loops in metres; NaN where it is not known, as of bodies that are in each other.
    """

    frame: int
    limit: str
    names: tuple[str, ...]
    by: float = np.nan

    def __str__(self) -> str:
        unit = " m" if self.limit in ("self_collision", "loop") else ""
        far = "" if np.isnan(self.by) else f", beyond it by {self.by:.3g}{unit}"
        return f"frame {self.frame}: {self.limit} of {' and '.join(self.names)}{far}"


@dataclass(frozen=True)
class FilteredChunk:
    """What the filter gives back.

    Attributes:
        actions: as the chunk was given: an array (N, 12), or a list of dicts.
        q: joints of the arms, shape (N, 10) [rad].
        changed: which frames are not as given, shape (N,).
        holding: in which frames both hands hold as they did in the one before, shape (N,).
    """

    actions: Any
    q: Array
    changed: NDArray[np.bool_]
    holding: NDArray[np.bool_]
    _why: Iterator[Change] = field(repr=False)

    @cached_property
    def changes(self) -> tuple[Change, ...]:
        """What each changed frame would have broken; looked for when it is asked for."""
        return tuple(self._why)


class ChunkFilter:
    """Keeps two arms' actions within all limits.

    Args:
        scenario: with the robot, whose joints are left/shoulder_pan and so on, as ``two_so101``.
            Ranges and speeds are the robot's own (``joint_limits``); the scenario's limits and
            tasks are not asked.
        units: of the motors; LeRobot's degrees, zeros and signs as in the URDF if omitted.
        settings: fields of :class:`FilterSettings`.

    Raises:
        CoopqpError: the robot has other joints; the compiled kernel is not built.
    """

    def __init__(
        self, scenario: Scenario, units: MotorUnits | None = None, **settings: Any
    ) -> None:
        if native.module() is None:
            raise CoopqpError(f"chunks are filtered by the compiled kernel: {native.MISSING}")
        self.units, self.settings = units or MotorUnits(), FilterSettings(**settings)
        kept, self._chain = self.settings, self.units.bounded(scenario.chain)
        self.lower, self.upper = self._chain.lower, self._chain.upper
        self.step = kept.speed * self._chain.velocity / kept.fps
        self._grip_step = kept.gripper_speed / kept.fps
        gain = min(kept.fps, 10.0)  # with which few frames a second do not overshoot
        apart = SelfCollision(distance=kept.distance, gain=gain, ignore=(("object", "*"),))
        self.watched = [row.bodies for row in apart.rows(self._chain) if row.bodies]
        self._space = FreeSpace(self._chain, [apart.program(self._chain, 1.0 / kept.fps)])
        careful = replace(apart, distance=kept.distance + SLACK, gain=kept.fps, within=WITHIN)
        self._apart = _Apart(careful, self._chain, 1.0 / kept.fps)
        self._law = _Follower(self._chain, kept, self._apart)
        self.reset()

    def reset(self) -> None:
        """Forget where the arms are and what they hold; the next chunk needs a start."""
        self._q: Array | None = None
        self._grips = np.full(2, OPEN)
        self._hold: _Hold | None = None

    @property
    def begun(self) -> bool:
        """Whether it knows where the arms are, so that a chunk needs no start."""
        return self._q is not None

    def filter_chunk(self, chunk: Any, start: Any = None) -> FilteredChunk:
        """The nearest chunk that keeps all limits.

        Args:
            chunk: N frames, shape (N, 12) in LeRobot's order, or N dicts with its keys; what a dict
                leaves out stays as it was.
            start: the frame that was sent last, or an observation, before the first one; the last
                frame of the chunk before if omitted. What hands hold then is taken as it is there.

        Raises:
            InvalidValueError: the chunk is something else, and nothing of the filter changes; no
                start, and no chunk before; a start of some turns.
        """
        row = self._last() if start is None else self._started(start)
        given = self._array(chunk, row)
        if start is not None:
            self._q, self._grips, self._hold = self.units.joints(row[None])[0], row[GRIPPERS], None
        if self._q is None:
            raise InvalidValueError("start: where the arms are is needed before the first chunk")
        grips = self._gripped(given[:, GRIPPERS])
        holding = self._holding(self._grips, grips)
        x, q, changed = self.units.joints(given), np.empty((len(given), len(ARMS))), []
        for first, end in _alike(holding):
            if not holding[first]:
                self._hold = None
            elif self._hold is None:
                self._hold = self._taken(self._q)
            changed += self._segment(first, x[first:end], q[first:end], self._q)
            self._q = q[end - 1].copy()
        return self._found(chunk, given, grips, q, changed, holding)

    def audit(self, recorded: Any) -> Iterator[Change]:
        """What recorded frames break, each as it follows the recorded one before.

        Args:
            recorded: as for :meth:`filter_chunk`, an episode; nothing of the filter changes.
        """
        given = self._array(recorded, self._last())
        x, grips = self.units.joints(given), given[:, GRIPPERS]
        whole = np.isfinite(x).all(axis=1)
        told = _filled(x, x[np.argmax(whole)] if whole.any() else self._chain.q_start)
        for first, end in _alike(self._holding(grips[0], grips)) if len(x) else ():
            before = np.concatenate([told[max(first - 1, 0)][None], told[first : end - 1]])
            holds = self._holding(grips[0], grips)[first]
            hold = self._taken(before[0]) if holds else None
            fine, _ = self._fine(x[first:end], hold)
            follows = self._follows(x[first:end], before, fine)
            for k in np.flatnonzero(~follows).tolist():
                yield from self._arms(first + k, given[first + k], _Asked(k, before[k], hold))

    def _holding(self, first: Array, grips: Array) -> NDArray[np.bool_]:
        """In which frames both grippers are closed that were so before."""
        closed = np.concatenate([first[None], grips]) <= self.settings.holds_below
        both = np.asarray(closed.all(axis=1))
        return both[1:] & both[:-1]

    def _taken(self, q: Array) -> _Hold:
        return _Hold(self._chain.handed_over(q), self.settings, self._apart)

    def _last(self) -> Array:
        """The frame before the next, of NaN where there is none."""
        row = np.full(len(KEYS), np.nan)
        if self._q is not None:
            row[ARMS], row[GRIPPERS] = self.units.motors(self._q), self._grips
        return row

    def _started(self, start: Any) -> Array:
        asked = [start] if isinstance(start, Mapping) else start
        row: Array = self._array(asked, self._last(), "start")[0]
        if not np.isfinite(row).all():
            raise InvalidValueError("start: needs a finite number for each motor")
        far = np.abs(self.units.joints(row[None])[0]) > FARTHEST
        if far.any():
            key = np.array(KEYS)[ARMS][far][0]
            raise InvalidValueError(f"start: {key} is more than {FARTHEST:.3g} rad from zero")
        return row

    def _array(self, chunk: Any, last: Array, what: str = "chunk") -> Array:
        """Frames (N, 12); what dicts leave out is as in the frame before."""
        try:
            if isinstance(chunk, Sequence) and any(isinstance(row, Mapping) for row in chunk):
                return np.array([*itertools.accumulate(chunk, _told, initial=last)][1:])
            found = real(chunk)
        except ValueError as error:
            raise InvalidValueError(f"{what}: {said(error)}") from None
        if what == "start":
            found = np.asarray(found.reshape(1, -1))
        if found.ndim != 2 or found.shape[1] != len(KEYS):
            raise InvalidValueError(f"{what}: found shape {found.shape}, needs (N, {len(KEYS)})")
        return found

    def _gripped(self, wished: Array) -> Array:
        """What grippers are told, shape (N, 2): in their range and speed."""
        last, most = self._grips, self._grip_step + ROUNDING
        inside = (wished >= -ROUNDING) & (wished <= OPEN + ROUNDING)  # of NaN it is False
        if inside.all() and (np.abs(np.diff(wished, axis=0, prepend=last[None])) <= most).all():
            return wished
        found = np.empty_like(wished)
        for k, wish in enumerate(wished):
            near = np.clip(wish, last - self._grip_step, last + self._grip_step)
            last = found[k] = np.where(np.isfinite(wish), np.clip(near, 0.0, OPEN), last)
        return found

    def _segment(self, first: int, x: Array, q: Array, now: Array) -> list[_Asked]:
        """Write q of frames in which the same hands hold; those that are not as asked, and why."""
        hold, asked, k, as_given = self._hold, list[_Asked](), 0, True
        x, (fine, gap) = _filled(x, now), self._fine(x, hold)
        follows = self._follows(x, np.concatenate([now[None], x[:-1]]), fine)
        q[:] = x
        while k < len(x):
            if as_given and follows[k]:
                k = k + int(np.argmin(follows[k:])) if not follows[k:].all() else len(x)
                now = x[k - 1]
            elif (
                not as_given and fine[k] and self._follows(x[k : k + 1], now[None], fine[k : k + 1])
            ):
                now, as_given, k = x[k], True, k + 1
            else:
                asked.append(_Asked(first + k, now, hold))
                q[k] = now = self._nearest(now, x[k], gap[k], hold)
                as_given, k = False, k + 1
        return asked

    def _fine(self, x: Array, hold: _Hold | None) -> tuple[NDArray[np.bool_], Array]:
        """Which frames keep ranges and the loop, and the loop's offset that they ask for."""
        inside = np.isfinite(x) & (x >= self.lower - ROUNDING) & (x <= self.upper + ROUNDING)
        fine, gap = np.asarray(inside.all(axis=1)), np.zeros((len(x), 0))
        if hold:
            gap, closed = hold.wanted(np.nan_to_num(x))
            fine = fine & closed
        return fine, gap

    def _follows(self, x: Array, before: Array, fine: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which frames can be reached from the one before as they are, of those that are fine."""
        found = fine & (np.abs(x - before) <= self.step + ROUNDING).all(axis=1)
        if found.any():
            places = _way(before[found][:, None], x[found][:, None])
            free = self._space.is_free(places.reshape(-1, x.shape[1]))
            found[found] = free.reshape(places.shape[:2]).all(axis=1)
        return found

    def _nearest(self, q: Array, x: Array, gap: Array, hold: _Hold | None) -> Array:
        """Where a frame's step leads from q towards x."""
        x = np.minimum(np.maximum(x, self.lower), self.upper)  # as near, and of a law's size
        for goal in self._goals(q, x, gap, hold):
            if self._goes(q, goal):
                return goal
        if not self._space.is_free(q[None])[0]:
            return goal
        for share in SHARES:
            if self._goes(q, near := q + share * (goal - q)):
                return near
        return q

    def _goals(self, q: Array, x: Array, gap: Array, hold: _Hold | None) -> Iterator[Array]:
        """Without asking for distances, which most frames keep, then with them."""
        if hold is None:
            yield self._clipped(q, x)
            yield self._law.toward(q, x)
        else:
            yield hold.law.toward(q, x, gap)
            yield hold.careful.toward(q, x, gap)

    def _clipped(self, q: Array, x: Array) -> Array:
        near = np.minimum(np.maximum(x, q - self.step), q + self.step)
        return np.asarray(np.minimum(np.maximum(near, self.lower), self.upper))

    def _goes(self, q: Array, goal: Array) -> bool:
        return bool(self._space.is_free(_way(q, goal)).all())

    def _found(
        self, chunk: Any, given: Array, grips: Array, q: Array, asked: list[_Asked],
        holding: NDArray[np.bool_],
    ) -> FilteredChunk:  # fmt: skip
        """Frames that were asked for otherwise in the motors' units, and who wants to know why."""
        before = np.concatenate([self._grips[None], grips])[:-1]
        moved = (grips != given[:, GRIPPERS]).any(axis=1)
        self._grips = grips[-1].copy() if len(grips) else self._grips
        actions, arms = given.copy(), [each.frame for each in asked]
        actions[:, GRIPPERS] = grips
        actions[np.ix_(arms, ARMS)] = self.units.motors(q[arms])
        changed = moved.copy()
        changed[arms] = True
        why = self._why(given, before, moved, asked)
        return FilteredChunk(_like(chunk, actions), q, changed, holding, why)

    def _why(
        self, given: Array, grips: Array, moved: NDArray[np.bool_], asked: list[_Asked]
    ) -> Iterator[Change]:
        by_frame = {each.frame: each for each in asked}
        for k in sorted({*by_frame, *np.flatnonzero(moved).tolist()}):
            if moved[k]:
                yield from _grippers(k, given[k, GRIPPERS], grips[k], self._grip_step)
            if k in by_frame:
                yield from self._arms(k, given[k], by_frame[k])

    def _arms(self, k: int, row: Array, asked: _Asked) -> Iterator[Change]:
        """What the arms' part of a frame breaks."""
        names, bad = np.array(KEYS)[ARMS], ~np.isfinite(row[ARMS])
        if bad.any():
            yield Change(k, "not_finite", tuple(names[bad].tolist()))
            row = row.copy()
            row[np.array(ARMS)[bad]] = self.units.motors(asked.q)[bad]
        (x,) = self.units.joints(row[None])
        beyond = {
            "joint_position": np.maximum(self.lower - x, x - self.upper),
            "joint_velocity": np.abs(x - asked.q) - self.step,
        }
        for limit, by in beyond.items():
            for i in np.flatnonzero(by > ROUNDING).tolist():
                yield Change(k, limit, (str(names[i]),), float(by[i] / abs(self.units.scale[i])))
        yield from self._near(k, x, asked.q)
        if asked.hold and (off := asked.hold.opened(x)) > 0.0:
            yield Change(k, "loop", tuple(arm.name for arm in asked.hold.chain.arms), off)

    def _near(self, k: int, x: Array, q: Array) -> Iterator[Change]:
        """Bodies that are too near at x, or else on the way to it."""
        goal = self._clipped(q, x)
        for place in (x, *_way(np.clip(q, -FARTHEST, FARTHEST), goal)):
            if self._space.is_free(place[None])[0]:
                continue
            told, d = self._space.measure(place)[:, :2].T
            near = (told == Told.INSIDE) | ((told != Told.BEYOND) & (d < self.settings.distance))
            near |= not near.any() and told != Told.BEYOND  # where nothing is proved
            for i in np.flatnonzero(near).tolist():
                by = np.nan if told[i] == Told.INSIDE else self.settings.distance - d[i]
                yield Change(k, "self_collision", tuple(self.watched[i]), float(by))
            return


@dataclass(frozen=True)
class _Asked:
    """A frame whose joints are not as asked for, and where the arms were before it."""

    frame: int
    q: Array
    hold: _Hold | None


class _Follower:
    """The law that brings joints as near as limits and loops let them to a target, in one tick."""

    def __init__(self, chain: ClosedChain, kept: FilterSettings, *limits: Limit) -> None:
        half = 0.5 * kept.loop_position, 0.5 * kept.loop_orientation
        problem = ControlProblem(
            chain=chain,
            tasks=(Posture(goal=Input(name="frame"), gain=kept.fps),),
            limits=(JointPosition(), JointVelocity(scale=kept.speed), *limits),
            solver=Daqp(),
            dt=1.0 / kept.fps,
            budget=Budget(loop_position=half[0], loop_orientation=half[1], accuracy=1e-3),
        )
        self._dt = problem.dt
        self._law = QPController(damping=1e-9, error_damping=0.0).unprepared(problem)
        self._state = self._law.start()
        self._target = Trajectory(of_joints(chain.joint_names), chain.q_start.copy())
        self._state.inputs["frame"] = self._target

    def toward(self, q: Array, x: Array, gap: Array | None = None) -> Array:
        """Joints a frame later."""
        self._state.q[:], self._target.value[:] = q, x
        if gap is not None:
            self._state.gap[:] = gap
        return np.asarray(q + self._dt * self._law.tick(self._state).v)


class _Apart(Limit):
    """Self-collision whose pairs are looked for once: which hands hold changes none of them."""

    def __init__(self, limit: SelfCollision, chain: ClosedChain, dt: float) -> None:
        made = {"_limit": limit, "_rows": limit.rows(chain), "_program": limit.program(chain, dt)}
        vars(self).update(made)

    def rows(self, chain: ClosedChain) -> tuple[Row, ...]:
        found: tuple[Row, ...] = vars(self)["_rows"]
        return found

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        limit: SelfCollision = vars(self)["_limit"]
        return limit.bind(chain, dt)

    def program(self, chain: ClosedChain, dt: float) -> DistanceBounds:
        found: DistanceBounds = vars(self)["_program"]
        return found


class _Hold:
    """The loop that both hands close on what they hold, from where they took hold."""

    def __init__(self, chain: ClosedChain, kept: FilterSettings, apart: Limit) -> None:
        self.chain, self._kept, self._apart = chain, kept, apart
        self.law = _Follower(chain, kept)
        hands = [points[-1] for points in joint_points(chain).values()]
        found = survey(chain, (), State(chain), hands)
        assert found is not None  # as the kernel is built, and all joints are hinges
        self._look = found.look

    @cached_property
    def careful(self) -> _Follower:
        """The law that keeps bodies apart as well; built when the first come near."""
        return _Follower(self.chain, self._kept, self._apart)

    def wanted(self, x: Array) -> tuple[Array, NDArray[np.bool_]]:
        """The squeeze that joints (N, 10) ask for as an offset of the loop, and which keep it."""
        gap, off, turned = self._errors(x)
        return gap, (off <= self._kept.loop_position) & (turned <= self._kept.loop_orientation)

    def opened(self, x: Array) -> float:
        """How far joints (10,) open the loop [m]; 0 where they do not."""
        _, (off,), (turned,) = self._errors(x[None])
        return float(off) if off > self._kept.loop_position or (
            turned > self._kept.loop_orientation
        ) else 0.0  # fmt: skip

    def _errors(self, x: Array) -> tuple[Array, Array, Array]:
        seen = self._look(np.zeros(len(x)), x)
        e, gap = seen.loop_error, np.zeros_like(seen.loop_error)
        along = seen.points[:, 0] - seen.points[:, 1]
        along /= np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
        closer = np.clip((e[:, :3] * along).sum(axis=1), 0.0, self._kept.squeeze)
        gap[:, :3] = closer[:, None] * along
        off, turned = np.linalg.norm((e - gap).reshape(-1, 2, 3), axis=2).T
        return gap, off, turned


def _told(row: Array, action: Any) -> Array:
    """The frame after one, by a dict; ValueError where it is none."""
    if not isinstance(action, Mapping):
        raise ValueError(f"found a {type(action).__name__} among dicts")
    if action and not any(key in action for key in KEYS):
        raise ValueError(f"knows none of {', '.join(map(str, action))}; needs keys as {KEYS[0]}")
    found = [real(action.get(key, row[k])) for k, key in enumerate(KEYS)]
    for key, value in zip(KEYS, found, strict=True):
        if value.size != 1:
            raise ValueError(f"{key}: found shape {value.shape}, needs a number")
    return np.array(found, float).ravel()


def _alike(flags: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Begin and end of each stretch of equal flags."""
    edges = [0, *(np.flatnonzero(np.diff(flags)) + 1).tolist(), len(flags)]
    return ((a, b) for a, b in itertools.pairwise(edges) if a < b)


def _way(q: Array, goal: Array) -> Array:
    """Places between q (without it) and the goal, near enough to each other; (places, 10)."""
    go = goal - q
    count = max(1, math.ceil(float(np.abs(go).max(initial=0.0)) / LOOK - ROUNDING))
    return np.asarray(q + np.arange(1, count + 1)[:, None] / count * go)


def _like(chunk: Any, actions: Array) -> Any:
    """Actions as the chunk was given."""
    if not isinstance(chunk, Sequence) or not len(chunk) or not isinstance(chunk[0], Mapping):
        return actions
    rows = zip(chunk, actions.tolist(), strict=True)
    return [{**old, **dict(zip(KEYS, row, strict=True))} for old, row in rows]


def _filled(x: Array, q: Array) -> Array:
    """The frames with the number before in the place of each that is none."""
    bad = ~np.isfinite(x)
    if not bad.any():
        return x
    x = x.copy()
    for k in np.flatnonzero(bad.any(axis=1)).tolist():
        x[k, bad[k]] = (x[k - 1] if k else q)[bad[k]]
    return x


def _grippers(k: int, wish: Array, last: Array, step: float) -> Iterator[Change]:
    for key, x, before in zip(np.array(KEYS)[GRIPPERS].tolist(), wish, last, strict=True):
        if not np.isfinite(x):
            yield Change(k, "not_finite", (key,))
        if (by := max(-x, x - OPEN)) > ROUNDING:
            yield Change(k, "joint_position", (key,), float(by))
        if (by := abs(x - before) - step) > ROUNDING:
            yield Change(k, "joint_velocity", (key,), float(by))
