"""Inputs: values that arrive from outside while the arms move, and what is made of them.

What arrives goes through ``TrajectoryFilter``, so that a jump becomes a bounded motion,
and is stale when nothing new has come for a while. What is followed stands in ``state.inputs``,
and with it the clocks of ways that wait for the joints.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np

from coopqp.base.errors import InvalidValueError, UnknownNameError
from coopqp.base.reading import FilePath
from coopqp.base.spec import Array, Positive, spec
from coopqp.base.table import read_table
from coopqp.base.wording import counted
from coopqp.model.state import State
from coopqp.model.trajectory_filter import MotionLimits, TrajectoryFilter
from coopqp.signal import CLOCK, InputValues, Kind, Moment, Reads, Signal, Trajectory
from coopqp.task import Task

Arrival = tuple[str, Any, float]
"""Name of an input, a value, and when it was sent by the clock of the state [s]."""

#: Numbers beyond this are no place, turn or speed of a robot.
FARTHEST = 1e6
#: How far ahead of the loop's clock a value may be stamped [s].
AHEAD = 1e-3
#: What the loop's clock may be off by, which is summed up tick by tick [s].
SUMMED = 1e-6
#: How far a joint may be from its way before the clock goes slower, and where it stands [rad, m].
BEHIND, STANDS = 0.03, 0.15
#: How long the clock takes at least from full speed to rest and back [s].
BRAKES = 0.3


@spec
class InputSettings(MotionLimits):
    """How an input is followed, when it is stale, and what feeds it in comparisons."""

    stale_after: Positive = 0.25
    """Time without a new value after which it is stale [s]."""
    when_stale: Literal["brake", "hold"] = "brake"
    """brake: come to rest; hold: go on to the last value and stay there."""
    lower: list[float] | None = None
    """Lower bound of each number; a value beyond is taken as this."""
    upper: list[float] | None = None
    """Upper bound of each number."""
    feed: Annotated[Signal | None, Reads(None)] = None
    """A signal that plays the part of who sends, in every tick of a comparison."""
    feed_file: FilePath | None = None
    """Instead: a CSV or Parquet file with what was sent, columns t and those of the value."""

    def __post_init__(self) -> None:
        MotionLimits.__post_init__(self)
        if self.feed is not None and self.feed_file is not None:
            raise ValueError("give feed or feed_file, not both")
        for low, high in zip(self.lower or (), self.upper or (), strict=False):
            if low > high:
                raise ValueError(f"lower {low:g} is more than upper {high:g}")


class Channel(TrajectoryFilter):
    """One input while the arms move, of a kind, at rest where it begins, shape (values,).

    InvalidValueError: it begins nowhere, or settings do not fit.
    """

    def __init__(self, kind: Kind, start: Array | None, settings: InputSettings, dt: float) -> None:
        if kind.velocity and settings.when_stale == "hold":
            words = "when_stale: hold would go on for ever with a velocity; use brake"
            raise InvalidValueError(words)
        for key in ("lower", "upper"):
            found = getattr(settings, key)
            if found is not None and len(found) != kind.numbers:
                needs = f"needs {kind.numbers} for a {kind.name}"
                raise InvalidValueError(f"{key}: found {counted(len(found), 'number')}, {needs}")
        if start is None:
            words = f"where is the {kind.name} before anything arrives? Say it where it is used"
            raise InvalidValueError(f"{words}, as input: {{name: ..., start: [...]}}")
        super().__init__(kind, settings, dt, start)
        self._settings = settings
        self.target = self.value.copy()  # arrived last, or is where it began
        self.sent = -math.inf  # when that was [s]
        lower, upper = settings.lower or -math.inf, settings.upper or math.inf
        self._lower, self._upper = np.array(lower, float), np.array(upper, float)

    def take(self, value: Any, sent: float, now: float) -> str:
        """Take an arrived value, :meth:`coopqp.signal.Kind.read`; why it cannot be used, or ""."""
        try:
            found = self.kind.read(value)
        except InvalidValueError as error:
            return str(error)
        except Exception as error:  # noqa: BLE001 - anything can arrive
            return f"cannot be read: {type(error).__name__}"
        if np.abs(found).max() > FARTHEST:
            return f"found {np.abs(found).max():.3g}, which is nowhere"
        if not sent <= now + AHEAD:
            return f"is from the future, sent at {sent:.3f} s and it is {now:.3f} s"
        if sent < self.sent:
            return f"is older than the last, sent at {sent:.3f} s after {self.sent:.3f} s"
        k = self.kind.numbers
        np.clip(found[:k], self._lower, self._upper, out=found[:k])
        self.target[:], self.sent = found, sent
        return ""

    def stale(self, now: float) -> bool:
        """Whether nothing new has come in time."""
        return not now - self.sent <= self._settings.stale_after

    def advance(self, now: float) -> bool:
        """Go on for one dt; whether there was a way."""
        brakes = self.stale(now) and self._settings.when_stale == "brake"
        return self.step(None if brakes else self.target)


class Clock(Trajectory):
    """Time along ways of joints, which goes slower the farther one of these is from its way.

    With the largest distance d, and the pace changing by at most dt / ``BRAKES`` a tick,

        t <- t + pace dt,   pace -> (STANDS - d) / (STANDS - BEHIND), between 0 and 1

    so what follows the ways stays continuous, and goes on from where it has waited.
    """

    moves = True

    def __init__(self, ways: Sequence[Trajectory], joints: Sequence[str], dt: float) -> None:
        super().__init__(CLOCK, np.zeros(1))
        self._dt = dt
        self._ways = [(way, [joints.index(name) for name in way.kind.columns]) for way in ways]
        self.rate[0] = 1.0

    def advance(self) -> None:
        """Go on for one dt at the pace of the last tick."""
        self.value[0] += self._dt * self.rate[0]

    def look(self, q: Array) -> None:
        """Take the pace that joints at q (n,) allow; the last where q has NaN."""
        away = 0.0
        for way, at in self._ways:
            way.update(Moment(float(self.value[0])))
            away = max(away, float(np.abs(q[at] - way.value).max()))
        pace, change = (STANDS - away) / (STANDS - BEHIND), self._dt / BRAKES
        if pace == pace:
            before = float(self.rate[0])
            self.rate[0] = min(max(pace, before - change, 0.0), before + change, 1.0)


def wanted(tasks: Sequence[Task], start: State) -> dict[str, tuple[Kind, Array | None]]:
    """Kind and start of each input and clock that tasks follow; CoopqpError if wanted as two."""
    start.inputs = InputValues()
    for task in tasks:
        task.bind(start)
    for name, _ in start.inputs.ways:
        start.inputs.want(name, CLOCK, CLOCK.zero)
    return start.inputs.wanted


class Inputs:
    """All inputs of a run, put into its first state; CoopqpError: not there, or of another kind."""

    def __init__(
        self, settings: Mapping[str, InputSettings], tasks: Sequence[Task], start: State, dt: float
    ) -> None:
        self._now = -math.inf
        self.channels: dict[str, Channel] = {}
        self.clocks: dict[str, Clock] = {}
        for name, (kind, here) in wanted(tasks, start).items():
            if kind == CLOCK:
                own = [(j, way) for (of, j), way in start.inputs.ways.items() if of == name]
                ways = [way for joints, way in own if joints]
                self.clocks[name] = Clock(ways, start.chain.joint_names, dt)
                continue
            if name not in settings:
                raise UnknownNameError("input", name, settings)
            self.channels[name] = Channel(kind, here, settings[name], dt)
        start.inputs.update(self.channels)
        start.inputs.update(self.clocks)

    @property
    def move(self) -> bool:
        """Whether there is anything that :meth:`step` changes."""
        return bool(self.channels or self.clocks)

    def step(self, state: State, arrivals: Iterable[Arrival] = ()) -> None:
        """Take arrivals, oldest first by the state's clock [s], and go on to the state's time."""
        followed, now = state.inputs, state.t
        refused = []
        arrived: dict[str, tuple[float, Array]] = {}
        for name, value, sent in arrivals:
            channel = self.channels.get(name)
            why = channel.take(value, sent, now) if channel else "no such input"
            if why:
                refused.append(f"{name}: {why}")
            elif channel:
                arrived[name] = channel.sent, channel.target
        goes_on, reading = now > self._now > -math.inf, state.reading
        for name, clock in self.clocks.items():
            if goes_on:
                clock.advance()
            clock.look(state.q if reading is None else reading)
            arrived[name] = now, clock.value
        for name, channel in self.channels.items() if goes_on else ():
            if not channel.advance(now):
                refused.append(f"{name}: no way there within its bounds")
        self._now = now
        followed.arrived, followed.refused = arrived, tuple(refused)
        followed.stale = tuple(n for n, channel in self.channels.items() if channel.stale(now))


class Feed:
    """Who sends, in a comparison, from ``since`` [s] on; CoopqpError: not of the input's kind."""

    def __init__(
        self, settings: Mapping[str, InputSettings], inputs: Inputs, since: float = 0.0
    ) -> None:
        self.inputs, self._since = inputs, since
        self._signals: dict[str, Trajectory] = {}
        self._rows: dict[str, tuple[Array, Array, Array]] = {}
        self._next = dict[str, int]()
        for name, channel in inputs.channels.items():
            given, kind = settings[name], channel.kind
            if given.feed is not None:
                sends = given.feed.bind(kind, Moment(since), channel.value)
                if sends.arrives:
                    words = "an input cannot feed another, as nothing arrives at it but by its own"
                    raise InvalidValueError(f"feed: input: {words}; needs another signal")
                self._signals[name] = sends
            elif given.feed_file is not None:
                table = read_table(given.feed_file)
                t = table.times()
                sent = table.take(["sent"])[:, 0] if "sent" in table.columns else t
                self._rows[name], self._next[name] = (t, sent, table.take(kind.columns)), 0

    def step(self, state: State) -> None:
        """Let what has been sent arrive, for the tick of a state."""
        self.inputs.step(state, self.arrivals(state.t))

    def arrivals(self, t: float) -> Iterator[Arrival]:
        """What has been sent since the last call, at t since the phase began [s]."""
        now = self._since + t
        for name, signal in self._signals.items():
            signal.update(Moment(now))
            yield name, signal.value, t
        for name, (arrives, sent, values) in self._rows.items():
            until = int(np.searchsorted(arrives, now + SUMMED, side="right"))
            for i in range(self._next[name], until):
                yield name, values[i], float(sent[i]) - self._since
            self._next[name] = max(until, self._next[name])
