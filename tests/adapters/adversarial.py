"""Chunks that break limits on purpose, and what the filter makes of them."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space

from adapters.so101_oracle import LOWER, START, UPPER, Oracle, broken
from coopqp.adapters.chunk_filter import SLACK, ChunkFilter
from coopqp.adapters.motors import ARMS, GRIPPERS, KEYS
from coopqp.base.spec import Array
from coopqp.scenario.loader import load

FRAMES, FPS, DISTANCE = 100, 30.0, 0.01
KINDS = "noise", "jumps", "waves", "into each other", "drift", "holes", "out of range", "still"


@dataclass
class Judged:
    """What came of one chunk.

    What is broken; frames without a reason, changed, at rest although asked to move, and those of
    them that could have moved; time [ms].
    """

    kind: str
    held: bool
    broken: list[str]
    unnamed: int
    changed: int
    still: int
    frozen: int
    cpu: float
    wall: float


def draw(rng: np.random.Generator, start: Array, kind: str) -> Array:
    """Joints (100, 10) that are asked for [rad]."""
    t = np.arange(FRAMES)[:, None] / FPS
    if kind == "noise":
        return start + rng.normal(0.0, rng.choice([0.02, 0.3, 2.0]), (FRAMES, 10))
    if kind == "jumps":
        return np.repeat(rng.uniform(1.3 * LOWER, 1.3 * UPPER, (5, 10)), FRAMES // 5, axis=0)
    if kind == "waves":
        size, rate = rng.uniform(0.0, 2.0, 10), rng.uniform(0.5, 12.0, 10)
        return start + size * np.sin(rate * t)
    if kind == "into each other":
        forth = np.array([0.0, 1.2, -1.2, 0.3, 0.0] * 2) + rng.normal(0.0, 0.4, 10)
        return start + np.minimum(t * rng.uniform(0.3, 4.0), 1.0) * (forth - start)
    if kind == "drift":
        return start + np.cumsum(rng.normal(0.0, 0.05, (FRAMES, 10)), axis=0)
    if kind == "out of range":
        return start + t * rng.uniform(-3.0, 3.0, 10)
    x = start + 0.3 * np.sin(3.0 * t + rng.uniform(0.0, 6.0, 10))
    if kind == "holes":
        x[rng.random((FRAMES, 10)) < 0.05] = rng.choice([np.nan, np.inf, -np.inf, 1e300])
    else:
        x[20:] = x[20]
    return x


def started(rng: np.random.Generator, oracle: Oracle, *, holds: bool) -> Array:
    """Joints in range with the arms apart; near the scenario's start where both hands hold."""
    while True:
        q = rng.normal(START, 0.1) if holds else rng.uniform(LOWER, UPPER)
        if (q > LOWER).all() and (q < UPPER).all() and not oracle.too_near(q):
            return q


class Trial:
    """A filter, and who judges it."""

    def __init__(self) -> None:
        self.filter = ChunkFilter(load("two_so101"), fps=FPS, distance=DISTANCE)
        self.oracle = Oracle(self.filter.watched, DISTANCE - 1e-6)
        self.wide = Oracle(self.filter.watched, DISTANCE + 1.1 * SLACK)  # where laws stop

    def one(self, seed: int) -> Judged:
        """A chunk of a seed, from a start of its own."""
        rng = np.random.default_rng(seed)
        kind, held = KINDS[seed % len(KINDS)], bool(seed // len(KINDS) % 2)
        q0 = started(rng, self.oracle, holds=held)
        start, chunk = np.zeros(len(KEYS)), np.zeros((FRAMES, len(KEYS)))
        grips = np.array([10.0, 20.0]) if held else np.array([80.0, 50.0])
        start[ARMS], start[GRIPPERS] = np.degrees(q0), grips
        chunk[:, ARMS], chunk[:, GRIPPERS] = np.degrees(draw(rng, q0, kind)), grips
        if rng.random() < 0.3:  # they take hold and let go
            chunk[:, GRIPPERS] = np.repeat(rng.uniform(-20.0, 120.0, (4, 2)), FRAMES // 4, axis=0)
        return self.judged(kind, chunk, start, held=held)

    def judged(
        self, kind: str, chunk: Array, start: Array, *, held: bool, at_once: int = FRAMES
    ) -> Judged:
        """What comes of frames (N, 12) from a start, so many of which are filtered at once."""
        self.filter.reset()
        wall, cpu = time.perf_counter(), time.process_time()
        done = [
            self.filter.filter_chunk(chunk[k : k + at_once], None if k else start)
            for k in range(0, len(chunk), at_once)
        ]
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        actions, q0 = np.concatenate([found.actions for found in done]), np.radians(start[ARMS])
        q, grips, grips_of = np.radians(actions[:, ARMS]), start[GRIPPERS], actions[:, GRIPPERS]
        closed = (np.vstack([grips, grips_of]) <= self.filter.settings.holds_below).all(axis=1)
        faults = broken(self.oracle, q, q0, closed[1:] & closed[:-1], FPS)
        if (np.abs(np.diff(grips_of, axis=0, prepend=grips[None])) > 250.0 / FPS + 1e-6).any():
            faults.append("speed of a gripper")
        if (grips_of < 0.0).any() or (grips_of > 100.0).any():
            faults.append("range of a gripper")
        named = {
            k * at_once + change.frame
            for k, found in enumerate(done) for change in found.changes if change.names
        }  # fmt: skip
        other = ~np.isclose(actions, chunk, rtol=0.0, atol=1e-9).all(axis=1)
        unnamed = len(set(np.flatnonzero(other).tolist()) ^ named)
        moves = np.abs(np.diff(q, axis=0, prepend=q0[None])).max(axis=1)
        x, holding = np.radians(chunk[:, ARMS]), closed[1:] & closed[:-1]
        asks = np.isfinite(x).all(axis=1) & (np.abs(x - q).max(axis=1) > 0.01)
        still = [
            self._could_move(q[k], x[k], holds=bool(holding[k]))
            for k in np.flatnonzero(asks & (moves < 1e-6)).tolist()
        ]
        return Judged(
            kind,
            held,
            faults,
            unnamed,
            int(other.sum()),
            len(still),
            sum(still),
            1e3 * cpu,
            1e3 * wall,
        )

    def _could_move(self, q: Array, x: Array, *, holds: bool) -> bool:
        """Whether a milliradian nearer to x is possible: in range, the loop closed, arms apart."""
        wish, stays = np.clip(x, LOWER, UPPER) - q, np.zeros(10, bool)
        for _ in range(10):
            rows = np.eye(10)[stays]
            free = null_space(np.vstack([self.oracle.loop_slope(q), rows]) if holds else rows)
            way = free @ (free.T @ wish) if len(rows) or holds else wish
            out = ((q <= LOWER + 1e-6) & (way < -1e-9)) | ((q >= UPPER - 1e-6) & (way > 1e-9))
            if not (out & ~stays).any():
                break
            stays |= out
        size = float(np.linalg.norm(way))
        return size > 0.01 and not self.wide.too_near(q + 1e-3 * way / size)
