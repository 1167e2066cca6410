"""Which limits a run has broken, and which it was at when it ended.

Places and speeds of joints are judged by the robot's own limits, whatever the scenario keeps free
of them; all others by what :meth:`coopqp.limit.Limit.margins` says. What was beyond a limit from
the start counts from where it began.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from coopqp.checked import Array
from coopqp.limit import ROUNDING
from coopqp.row import Row
from coopqp.trace import Trace

#: An overrun below this is told, but nobody's fault: a servo's lag, the curvature of a tick's step.
#: It is a tenth of what hobby servos and NAO's encoders resolve, a tenth of a millimetre.
NEGLIGIBLE = {"rad": 1e-4, "m": 1e-4, "rad/s": 1e-3, "m/s": 1e-3, "rad/s2": 0.1, "m/s2": 0.1}
#: A row with less room than this is at its limit [rad, m]; walls are approached ever more slowly.
AT_LIMIT = 1e-4
#: A joint with less room than this is, unless servos let it sag [rad, m].
AT_JOINT_LIMIT = 1e-6
#: Judged by the robot's limits; what cannot be braked any more shows when the place is overrun.
JUDGED_OTHERWISE = ("position", "velocity", "braking")


#: Slower than this the arms rest [rad/s, m/s].
RESTS = 1e-3
#: A speed or acceleration with less room than this is at its limit [the row's unit], and a limit
#: that is met in more than this share of the ticks holds a run up.
AT_SPEED, OFTEN = 1e-4, 0.25
#: What joints' limits that bound no place are called, by the end of their unit.
RATES = {"/s": "speed", "/s2": "acceleration"}


@dataclass(frozen=True)
class Overrun:
    """A limit that a run has broken.

    Attributes:
        row: the one of its rows that was broken most.
        by: how far beyond the limit it was, at worst [the row's unit].
        at_start: how far it was when the run began, 0 inside.
        at_end: how far it is when the run has ended, 0 inside.
    """

    row: Row
    by: float
    at_start: float
    at_end: float

    @property
    def farther(self) -> bool:
        """Whether the run went farther out than it began."""
        return matters(self.by - self.at_start, self.row.unit)


def broken(trace: Trace) -> list[Overrun]:
    """One overrun for each limit that the run was beyond by more than is negligible."""
    worst: dict[str, Overrun] = {}
    for row, margin in trace.margins.items():
        if (row.joint and row.owner in JUDGED_OTHERWISE) or not margin.size:
            continue
        begun = -trace.starts.get(row, float(margin[0]))
        at_start, at_end = max(0.0, begun), max(0.0, float(-margin[-1]))
        found = Overrun(row, max(begun, float(-margin.min())), at_start, at_end)
        known = worst.get(row.owner)
        if matters(found.by, row.unit) and (not known or _worse(found, known)):
            worst[row.owner] = found
    return list(worst.values())


def _worse(one: Overrun, other: Overrun) -> bool:
    return (one.farther, one.by) > (other.farther, other.by)


def matters(by: float, unit: str) -> bool:
    """Whether an overrun is more than anybody's sensors could see."""
    return by > NEGLIGIBLE.get(unit, ROUNDING)


def outside(trace: Trace) -> Array:
    """How far each joint is beyond its place's limits, negative inside, shape (T + 1, n)."""
    return np.maximum(trace.lower - trace.q, trace.q - trace.upper)


def at_limits(trace: Trace, instant: int) -> tuple[str, ...]:
    """Joints at a limit that they have not left, and other limits of place, by name.

    Args:
        trace: of a run.
        instant: row of trace.q.
    """
    return tuple(dict.fromkeys((*_joints_at(trace, instant), *_others_at(trace, instant))))


def _joints_at(trace: Trace, instant: int) -> Iterator[str]:
    kept = outside(trace).max(axis=0) <= ROUNDING
    near = outside(trace)[instant] > -AT_JOINT_LIMIT
    yield from np.array(trace.joints)[near & kept].tolist()


def _others_at(trace: Trace, instant: int) -> Iterator[str]:
    """Of a controller that keeps them: one that breaks limits is not stopped by any."""
    if not trace.keeps_limits or instant == 0:
        return
    for row, margin in trace.margins.items():
        if row.owner == "position" and margin[instant - 1] < AT_JOINT_LIMIT:
            yield row.joint
        elif row.unit == "m" and not row.joint and margin[instant - 1] < AT_LIMIT:
            yield row.owner


def slowed_by(trace: Trace, k: int) -> tuple[str, ...]:
    """Limits of speed and acceleration that held a run up, by name, such as "speed of left_2".

    Those that were met in more than a quarter of the ticks for which a task counts, where the arms
    still move when these end. ``coopqp explain`` finds out more, with what would do.

    Args:
        trace: of a run.
        k: which of its tasks.
    """
    instants = range(len(trace.t))[trace.tasks[k].rows]
    ticks = slice(instants[0], instants[-1])
    moves = np.abs(trace.v[ticks][-1:]).max(initial=0.0) > RESTS
    if not trace.keeps_limits or not moves:
        return ()
    met = (
        row
        for row, margin in trace.margins.items()
        if row.unit.endswith(tuple(RATES)) and np.mean(margin[ticks] < AT_SPEED) > OFTEN
    )
    return tuple(dict.fromkeys(_called(row) for row in met))


def _called(row: Row) -> str:
    rate = next(word for end, word in RATES.items() if row.unit.endswith(end))
    return f"{rate} of {row.joint}" if row.joint else row.owner
