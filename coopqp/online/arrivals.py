"""Checks of what comes with a tick of the loop: inputs and measured joints.

The loop's time stands still while it comes to rest, and waits for late ticks. Time stamps of values
are of a clock that does neither, so their age is what counts: sent = t - age.
"""

import math
from collections.abc import Collection, Iterator, Mapping
from numbers import Real
from typing import Any

import numpy as np

from coopqp.base.errors import InvalidValueError, unknown_name
from coopqp.base.spec import Array, real
from coopqp.base.wording import message_of, raised
from coopqp.kernel import native
from coopqp.model.closed_chain import ClosedChain
from coopqp.scenario.input import AHEAD, Arrival, Inputs, InputSettings
from coopqp.signal import Kind, matrix
from coopqp.solver import Status

#: Number of unknown names that are remembered, to report each only once.
MAX_NAMES = 100


class Arrivals:
    """From a mapping of the user's to arrivals at the inputs of a phase that began ``since`` [s].

    ``names`` are those of all inputs; those that no task of this phase follows are ignored.

    Attributes:
        refused: what was wrong with the mapping of the last tick, a sentence each.
    """

    def __init__(self, inputs: Inputs, names: Collection[str], since: float) -> None:
        self._inputs, self._names, self._since = inputs, names, since
        self._stamped: dict[str, float] = {}
        self._sent: dict[str, float] = {}
        self._unknown: set[str] = set()
        self.refused: list[str] = []

    def read(self, given: Any, t: float, now: float, ahead: float) -> list[Arrival]:
        """The arrivals of a tick, at the loop's time t and ``now`` [s].

        Time stamps are of a clock that ``now`` is ahead of, since it was set back [s].
        """
        self.refused, self._ahead = [], ahead
        if not isinstance(given, Mapping):
            self.refused = [f"inputs: found a {type(given).__name__}, needs values by name"]
            return []
        arrived: list[Arrival] = []
        try:
            for name, value in given.items():
                arrived += self._read(name, value, t, now)
        except Exception as error:  # noqa: BLE001 - a mapping or a key of a user's class
            self.refused.append(f"inputs: {raised(error)}")
        return arrived

    def _read(self, name: Any, value: Any, t: float, now: float) -> Iterator[Arrival]:
        channel = self._inputs.channels.get(name)
        if channel is None:
            name = str(name)
            new = name not in self._unknown and len(self._unknown) < MAX_NAMES
            if new and name not in self._names:
                self._unknown.add(name)
                self.refused.append(unknown_name("input", name, self._names))
            return
        stamped = isinstance(value, tuple) and len(value) == 2
        if not stamped or isinstance(value[0], Real):  # two numbers are a value
            self._stamped[name] = now  # it is sent when it arrives
            yield name, in_columns(channel.kind, value), self._shared(name, t)
            return
        value, given = value
        stamp, why = self._stamp(name, given, now, self._ahead)
        if why:
            self.refused.append(f"{name}: {why}")
            return
        # A late tick must not make a later value the older one.
        sent = max(t - (now - stamp), self._sent.get(name, -math.inf))
        self._stamped[name] = stamp
        yield name, in_columns(channel.kind, value), self._shared(name, min(sent, t))

    def check_stamp(self, name: str, given: Any, now: float, ahead: float) -> None:
        """Refuse what cannot count that was sent then; InvalidValueError says why."""
        stamp, why = self._stamp(name, given, now, ahead)
        if not why and now - stamp > InputSettings.stale_after:
            why = f"is {now - stamp:.3g} s old"
        if why:
            raise InvalidValueError(f"{name}: {why}")
        self._stamped[name] = stamp

    def age(self, time: float) -> None:
        """Make what has arrived older by a time that the loop's own time does not count [s]."""
        for channel in self._inputs.channels.values():
            channel.sent -= time

    def _shared(self, name: str, t: float) -> float:
        """The time exactly as a replay of the session computes it."""
        self._sent[name] = (self._since + t) - self._since
        return self._sent[name]

    def _stamp(self, name: str, given: Any, now: float, ahead: float) -> tuple[float, str]:
        """When a value was sent by ``now``, and what is wrong with that."""
        time, last = as_time(given), self._stamped.get(name, -math.inf)
        if time is None:
            return math.nan, "needs a value, or a value and when it was sent [s]"
        stamp, why = time + ahead, ""
        if stamp > now + AHEAD:
            why = f"is from the future, sent at {stamp:.3f} s and it is {now:.3f} s"
        elif stamp < last:
            why = f"is older than the last, sent at {stamp:.3f} s after {last:.3f} s"
        return stamp, why


