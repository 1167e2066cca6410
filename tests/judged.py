"""The kernel against the plain law along a motion; where they differ an oracle says who is off."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from oracle import UndeterminedError, optimum, plainly
from side_by_side import ask_alike, laws, why

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.model.state import Memory, State
from coopqp.qp_law.law import QPLaw
from coopqp.solver import Status, written

SAME = 1e-10  # [rad/s, m/s]
SAMPLES = 3  # of numbers that moved by their last digit
FACTOR = 10.0  # by which such moves may have been lucky ones


@dataclass
class Seen:
    """What became of the ticks of some motions.

    Attributes:
        ticks: how many. left: to the plain law, by why and what it said.
        alike: how many differ by less than SAME. worst: the largest difference of the others.
        judged: of the others, by who is off.
        kernel_off: where the kernel is off, by how much, and how far rounding moves the optimum.
    """

    ticks: int = 0
    left: Counter[str] = field(default_factory=Counter)
    alike: int = 0
    worst: float = 0.0
    judged: Counter[str] = field(default_factory=Counter)
    kernel_off: list[tuple[str, float, float]] = field(default_factory=list)

    def add(self, other: Seen) -> None:
        """Count another's ticks with these."""
        self.ticks, self.alike = self.ticks + other.ticks, self.alike + other.alike
        self.left, self.judged = self.left + other.left, self.judged + other.judged
        self.worst = max(self.worst, other.worst)
        self.kernel_off += other.kernel_off


def compare(name: str, problem: ControlProblem, ticks: int) -> Seen:
    """Both along a motion."""
    plain, kernel = laws(problem)
    state, seen = plain.start(), Seen(ticks=ticks)
    other = State(problem.chain, memory=Memory(plain.memory_sizes))
    for k in range(ticks):
        ask_alike(other, state)
        command, wanted = kernel.tick(other), plain.tick(state)
        found = command.v
        if not kernel.compiled:
            seen.left[f"{why(kernel)}; {written(wanted.causes)}"] += 1
        elif command.causes != wanted.causes and Status.INACCURATE not in wanted.causes:
            seen.judged[f"{written(command.causes)}, not {written(wanted.causes)}"] += 1
        elif (off := float(np.abs(found - wanted.v).max())) < SAME:
            seen.alike += 1
        else:
            seen.worst = max(seen.worst, off)
            _judge(seen, f"{name}, tick {k}", plain, state, found)
        state.advance(wanted.v, problem.dt)
    return seen


def _judge(seen: Seen, where: str, plain: QPLaw, state: State, found: Array) -> None:
    command = plain.command
    relaxed = plainly(command.causes)
    if relaxed is None:
        seen.judged[f"not judged: {written(command.causes)}"] += 1
        return
    try:
        best = optimum(plain, state, relaxed)
        off, plain_off = (float(np.abs(v - best).max()) for v in (found, command.v))
        if off < SAME:
            seen.judged["the plain law is off"] += 1
            return
        moved = max(_moved(plain, state, relaxed, best, k) for k in range(SAMPLES))
    except UndeterminedError:
        seen.judged["not judged: undetermined"] += 1
        return
    if off <= FACTOR * moved:
        seen.judged["rounding of the numbers moves the optimum as far"] += 1
        return
    seen.judged[f"the kernel is {'further ' if off > plain_off else ''}off"] += 1
    seen.kernel_off.append((where, off, moved))


def _moved(plain: QPLaw, state: State, relaxed: bool, best: Array, seed: int) -> float:
    """How far the optimum moves where all Jacobians move by their last digit."""
    rng = np.random.default_rng(seed)
    first = plain.nearest.hard if relaxed else plain.first
    blocks = [state._J_ext, plain.exact.J, *(s.J for s in plain.stacks), first.qp.A]
    if relaxed:
        blocks.append(first.tasks.J)
    kept = [block.copy() for block in blocks]
    try:
        for block in blocks:
            block *= 1.0 + np.finfo(float).eps * rng.uniform(-1.0, 1.0, block.shape)
        return float(np.abs(optimum(plain, state, relaxed) - best).max())
    finally:
        for block, was in zip(blocks, kept, strict=True):
            block[:] = was
