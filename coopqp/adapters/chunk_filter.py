"""A filter of action chunks for two arms: the nearest chunk that keeps all limits.

A policy's chunk says where each motor shall be at each frame. Frame after frame k the filter gives

    minimise |q_k - x_k|,   q_k = q_k-1 + dt v_k

inside the joints' ranges and speeds, with the arms' bodies apart (also between frames) and, while
both grippers hold, with the loop closed: one hand in the other stays as it was when the second
gripper closed. v_k is the answer of the QP of :mod:`coopqp.qp_law` for a tick of a frame's length,
shortened where bodies would come too near. It is the nearest for each frame from where the last one
leads, not of all frames at once. Frames that keep all of it are passed on as they are. All frames
in which the same hands hold are one call of the compiled kernel.
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
from coopqp.base.errors import CoopqpError, InvalidValueError, unknown_name
from coopqp.base.spec import Array, NonNegative, Positive, real, spec
from coopqp.base.wording import message_of
from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.kernel import native
from coopqp.kernel.flat import turned
from coopqp.kernel.free_space import FreeSpace, Told
from coopqp.kernel.law import KernelLaw
from coopqp.kernel.trajectory_evaluation import joint_points
from coopqp.limit import Limit
from coopqp.limits import JointPosition, JointVelocity, SelfCollision
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.scenario.scenario import Scenario, needs_scenario
from coopqp.solver import Budget
from coopqp.solvers import Daqp
from coopqp.tasks import MinimumVelocity, Posture

#: A law keeps so much more of a distance than is checked, for what linear rows leave out [m].
SLACK = 1e-3
LOOK = 0.05  # on the way to a frame distances are checked each time a joint has gone so far [rad]
SHARES = 0.5, 0.25, 0.125, 1 / 32, 1 / 128  # shares of a step that are tried
#: Farther apart, bodies are not slowed down; a step is looked at before it is made [m].
WITHIN = 0.06
ROUNDING = 1e-9  # what rounding may add to a limit [rad; % of grippers]
RECORDED = 1e-6  # the same of what is recorded, in float32 [rad]
OPEN = 100.0  # of a gripper [%]
FARTHEST = 8.0 * np.pi  # a start is no start where a joint is farther from zero: four turns [rad]


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
    """Why a frame was changed."""

    frame: int
    limit: str  # "not_finite", "joint_position", "joint_velocity", "self_collision" or "loop"
    names: tuple[str, ...]  # keys of the action, or of two bodies or arms
    # how far the frame as given is beyond the limit, of loops how far it opens them; NaN where it
    # is not known, as of bodies that are in each other
    by: float = np.nan
    unit: str = ""  # deg or % as the action has, of speeds deg/s or %/s, of bodies and loops m

    def __str__(self) -> str:
        far = "" if np.isnan(self.by) else f", beyond it by {self.by:.3g} {self.unit}"
        return f"frame {self.frame}: {self.limit} of {' and '.join(self.names)}{far}"


@dataclass(frozen=True)
class FilteredChunk:
    """What the filter gives back."""

    actions: Any  # as the chunk was given: an array (N, 12), or a list of dicts
    q: Array  # joints of the arms, shape (N, 10) [rad]
    changed: NDArray[np.bool_]  # which frames are not as given, shape (N,)
    # in which frames both hands hold as they did in the one before, shape (N,)
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
        needs_scenario(scenario)
        if (kernel := native.module()) is None:
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
        held = self._chain.handed_over(self._chain.q_start)
        laws = [_law(self._chain, kept, careful), _law(held, kept), _law(held, kept, careful)]
        axes, hands = held.once(turned), [points[-1] for points in joint_points(held).values()]
        engines = [law.whole.engine for law in laws]
        self._kernel = kernel.Following(*engines, self._space.compiled, {
            "lower": self.lower, "upper": self.upper, "step": self.step,
            "hands": np.concatenate([axes[joint].T @ p for joint, p in hands]),
            "shares": np.array(SHARES), "look": LOOK,
            "position": kept.loop_position, "orientation": kept.loop_orientation,
            "squeeze": kept.squeeze,
        })  # fmt: skip
        self._laws = laws  # which own the arrays of their engines
        self.reset()

    def reset(self) -> None:
        """Forget where the arms are and what they hold; the next chunk needs a start."""
        self._q: Array | None = None
        self._grips = np.full(2, OPEN)
        self._taken: Array | None = None  # joints where both hands took hold of what they hold

    @property
    def begun(self) -> bool:
        """Whether it knows where the arms are, so that a chunk needs no start."""
        return self._q is not None

    def filter_chunk(self, chunk: Any, start: Any = None) -> FilteredChunk:
        """The nearest chunk that keeps all limits.

        Args:
            chunk: N frames, shape (N, 12) in LeRobot's order, or N dicts with its keys; what a dict
                leaves out stays as it was, and what is no motor's, without .pos, comes back.
            start: the frame that was sent last, or an observation, before the first one; the last
                frame of the chunk before if omitted. What hands hold then is taken as it is there.

        Raises:
            InvalidValueError: the chunk is something else, and nothing of the filter changes; no
                start, and no chunk before; a start of some turns.
        """
        row = self._last() if start is None else self._started(start)
        given = self._array(chunk, row)
        if start is not None:
            self._q, self._grips, self._taken = self.units.joints(row[None])[0], row[GRIPPERS], None
        if self._q is None:
            raise InvalidValueError("start: where the arms are is needed before the first chunk")
        grips = self._gripped(given[:, GRIPPERS])
        holding = self._holding(self._grips, grips)
        found, self._taken = self._follow(given, self._q, holding, self._taken)
        self._q = np.concatenate([self._q[None], found.q])[-1]
        return self._found(chunk, given, grips, found, holding)

    def audit(self, recorded: Any) -> Iterator[Change]:
        """What recorded frames break, each as it follows the recorded one before.

        Args:
            recorded: as for :meth:`filter_chunk`, an episode; nothing of the filter changes.
        """
        given = self._array(recorded, self._last())
        x, grips = self.units.joints(given), given[:, GRIPPERS]
        holding = self._holding(grips[:1], grips)
        whole = np.isfinite(x).all(axis=1)
        first = x[np.argmax(whole)] if whole.any() else self._chain.q_start
        found, _ = self._follow(given, first, holding, None, recorded=True)
        inside = np.abs(grips - 0.5 * OPEN) <= (0.5 + RECORDED) * OPEN  # of NaN it is False
        return self._why(given, None, np.asarray(~inside.all(axis=1)), found)

    def _holding(self, first: Array, grips: Array) -> NDArray[np.bool_]:
        """In which frames both grippers are closed that were so before."""
        closed = np.concatenate([np.atleast_2d(first), grips]) <= self.settings.holds_below
        return np.asarray((closed[1:] & closed[:-1]).all(axis=1))

    def _last(self) -> Array:
        """The frame before the next, of NaN where there is none."""
        row = np.full(len(KEYS), np.nan)
        if self._q is not None:
            row[ARMS], row[GRIPPERS] = self.units.motors(self._q), self._grips
        return row

    def _started(self, start: Any) -> Array:
        frames = [start] if isinstance(start, Mapping) else start
        row: Array = self._array(frames, self._last(), "start")[0]
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
                return np.array([*itertools.accumulate(chunk, _frame, initial=last)][1:])
            found = real(chunk)
        except ValueError as error:
            raise InvalidValueError(f"{what}: {message_of(error)}") from None
        if what == "start" and found.size == len(KEYS):
            found = np.asarray(found.reshape(1, -1))
        if found.ndim != 2 or found.shape[1] != len(KEYS):
            needed = f"({len(KEYS)},)" if what == "start" else f"(N, {len(KEYS)})"
            raise InvalidValueError(f"{what}: found shape {found.shape}, needs {needed}")
        return found

    def _gripped(self, wished: Array) -> Array:
        """What grippers are told, shape (N, 2): in their range and speed."""
        step, moves = self._grip_step, np.diff(wished, axis=0, prepend=self._grips[None])
        inside = (wished >= -ROUNDING) & (wished <= OPEN + ROUNDING)  # of NaN it is False
        if inside.all() and (np.abs(moves) <= step + ROUNDING).all():
            return wished

        def stepped(last: float, wish: float) -> float:
            near = min(max(wish, last - step), last + step)
            return min(max(near, 0.0), OPEN) if math.isfinite(wish) else last

        pairs = zip(wished.T.tolist(), self._grips.tolist(), strict=True)
        steps = [[*itertools.accumulate(x, stepped, initial=last)][1:] for x, last in pairs]
        return np.array(steps).T

    def _follow(
        self, given: Array, q: Array, holding: NDArray[np.bool_], taken: Array | None, *,
        recorded: bool = False,
    ) -> tuple[_Followed, Array | None]:  # fmt: skip
        """The frames from q on, and where hands took hold of what they hold after them.

        Recorded ones are asked for from where the one before was, not where it led.
        """
        x = self.units.joints(given)
        requested, changed = np.ascontiguousarray(_filled(x, q)), np.zeros(len(x), bool)
        off, rounding = np.zeros(len(x)), RECORDED if recorded else ROUNDING
        found = _Followed(np.empty(x.shape), np.empty(x.shape), changed, off, rounding)
        now, flags = (requested[0] if recorded and len(x) else q).copy(), changed.view(np.uint8)
        a = b = 0
        for holds, frames in itertools.groupby(holding.tolist()):
            b += len(list(frames))
            taken = (now.copy() if taken is None else taken) if holds else None
            if taken is not None:
                self._kernel.take_hold(taken)
            while a < b:
                rows = found.q[a:b], found.before[a:b], flags[a:b], found.opened[a:b]
                a += self._kernel.follow(requested[a:b], now, *rows, holds, recorded, rounding)
                if a < b:
                    found.q[a] = now[:] = self._apart(now, requested[a], taken)
                    a += 1
        changed |= ~np.isfinite(x).all(axis=1)
        return found, taken

    def _apart(self, q: Array, x: Array, taken: Array | None) -> Array:
        """A frame after q towards x by the plain law, which sees how deep bodies are."""
        chain = self._chain if taken is None else self._chain.handed_over(taken)
        goal = np.clip(x, self.lower, self.upper).tolist()
        task = Posture(goal=goal, gain=self.settings.fps, profile=Profile(kind="step"))
        problem = replace(self._laws[0].problem, chain=chain, tasks=(task,))
        law = QPController(damping=1e-9, error_damping=0.0).plain(problem)
        state = law.start()
        state.q[:] = q
        return np.asarray(q + problem.dt * law.tick(state).v)

    def _found(
        self, chunk: Any, given: Array, grips: Array, found: _Followed, holding: NDArray[np.bool_]
    ) -> FilteredChunk:
        """Frames that were asked for otherwise in the motors' units, and who wants to know why."""
        before = np.concatenate([self._grips[None], grips])[:-1]
        moved = (grips != given[:, GRIPPERS]).any(axis=1)
        self._grips = grips[-1].copy() if len(grips) else self._grips
        actions, arms = given.copy(), np.flatnonzero(found.changed).tolist()
        actions[:, GRIPPERS] = grips
        actions[np.ix_(arms, ARMS)] = self.units.motors(found.q[arms])
        changed, why = found.changed | moved, self._why(given, before, moved, found)
        return FilteredChunk(_like(chunk, actions), found.q, changed, holding, why)

    def _why(
        self, given: Array, before: Array | None, moved: NDArray[np.bool_], found: _Followed
    ) -> Iterator[Change]:
        """What arms and grippers break, of speeds of these where the frames before are given."""
        for k in np.flatnonzero(found.changed | moved).tolist():
            if moved[k]:
                last = None if before is None else before[k]
                yield from self._grippers(k, given[k, GRIPPERS], last)
            if found.changed[k]:
                yield from self._arms(k, given[k], found)

    def _grippers(self, k: int, wish: Array, last: Array | None) -> Iterator[Change]:
        """What the grippers' part breaks, of speeds where the frame before is given."""
        for i, (key, x) in enumerate(zip(np.array(KEYS)[GRIPPERS].tolist(), wish, strict=True)):
            if not np.isfinite(x):
                yield Change(k, "not_finite", (key,))
            if (by := max(-x, x - OPEN)) > ROUNDING:
                yield Change(k, "joint_position", (key,), float(by), "%")
            if last is not None and (by := abs(x - last[i]) - self._grip_step) > ROUNDING:
                yield Change(k, "joint_velocity", (key,), float(by) * self.settings.fps, "%/s")

    def _arms(self, k: int, row: Array, found: _Followed) -> Iterator[Change]:
        names, bad, q = np.array(KEYS)[ARMS], ~np.isfinite(row[ARMS]), found.before[k]
        if bad.any():
            yield Change(k, "not_finite", tuple(names[bad].tolist()))
            row = row.copy()
            row[np.array(ARMS)[bad]] = self.units.motors(q)[bad]
        (x,), unit, fps = self.units.joints(row[None]), self.units.unit, self.settings.fps
        outside, fast = np.maximum(self.lower - x, x - self.upper), np.abs(x - q) - self.step
        beyond = (
            ("joint_position", outside, 1.0, unit),
            ("joint_velocity", fast, fps, f"{unit}/s"),
        )
        for limit, by, rate, of in beyond:
            for i in np.flatnonzero(by > found.rounding).tolist():
                far = float(rate * by[i] / abs(self.units.scale[i]))
                yield Change(k, limit, (str(names[i]),), far, of)
        yield from self._near(k, x, q)
        if found.opened[k] > 0.0:
            yield Change(k, "loop", tuple(a.name for a in self._chain.arms), found.opened[k], "m")

    def _near(self, k: int, x: Array, q: Array) -> Iterator[Change]:
        """Bodies that are too near at x, or else on the way to it."""
        goal = np.clip(np.clip(x, q - self.step, q + self.step), self.lower, self.upper)
        for place in (x, *_way(np.clip(q, -FARTHEST, FARTHEST), goal)):
            if self._space.is_free(place[None])[0]:
                continue
            state, d = self._space.measure(place)[:, :2].T
            near = (state == Told.INSIDE) | ((state != Told.BEYOND) & (d < self.settings.distance))
            near |= not near.any() and state != Told.BEYOND  # where nothing is proved
            for i in np.flatnonzero(near).tolist():
                by = np.nan if state[i] == Told.INSIDE else self.settings.distance - d[i]
                yield Change(k, "self_collision", tuple(self.watched[i]), float(by), "m")
            return


