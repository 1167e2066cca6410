"""What limits had left in a run, as they say, and at which it was.

Places and speeds of joints are judged by the robot's own limits, whatever the scenario keeps free
of them; all others by what :meth:`coopqp.limit.Limit.margins` says. What was beyond a limit from
the start counts from where it began.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coopqp.assessment.thresholds import AT_LIMIT, HELD_UP, OUTSIDE, matters, rests
from coopqp.base.errors import InvalidValueError
from coopqp.base.qp import Row
from coopqp.base.spec import Array, type_name
from coopqp.base.wording import raised, written_in
from coopqp.limit import Limit
from coopqp.model.closed_chain import ClosedChain
from coopqp.trace import Trace

#: Judged by the robot's limits; what cannot be braked any more shows when the place is left.
JUDGED_OTHERWISE = ("position", "velocity", "braking")
#: What joints' limits that bound no place are called, by the end of their unit.
RATES = {"/s": "speed", "/s2": "acceleration"}


@dataclass(frozen=True)
class LimitViolation:
    """A limit that a run was beyond by more than is negligible."""

    name: str  # of the joint, or of the limit; "speed of" the joint
    row: Row  # the one of its rows that was broken most
    by: float  # how far beyond the limit it was, at worst [the row's unit]
    at: float  # when [s]
    at_start: float  # how far when the run began; 0 inside
    at_end: float  # the same when it has ended

    @property
    def farther(self) -> bool:
        """Whether the run went farther out than it began."""
        return matters(self.by - self.at_start, self.row.unit)


def beyond(trace: Trace) -> Array:
    """How far each joint is beyond its place's limits, negative inside, shape (T + 1, n)."""
    return np.maximum(trace.lower - trace.q, trace.q - trace.upper)


def worst_of_joint(row: Row, trace: Trace, over: Array, at_start: float) -> LimitViolation:
    """The worst of what a joint was over its limit."""
    k = int(over.argmax())
    by, at = float(over[k]), float(trace.t[k])
    return LimitViolation(row.name, row, by, at, at_start, float(over[-1]))


def at_limits(trace: Trace, instant: int) -> tuple[str, ...]:
    """Joints at a limit that they have not left, and other limits of place, by name.

    Of others only for a controller that keeps them: one that breaks limits is not stopped by any.
    """
    out = beyond(trace)
    near = (out.max(axis=0) <= OUTSIDE) & (out[instant] > -AT_LIMIT)
    names = np.array(trace.joints)[near].tolist()
    for row, margin in trace.margins.items() if trace.keeps_limits and instant else ():
        at = margin[instant - 1] < AT_LIMIT
        if at and row.owner == "position":
            names.append(row.joint)
        elif at and row.unit == "m" and not row.joint:
            names.append(row.owner)
    return tuple(dict.fromkeys(names))


def slowed_by(trace: Trace, k: int) -> tuple[str, ...]:
    """Limits of speed and acceleration that held a run up, by name, such as "speed of left_2".

    Those that were met in many of the ticks for which a task counts, where the arms still move when
    these end. ``coopqp explain`` finds out more, with what would do.
    """
    instants = range(len(trace.t))[trace.tasks[k].rows]
    ticks = slice(instants[0], instants[-1])
    if not trace.keeps_limits or rests(trace.v[ticks][-1:]):
        return ()
    named: dict[str, None] = {}
    for row, margin in trace.margins.items():
        for end, rate in RATES.items():
            if row.unit.endswith(end) and np.mean(margin[ticks] < AT_LIMIT) > HELD_UP:
                named[f"{rate} of {row.joint}" if row.joint else row.owner] = None
    return tuple(named)


@dataclass(frozen=True)
class Audit:
    """What all limits had left, as the trace has it."""

    margins: dict[Row, Array]  # after each tick
    starts: dict[Row, float]  # at rest before the first
    unaudited: tuple[str, ...]  # that do not say so, by name, with why where they say it wrongly


def audit(
    limits: Sequence[Limit],
    chain: ClosedChain,
    q: Array,
    v: Array,
    dt: float,
    before: Array | None = None,
) -> Audit:
    """Ask limits what they had left; q has shape (T + 1, n) [rad, m], v (T, n) [rad/s, m/s].

    ``before`` is the velocity of the tick before the first, shape (n,); at rest when omitted.
    """
    start, first = q[:1], 0
    if before is not None and before.any():
        # Limits take what comes before v for rest, so the tick before goes with it.
        q, v, first = np.vstack([start - dt * before, q]), np.vstack([before[None], v]), 1
    margins, starts, unaudited = dict[Row, Array](), dict[Row, float](), list[str]()
    for limit in limits:
        name = type_name(type(limit))
        try:
            own = {row: of[first:] for row, of in _left(limit, chain, q, v, dt).items()}
            begun = _left(limit, chain, start[[0, 0]], np.zeros_like(start), dt)
            if not limit.audited(chain):
                unaudited.append(name)
        except InvalidValueError as error:
            unaudited.append(f"{name} ({error})")
            continue
        margins |= own
        starts |= {row: float(margin[0]) for row, margin in begun.items()}
    return Audit(margins, starts, tuple(dict.fromkeys(unaudited)))


def _left(limit: Limit, chain: ClosedChain, q: Array, v: Array, dt: float) -> dict[Row, Array]:
    """What one limit had left after each tick: :meth:`coopqp.limit.Limit.margins`, checked."""
    file = written_in(limit, "bind")
    try:
        found = limit.margins(chain, q, v, dt)
        rows = {row: np.asarray(margin, float) for row, margin in found.items()}
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise InvalidValueError(raised(error, file)) from error
    own = type(limit).__module__.startswith("coopqp.limits.")
    for row, margin in rows.items():
        if wrong := _wrong_with(row, margin, len(v), () if own else JUDGED_OTHERWISE):
            raise InvalidValueError(f"{file}: margins() {wrong}")
    return rows


def _wrong_with(row: object, margin: Array, ticks: int, taken: Sequence[str]) -> str:
    """Why a margin cannot be used; empty where it can."""
    if not isinstance(row, Row):
        return f"has the key {row!r:.40}, needs a Row"
    if row.owner in taken:
        return f"has a row of the owner '{row.owner}', which coopqp's own limit is; rename it"
    if margin.shape != (ticks,):
        return f"gives the shape {margin.shape} for '{row}', needs ({ticks},)"
    if not (margin > -np.inf).all():
        return f"gives {margin.min()} for '{row}', needs a number, or inf where nothing is near"
    return ""
