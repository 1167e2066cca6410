"""Faults of a robot that show while its loop runs: what each is called, and what is done.

A joint is judged by how it follows its commands. With dq_c and dq_m the commanded and the measured
motion of one sample, and forgetting sums over them, a joint that follows has a slope

    sum dq_m dq_c(t - lag) / sum dq_c(t - lag)^2

near one for the lag of its servo. Sag and model errors hardly change it, since they add no motion
of their own; so |q_m - q_c|, which they do change, is not asked. A joint is named where no lag up to
``LAGS`` explains what it does, once it was commanded to move by ``TRAVEL``.

Force sensors are judged by one another: the hands' forces and the object's weight add up to zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from coopqp.base.errors import InvalidValueError, unknown_name
from coopqp.base.spec import Array
from coopqp.closed_loop.hands import WrenchReadings, into_contacts, hands
from coopqp.controller import ControlProblem
from coopqp.model.state import State

Reaction = Literal["go_on", "slow_down", "rest"]

#: What is done about each kind of fault; ``OnlineLoop(reactions=...)`` changes it.
REACTIONS: Mapping[str, Reaction] = {
    "joint_reversed": "rest",
    "joint_stands_still": "rest",
    "joint_does_not_follow": "rest",
    "joints_swapped": "rest",
    "loop_offset_at_bound": "go_on",
    "force_sensor_dead": "rest",
    "force_sensor_stuck": "rest",
    "force_sensor_reversed": "rest",
    "forces_do_not_add_up": "go_on",
    "load_differs": "go_on",
    "hand_slips": "slow_down",
}

#: Time between two samples of the joints' motion [s]; what the sums forget in, for fast motion and
#: for slow [s]; how late a joint may follow [s].
SAMPLE, MEMORY, LAGS = 0.02, (0.3, 2.0), (0.0, 0.04, 0.08, 0.12)
#: Commanded motion after which a joint is judged [rad, m]; least slope of one that follows.
TRAVEL, LEAST_SLOPE = 0.01, 0.25
#: Motion of the measured joint below this share of the commanded one is standing still.
STANDS = 0.05


@dataclass(frozen=True)
class Fault:
    """A fault that was found.

    Attributes:
        kind: one of :data:`REACTIONS`.
        where: names of joints or arms.
        t: time of the references [s].
        note: what was seen, and what it may be.
    """

    kind: str
    where: tuple[str, ...]
    t: float
    note: str


def checked_reactions(chosen: Mapping[str, Any] | None) -> dict[str, Reaction]:
    """The reactions with those of the user.

    Raises:
        InvalidValueError: a kind or a reaction is none.
    """
    if chosen is not None and not isinstance(chosen, Mapping):
        raise InvalidValueError(f"reactions: found {chosen!r}; needs a mapping of kinds")
    for kind, reaction in (chosen or {}).items():
        if kind not in REACTIONS:
            raise InvalidValueError(f"reactions: {unknown_name('fault', str(kind), REACTIONS)}")
        if reaction not in get_args(Reaction):
            known = unknown_name("reaction", str(reaction), get_args(Reaction))
            raise InvalidValueError(f"reactions.{kind}: {known}")
    return {**REACTIONS, **(chosen or {})}


class JointFollowing:
    """Whether joints follow their commands.

    Args:
        n: number of joints. names: of them. own: indices of those that are measured.
        dt: control period [s].
    """

    def __init__(self, names: tuple[str, ...], own: Array, dt: float) -> None:
        self._names, self._own, n = names, own, len(own)
        self._every = max(1, round(SAMPLE / dt))
        h = self._every * dt
        self._lags = np.unique([round(lag / h) for lag in LAGS])
        kept = max(int(self._lags[-1]) + 1, round(MEMORY[0] / h))
        decays = [np.exp(-h / memory) for memory in MEMORY]
        self._decay = np.array(decays)[:, None, None, None]
        #: By memory: of dq_m dq_c, dq_c^2 and |dq_c|, for each lag and joint.
        self._sums = np.zeros((len(MEMORY), 3, len(self._lags), n))
        self._new = np.zeros((3, len(self._lags), n))
        self._commanded, self._measured = np.zeros((2, kept, n))  # rings of motions
        self._last = np.full((2, n), np.nan)
        self._count = self._at = 0

    def forget(self) -> None:
        """Begin anew, as after a rest in which somebody may have moved the joints."""
        for kept in (self._sums, self._commanded, self._measured):
            kept[:] = 0.0
        self._last[:] = np.nan
        self._count = 0

    def update(self, q_c: Array, q_m: Array) -> tuple[str, tuple[str, ...], str] | None:
        """Judge a tick's commanded and measured joints, shape (n,): kind, joints, note of a fault."""
        self._count += 1
        if self._count % self._every:
            return None
        q = np.array((q_c[self._own], q_m[self._own]))
        moved = q - self._last
        self._last = q
        if np.isnan(moved[0, 0]):
            return None
        self._at = (self._at + 1) % len(self._commanded)
        self._commanded[self._at], self._measured[self._at] = moved
        past = self._commanded[self._at - self._lags]
        np.multiply(past, moved[1], out=self._new[0])
        np.multiply(past, past, out=self._new[1])
        np.abs(past, out=self._new[2])
        self._sums *= self._decay
        self._sums += self._new
        together, squares, travel = self._sums[:, 0], self._sums[:, 1], self._sums[:, 2]
        bad = (travel[:, 0] > TRAVEL) & (together < LEAST_SLOPE * squares).all(axis=1)
        return self._name(bad) if bad.any() else None

    def _name(self, bad: Any) -> tuple[str, tuple[str, ...], str] | None:
        """The worst joint, once the slowest servo would have begun to follow."""
        found = []
        for window, j in np.argwhere(bad):
            together, squares, travel = self._sums[window, :, :, j]
            slopes = together / np.maximum(squares, 1e-300)
            backwards = (slopes[travel > TRAVEL / 2] < -LEAST_SLOPE).all()
            if backwards or travel[-1] > TRAVEL / 2:
                found.append((float(slopes.max()), int(j), float(travel[0])))
        if not found:
            return None
        slope, j, travel = min(found)
        name = self._names[self._own[j]]
        if other := self._swapped_with(j):
            words = f"{name} moves as {other} is commanded to, and {other} as {name} is"
            return "joints_swapped", (name, other), f"{words}: are the two swapped?"
        if slope < -LEAST_SLOPE:
            words = f"{name} moves against its commands: is the sign of its encoder or motor wrong?"
            return "joint_reversed", (name,), words
        measured = float(np.abs(self._measured[:, j]).sum())
        if measured < STANDS * travel:
            words = f"{name} stands still and is commanded to move: is its encoder or motor dead?"
            return "joint_stands_still", (name,), words
        words = f"{name} does not follow its commands: is it held, or its motor too weak?"
        return "joint_does_not_follow", (name,), words

    def _swapped_with(self, j: int) -> str:
        """The joint whose commands this one follows, if that one follows this one's."""
        order = np.arange(self._at + 1, self._at + 1 + len(self._commanded)) % len(self._commanded)
        c, m = self._commanded[order], self._measured[order]
        for k in range(c.shape[1]):
            if k != j and _follows(c[:, k], m[:, j], self._lags):
                if _follows(c[:, j], m[:, k], self._lags):
                    return self._names[self._own[k]]
        return ""


#: Part of a motion that commands of another joint must leave unexplained at most.
UNEXPLAINED = 0.25


def _follows(c: Array, m: Array, lags: Array) -> bool:
    """Whether a measured motion is a commanded one with some lag; both move."""
    left = [np.sum((m[lag:] - c[: len(c) - lag]) ** 2) for lag in lags]
    size = min(float(c.dot(c)), float(m.dot(m)))
    moves = float(np.abs(c).sum()) > TRAVEL / 2
    return bool(moves and min(left) < UNEXPLAINED * size)