def in_columns(kind: Kind, value: Any) -> Any:
    """A value as a file's columns have it; what is none stays as it is, for the input to refuse."""
    try:
        found = real(value)
        if found.shape == (len(kind.columns),):
            return found
    except ValueError:
        pass
    try:
        read = kind.read(value)
    except Exception:  # noqa: BLE001 - anything can arrive
        return value
    return matrix(read)[:, 2] if kind.axis else read


def as_time(given: Any) -> float | None:
    """A finite time [s]; None where it is none."""
    if isinstance(given, bool) or not isinstance(given, Real):
        return None
    try:
        found = float(given)
    except Exception:  # noqa: BLE001 - it may be of a user's class, or a huge integer
        return None
    return found if math.isfinite(found) else None


#: Joints have jumped if they moved since the last reading by more than their velocity limit allows
#: times this factor, and this much for noise [rad, m]; nor is a measured velocity beyond the first.
FASTER, NOISE = 1.5, 0.02
#: Ways by velocities and by positions are compared for so long [s], and may differ by this share
#: beside the noise; time constant of a velocity that is taken from positions [s].
COMPARED, SHARE, SLOPE_TIME = 0.3, 0.3, 0.01
FLOAT = np.dtype(float)
#: Limit of joints without a velocity limit [rad/s, m/s].
UNLIMITED = 1e6


