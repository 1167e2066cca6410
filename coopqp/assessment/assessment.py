"""What became of a run: one answer to each question, which all others read.

Of a task's errors the last sample is its end; of a force those of a last stretch, because one
sample of an oscillation says nothing; of an impedance that is pushed to the end how far it is from
F / K: it was asked to give way by that.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopqp.assessment import limits, thresholds
from coopqp.assessment.limits import LimitViolation
from coopqp.assessment.oscillation import Oscillation, oscillation
from coopqp.base.qp import Row
from coopqp.base.spec import Array
from coopqp.solver import Status, causes_of
from coopqp.task import Level, Mode, level_of
from coopqp.trace import Trace

#: Units of what is asked of the hands' wrenches.
FORCES = ("N", "N m")


def _end_errors(trace: Trace, k: int) -> Array:
    """The errors of task k that count as its end: of a force those of a last stretch."""
    last, task = trace.last_instants[k], trace.tasks[k]
    if pushed(trace, k):
        rows = _rows_of(trace, task.name.rpartition(".")[0])  # the task is one of several parts
        e = trace.e[last, [rows[row] for row, _, _ in task.springs]]
        push = trace.signals["push"][last - 1]
        wanted = np.array([push[axis] / stiffness for _, axis, stiffness in task.springs])
        return np.array([np.linalg.norm(e - wanted)])
    error = trace.task_error[task.rows.start : last + 1, k]
    if task.unit not in FORCES:
        return error[-1:]
    ticks = min(round(thresholds.SETTLED / trace.dt), (len(error) - 1) // 5)
    return error[-max(ticks, 1) :]


def pushed(trace: Trace, k: int) -> bool:
    """Whether task k is an impedance, and the plant pushes the object to its end."""
    last, push = trace.last_instants[k], trace.signals.get("push")
    return bool(trace.tasks[k].springs and push is not None and last and push[last - 1].any())


def _oscillates(trace: Trace, k: int, errors: Array) -> bool:
    """Whether what task k asks for is only passed through, or passed about, at its end."""
    task, last = trace.tasks[k], trace.last_instants[k] + 1
    e = trace.e[last - len(errors) : last, _rows_of(trace, task.name)]
    about = (e.min(axis=0) < -task.tolerance) & (e.max(axis=0) > task.tolerance)
    return bool(errors.min() <= task.tolerance or about.any())


def _rows_of(trace: Trace, task: str) -> list[int]:
    return [i for i, name in enumerate(trace.task_rows) if name.rpartition(".")[0] == task]


#: What a run can break that is no limit: the closed loops, the hold of an object, the plant.
LOOP, HOLD, PLANT = "loop", "hold", "plant"
#: After these a run does not go on, so that nothing is true of it any more.
ENDED = {Status.PLANT_FAILED, Status.OBJECT_LOST}


@dataclass(frozen=True)
class TaskEnd:
    """How a task, or a part of it with a unit of its own, ended."""

    name: str
    unit: str
    tolerance: float
    # where it comes among all tasks; soft and the same where the law supports none
    mode: Mode
    level: Level
    last: int  # the last instant for which it counts
    error: float  # at its end [unit]; a force's largest of the last stretch
    torn: bool  # whether no object was held any more before its end
    oscillates: bool  # whether the goal is only passed through, or about

    @property
    def share(self) -> float:
        """The error in its tolerance; infinite where it is no number."""
        return float(np.nan_to_num(self.error / self.tolerance, nan=np.inf))

    @property
    def arrives(self) -> bool:
        return thresholds.within(self.error, self.tolerance)

    @property
    def reached(self) -> bool:
        """Whether it arrives, with the object in all hands on the way."""
        return self.arrives and not self.torn


@dataclass(frozen=True)
class Inputs:
    """Whether inputs were followed as sent."""

    refused: int  # ticks in which one was
    stale: int  # ticks in which nothing new came at one
    nothing_at: tuple[str, ...]  # names of those at which nothing that can be used has arrived
    refused_at_end: bool  # whether the run ends with what arrives being refused

    @property
    def followed(self) -> bool:
        """Whether goals that are inputs are what was sent."""
        return not (self.nothing_at or self.refused_at_end)


@dataclass(frozen=True)
class Acceleration:
    """The joint whose speed changes most, measured by what the loop for robots allows it."""

    joint: str
    unit: str
    value: float  # the largest change of its velocity from tick to tick, over dt [unit]
    at: float  # when [s]
    allowed: float  # by :class:`coopqp.OnlineLoop` where a scenario has no limit of it [unit]

    @property
    def exceeds(self) -> bool:
        """Whether it is more than the loop for robots allows."""
        return thresholds.matters(self.value - self.allowed, self.unit)


@dataclass(frozen=True, eq=False)
class Assessment:
    """All answers on one run."""

    trace: Trace

    @cached_property
    def tasks(self) -> tuple[TaskEnd, ...]:
        """How each task ended, in their order."""
        trace, apart = self.trace, self._apart
        ordered = trace.orders_tasks
        return tuple(
            TaskEnd(
                task.name,
                task.unit,
                task.tolerance,
                task.mode if ordered else "soft",
                level_of(task.mode, task.priority) if ordered else (0, 0),
                trace.last_instants[k],
                float(errors.max()) if np.isfinite(errors.max()) else np.nan,
                bool(apart[: trace.last_instants[k] + 1].any()),
                _oscillates(trace, k, errors),
            )
            for k, task in enumerate(trace.tasks)
            for errors in (_end_errors(trace, k),)
        )

    @property
    def errors(self) -> Array:
        """Each task's error at its end, shape (K,) [the task's unit]."""
        return np.array([task.error for task in self.tasks], float)

    @property
    def reached(self) -> bool:
        """Whether all tasks are reached, and all inputs were followed."""
        lost = self.ended or self.held is False
        return not lost and self.inputs.followed and all(task.reached for task in self.tasks)

    @property
    def missed(self) -> tuple[TaskEnd, ...]:
        """Tasks whose error ends outside its tolerance: by phase, by level, the worst first."""
        missed = (task for task in self.tasks if not task.arrives)
        return tuple(sorted(missed, key=lambda task: (task.last, task.level, -task.share)))

    @property
    def gave_way(self) -> tuple[TaskEnd, ...]:
        """Of these the ones that come after the first, in its phase."""
        first, *others = self.missed or (None,)
        return tuple(t for t in others if first and t.last == first.last and t.level > first.level)

    @property
    def succeeds(self) -> bool:
        """Whether it reaches its goals and keeps everything: limits, loops, hold, plant."""
        return self.reached and not self.broken

    @cached_property
    def broken(self) -> tuple[str, ...]:
        """What it broke, by name: joints, their speeds, limits, the loop, the hold, the plant."""
        order = self.trace.joints.index
        violations = sorted((*self.joints, *self.speeds), key=lambda found: order(found.row.joint))
        names = [violation.name for violation in (*violations, *self.limits) if violation.farther]
        if self.held is False:
            return *names, HOLD
        if not self.loop_closed:
            names.append(LOOP)
        return (*names, PLANT) if self.ended else tuple(names)

    @cached_property
    def joints(self) -> tuple[LimitViolation, ...]:
        """Joints beyond their places' limits, the farthest first."""
        trace, worst = self.trace, []
        out = np.maximum(limits.beyond(trace), 0.0)
        for i in np.flatnonzero(~(out.max(axis=0) <= 0.0)).tolist():
            joint, unit, k = trace.joints[i], trace.units[i], int(out[:, i].argmax())
            side = "upper" if trace.q[k, i] > trace.upper[i] else "lower"
            row = Row(
                name=joint, kind="limit", owner=joint, unit=unit, joint=joint, of_place=True,
                label=f"{joint} ({side})",
            )  # fmt: skip
            violation = limits.worst_of_joint(row, trace, out[:, i], float(out[0, i]))
            if thresholds.matters(violation.by, unit):
                worst.append(violation)
        return tuple(sorted(worst, key=lambda violation: -np.nan_to_num(violation.by, nan=np.inf)))

    @cached_property
    def speeds(self) -> tuple[LimitViolation, ...]:
        """Joints faster than they can be, by the share of their limit."""
        trace, violations, speed = self.trace, [], np.abs(self.trace.v)
        fastest = speed.max(axis=0, initial=0.0)
        fast = np.flatnonzero(~(fastest <= (1.0 + thresholds.TOO_FAST) * trace.velocity))
        for i in sorted(fast.tolist(), key=lambda i: -fastest[i] / trace.velocity[i]):
            joint, unit = trace.joints[i], f"{trace.units[i]}/s"
            row = Row(name=f"speed of {joint}", kind="limit", owner=joint, unit=unit, joint=joint)
            over = np.maximum(speed[:, i] - trace.velocity[i], 0.0)
            violations.append(limits.worst_of_joint(row, trace, over, 0.0))
        return tuple(violations)

    @cached_property
    def limits(self) -> tuple[LimitViolation, ...]:
        """All other limits that it was beyond, one each."""
        trace, worst = self.trace, dict[str, LimitViolation]()
        for row, margin in trace.margins.items():
            if (row.joint and row.owner in limits.JUDGED_OTHERWISE) or not margin.size:
                continue
            begun, k = -trace.starts.get(row, float(margin[0])), int(margin.argmin())
            by, at = max((-float(margin[k]), float(trace.t[k + 1])), (begun, float(trace.t[0])))
            at_start, at_end = max(0.0, begun), max(0.0, float(-margin[-1]))
            found = LimitViolation(row.owner, row, by, at, at_start, at_end)
            known = worst.get(row.owner)
            more = not known or (found.farther, found.by) > (known.farther, known.by)
            if more and thresholds.matters(by, row.unit):
                worst[row.owner] = found
        return tuple(worst.values())

    @property
    def blocked_by(self) -> tuple[str, ...]:
        """Limits at which it stands where it has missed a goal, or that held it up on its way."""
        names: dict[str, None] = {}
        for k, task in enumerate(self.tasks):
            if not task.arrives:
                names |= dict.fromkeys(limits.at_limits(self.trace, self.trace.last_instants[k]))
                names |= dict.fromkeys(limits.slowed_by(self.trace, k))
        return tuple(names)

    def at_limits(self, k: int) -> tuple[str, ...]:
        """Limits of place at which it is when task k ends, and was never beyond, by name."""
        past = {violation.name for violation in (*self.joints, *self.limits)}
        names = limits.at_limits(self.trace, self.trace.last_instants[k])
        return tuple(name for name in names if name not in past)

    @property
    def loop(self) -> tuple[float, float]:
        """How far apart two arms carried the object at most [m], [rad]."""
        return float(self.trace.loop_position.max()), float(self.trace.loop_orientation.max())

    @property
    def loop_closed(self) -> bool:
        """Whether the loops were closed all the time."""
        return thresholds.closed(*self.loop)

    @property
    def held(self) -> bool | None:
        """Whether hands that press held the object to the end; None where none presses."""
        if self.lost_tick is not None or Status.OBJECT_LOST in self._causes:
            return False
        return None if "held" not in self.trace.signals else True

    @property
    def lost_tick(self) -> int | None:
        """The tick in which the object was lost; None where it was not."""
        held = self.trace.signals.get("held")
        return None if held is None or held[:, 0].all() else int(np.argmin(held[:, 0]))

    @property
    def ended(self) -> bool:
        """Whether it could not go on: the plant broke down, or the object was lost."""
        return not ENDED.isdisjoint(self._causes)

    @cached_property
    def inputs(self) -> Inputs:
        """Whether inputs were followed; all were where there are none."""
        trace = self.trace
        if not trace.inputs:
            return Inputs(0, 0, (), False)
        causes = [causes_of(word) for word in trace.status]
        refused = [Status.INPUT_REFUSED in of for of in causes]
        never = (name for name, kept in trace.inputs.items() if np.isnan(kept.sent).all())
        stale = sum(Status.INPUT_STALE in of for of in causes)
        return Inputs(sum(refused), stale, tuple(never), bool(refused) and refused[-1])

    @cached_property
    def acceleration(self) -> Acceleration | None:
        """The worst of all joints with a motor; it begins at rest. None without ticks."""
        trace = self.trace
        if not trace.ticks or not len(trace.joints):
            return None
        change, share, allowed = accelerations(trace)
        k, i = divmod(int(share.argmax()), share.shape[1])
        joint, unit = trace.joints[i], f"{trace.units[i]}/s2"
        return Acceleration(joint, unit, float(change[k, i]), float(trace.t[k]), float(allowed[i]))

    @property
    def acceleration_free(self) -> bool:
        """Whether its controller would keep a limit of acceleration, and has none."""
        rows = self.trace.margins
        return self.trace.keeps_limits and not any(row.unit.endswith("/s2") for row in rows)

    @cached_property
    def saturated(self) -> dict[str, float]:
        """Share of the ticks in which motors were at their limits, by joint, the largest first."""
        tau = self.trace.signals.get("tau")
        if tau is None or not tau.size:
            return {}
        share = thresholds.at_effort(tau, self.trace.effort).mean(axis=0)
        order = np.argsort(-share, kind="stable").tolist()
        return {
            self.trace.joints[i]: float(share[i]) for i in order if share[i] > thresholds.SATURATED
        }

    @cached_property
    def oscillation(self) -> Oscillation | None:
        """The widest oscillation of a joint since all references have arrived."""
        trace = self.trace
        moves = np.flatnonzero((np.nan_to_num(trace.rate) != 0.0).any(axis=1))
        first = moves[-1] + 1 if len(moves) else 0
        return oscillation(trace.q[first:], trace.units, trace.dt)

    @property
    def motion(self) -> str:
        """How it ends: "at rest", "moving" or "oscillating"."""
        if self.oscillation:
            return "oscillating"
        return "at rest" if thresholds.rests(self.trace.v[-1:]) else "moving"

    @property
    def fastest(self) -> tuple[str, float, str] | None:
        """The joint that is fastest in the last tick, its speed and unit; None without ticks."""
        trace = self.trace
        if not trace.v.size:
            return None
        i = int(np.abs(trace.v[-1]).argmax())
        return trace.joints[i], float(np.abs(trace.v[-1, i])), f"{trace.units[i]}/s"

    @property
    def failed(self) -> tuple[int, dict[str, int]]:
        """Ticks that held still, and how often for which cause, the most frequent first."""
        causes = Counter(failure.cause for failure in self.trace.failures)
        return len(self.trace.failures), dict(causes.most_common())

    @cached_property
    def _causes(self) -> set[Status]:
        """All that any tick said."""
        return {cause for word in set(self.trace.status) for cause in causes_of(word)}

    @cached_property
    def _apart(self) -> NDArray[np.bool_]:
        """Whether hands were too far apart for one object at each instant, shape (T + 1,)."""
        trace = self.trace
        if "held" in trace.signals:  # hands that press may move along the object
            return np.append(False, trace.signals["held"][:, 0] <= 0.0)
        sizes = zip(trace.loop_position.tolist(), trace.loop_orientation.tolist(), strict=True)
        return np.array([thresholds.torn(*size) for size in sizes])