@dataclass(frozen=True)
class _Followed:
    """Joints after each frame, and before it; which are not as asked."""

    q: Array
    before: Array
    changed: NDArray[np.bool_]
    opened: Array  # how far what is asked opens the loop [m]; 0 where that is not too far
    rounding: float


def _law(chain: ClosedChain, kept: FilterSettings, *limits: Limit) -> KernelLaw:
    """Of one tick that is a frame's length, which the kernel asks with targets of its own."""
    half = 0.5 * kept.loop_position, 0.5 * kept.loop_orientation
    budget = Budget(loop_position=half[0], loop_orientation=half[1], accuracy=1e-3)
    bounds = JointPosition(), JointVelocity(scale=kept.speed), *limits
    problem = ControlProblem(
        chain=chain, tasks=(MinimumVelocity(gain=0.5 * kept.fps),), limits=bounds, solver=Daqp(),
        dt=1.0 / kept.fps, budget=budget,
    )  # fmt: skip
    law = QPController(damping=1e-9, error_damping=0.0, engine="kernel").unprepared(problem)
    assert isinstance(law, KernelLaw)
    law.tick(law.start())  # which binds the engine to the arrays of a state
    return law


def _frame(row: Array, action: Any) -> Array:
    """The frame after one, by a dict; ValueError where it is none."""
    if not isinstance(action, Mapping):
        raise ValueError(f"found a {type(action).__name__} among dicts")
    if action and not any(key in action for key in KEYS):
        raise ValueError(f"knows none of {', '.join(map(str, action))}; needs keys as {KEYS[0]}")
    for key in action:  # else it would go to a motor as it is
        if key not in KEYS and str(key).endswith(".pos"):
            raise ValueError(unknown_name("motor", str(key), KEYS))
    found = [real(action.get(key, row[k])) for k, key in enumerate(KEYS)]
    for key, value in zip(KEYS, found, strict=True):
        if value.size != 1:
            raise ValueError(f"{key}: found shape {value.shape}, needs a number")
    return np.array(found, float).ravel()


def _way(q: Array, goal: Array) -> Array:
    """Places between q (without it) and the goal, near enough to each other; (places, 10)."""
    go = goal - q
    count = max(1, int(np.ceil(np.abs(go).max(initial=0.0) / LOOK - ROUNDING)))
    return np.asarray(q + np.arange(1, count + 1)[:, None] / count * go)


def _like(chunk: Any, actions: Array) -> Any:
    if not isinstance(chunk, Sequence) or not len(chunk) or not isinstance(chunk[0], Mapping):
        return actions
    rows = zip(chunk, actions.tolist(), strict=True)
    return [{**old, **dict(zip(KEYS, row, strict=True))} for old, row in rows]


def _filled(x: Array, q: Array) -> Array:
    """The frames with the number before in the place of each that is none."""
    known = np.concatenate([q[None], x])
    rows = np.where(np.isfinite(known), np.arange(len(known))[:, None], 0)
    return known[np.maximum.accumulate(rows), np.arange(len(q))][1:]