class Readings:
    """The last configuration that was accepted.

    Where there is no new one, the last counts for ``silent_after`` [s].

    Attributes:
        q: of all joints, shape (n,) [rad, m]; NaN before the first. Passive joints that are not
            measured have their commanded values.
        v: their velocities, shape (n,) [rad/s, m/s]; None where they are not asked for (``rates``).
        misread: indices of joints whose velocities do not fit their positions, oldest first; all
            of ``v`` are then the positions' rates of change.
        note: what was wrong with the last reading; empty if nothing was.
    """

    def __init__(
        self, chain: ClosedChain, silent_after: float = 0.0, *, rates: bool = False
    ) -> None:
        self._chain, n, self._silent_after = chain, chain.n, silent_after
        self.q, self.note = np.full(n, np.nan), ""
        self.v: Array | None = np.zeros(n) if rates else None
        self.misread: tuple[int, ...] = ()
        self._ways, self._slope, self._beyond = np.zeros((2, n)), np.zeros(n), np.zeros(n, bool)
        self._reading, self._away = np.zeros(n), np.full(n, np.nan)
        self._own = np.setdiff1d(np.arange(n), chain.passive)
        self._max_speed = FASTER * np.nan_to_num(np.abs(chain.velocity), posinf=UNLIMITED)
        self._since = 0.0
        self._read_at = -np.inf
        self._fault: Status | None = None
        made, found = (self._own.tolist(), self._max_speed.tolist(), NOISE), native.module()
        self._quick: Any = found and found.Reading(self.q, *made).take

    def forget(self) -> None:
        self.q[:], self._read_at, self.misread = np.nan, -np.inf, ()
        self._ways[:] = self._slope[:] = 0.0
        self._away[:], self._fault = np.nan, None

    def take(self, q: Any, commanded: Array, now: float) -> Status | None:
        """What is wrong with a reading of all n joints or the robot's own; else it is in ``q``."""
        if q is None and now - self._read_at < self._silent_after:
            return self._fault
        if q is None:
            self.note = "read() gave None"
            return Status.ROBOT_SILENT
        self.note = ""
        q, v = (q, None) if self.v is None else self._with_rates(q)
        self._read_at, before, elapsed = now, self.q.copy(), now - self._since
        self._fault = Status.NOT_MEASURED if self.note else self._judge(q, commanded, now)
        if self.v is not None and not self._fault:
            self._fault = self._judge_rates(v, self.q - before, elapsed)
        return self._fault

    def _judge_rates(self, v: Any, moved: Array, elapsed: float) -> Status | None:
        """Velocities that no joint can have, or that do not move it (NaN: nobody knows)."""
        assert self.v is not None
        if elapsed > 0.0 and np.isfinite(moved).all():
            self._compare(v, moved, elapsed)
        v = self._slope if self.misread else v  # as likely all are wrong
        if (wrong := np.abs(v) > self._max_speed).any():
            i = int(np.argmax(wrong))
            unit, limit = self._chain.joint_units[i], self._max_speed[i] / FASTER
            at = f"{self._chain.joint_names[i]} at {v[i]:+.3g} {unit}/s"
            self.note = f"{at}, but its limit is {limit:.3g}"
            return Status.NOT_MEASURED
        self.v[:] = v
        return None

    def _compare(self, v: Array, moved: Array, elapsed: float) -> None:
        """Find joints that do not go as far as their velocities say, and how fast they go."""
        max_speed, ways = self._max_speed, self._ways
        self._slope += (moved - elapsed * self._slope) / max(SLOPE_TIME, elapsed)
        np.clip(self._slope, -max_speed, max_speed, self._slope)
        beyond = np.abs(v) > max_speed
        way = np.where(beyond & ~self._beyond, moved, np.clip(v, -max_speed, max_speed) * elapsed)
        self._beyond = beyond  # a single one is a reading that is lost
        ways *= math.exp(-elapsed / COMPARED)
        ways += np.stack([way, moved])
        off = np.abs(ways[0] - ways[1]) - SHARE * np.abs(ways).max(axis=0)
        found = np.flatnonzero(off > NOISE).tolist()
        self.misread = tuple(dict.fromkeys((*self.misread, *found)))

    def _numbers(self, given: Any) -> Array | None:
        try:
            return real(given)
        except Exception as error:  # noqa: BLE001 - anything can come from a driver
            self.note = message_of(error) or f"found {type(given).__name__}, needs numbers"
            return None

    def _with_rates(self, given: Any) -> tuple[Any, Any]:
        if (found := self._numbers(given)) is None:
            return None, None
        if found.shape != (2, len(self.q)):
            words = "joints and their velocities, by which torques are computed"
            self.note = f"found shape {found.shape}, needs {(2, len(self.q))}: {words}"
        elif not np.isfinite(found[1]).all():
            self.note = "the velocities of joints are NaN or infinite"
        return (None, None) if self.note else (found[0], found[1])

    def _judge(self, q: Any, commanded: Array, now: float) -> Status | None:
        usual = self._quick and type(q) is np.ndarray and q.dtype == FLOAT and not self._fault
        if usual and self._quick(q, commanded, now - self._since):
            self._since = now
            return None
        if not self._read(q, commanded):
            return Status.NOT_MEASURED
        elapsed, moved = now - self._since, self._reading - self.q
        beyond = np.abs(moved) - (NOISE + self._max_speed * max(0.0, elapsed))
        self._since = now  # of a jump as well, which must not become plausible with time
        # What has jumped jumps back, or arms that brake would come to where it seems to be.
        away = (beyond > 0.0) | (np.abs(self._reading - self._away) < NOISE)  # False of NaN
        self._away[:] = np.where(away, self._reading, np.nan)
        if away.any():  # False before the first accepted reading
            i = int(np.argmax(np.where(away, np.abs(moved), 0.0)))
            way = f"{moved[i]:+.3g} {self._chain.joint_units[i]}"
            self.note = f"{self._chain.joint_names[i]} by {way} in {elapsed:.3g} s"
            return Status.MEASURED_JUMPED
        self.q[:] = self._reading
        return None

    def _read(self, q: Any, commanded: Array) -> bool:
        reading, given = self._reading, self._numbers(q)
        if given is None:
            return False
        if given.shape == reading.shape:
            reading[:] = given
        elif given.shape == self._own.shape:
            reading[:] = commanded
            reading[self._own] = given
        else:
            self.note = f"found shape {given.shape}, needs {reading.shape}"
            return False
        self.note = self._chain.unusable(reading)
        return not self.note