def assess(trace: Trace) -> Assessment:
    """Assess a run; each answer is found when it is first asked for."""
    return Assessment(trace)


class Accelerations(NamedTuple):
    """Of all joints in all ticks, from rest."""

    change: Array  # of the velocity over dt, shape (T, n) [rad/s2, m/s2]
    share: Array  # of what is allowed of it, 0 without a motor, shape (T, n)
    allowed: Array  # shape (n,) [rad/s2, m/s2]


def accelerations(trace: Trace) -> Accelerations:
    """How fast the speeds of joints change from tick to tick, by finite differences."""
    change = np.abs(np.diff(trace.v, axis=0, prepend=0.0)) / trace.dt
    allowed = allowed_acceleration(trace.velocity)
    motors = (trace.effort != 0.0) | np.isfinite(trace.velocity)
    return Accelerations(change, np.where(motors, change / allowed, 0.0), allowed)


def allowed_acceleration(velocity: Array, speed_up: float = thresholds.SPEED_UP) -> Array:
    """What the loop for robots allows joints whose scenario has no limit of it, shape (n,).

    Joints with a speed limit [rad/s, m/s] take ``speed_up`` from rest to full speed [s].
    """
    limited = np.isfinite(velocity) & (velocity > 0.0)
    allowed: Array = np.where(
        limited, velocity / speed_up, float(thresholds.ACCELERATION_UNLIMITED)
    )
    return allowed
