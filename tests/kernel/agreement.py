"""The kernel against the plain law: ``python -m tests.kernel.agreement --problems 1000``.

The plain law drives along whole motions of the shipped scenarios, and for some ticks of random
problems; the kernel is asked at the same states. Where the two differ by more than 1e-10 rad/s an
oracle in extended precision says which is off (tests/kernel/oracle.py), and by how much the optimum
itself moves where the numbers that it is made of move by their last digit. Exit code 1 where the
kernel is off by more than that.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # what tests share

from scenario_files import LOADABLE
from side_by_side import ask_alike, laws, why

from coopqp.checked import Array
from coopqp.controller import ControlProblem
from coopqp.controllers.qp import QPController
from coopqp.kernel.law import why_not
from coopqp.memory import Memory
from coopqp.qp_law.law import QPLaw
from coopqp.scenario.loader import load
from coopqp.solver import written
from coopqp.state import State
from coopqp.study.stress.draw import draw
from tests.kernel.oracle import UndeterminedError, optimum, plainly

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
        found = kernel.tick(other).v.copy()
        wanted = plain.tick(state)
        if not kernel.compiled:
            seen.left[f"{why(kernel)}; {written(wanted.causes)}"] += 1
        elif (off := float(np.abs(found - wanted.v).max())) < SAME:
            seen.alike += 1
        else:
            seen.worst = max(seen.worst, off)
            _judge(seen, f"{name}, tick {k}", plain, state, found)
        state.advance(wanted.v, problem.dt)
    return seen


def _judge(seen: Seen, where: str, plain: QPLaw, state: State, found: Array) -> None:
    command = plain.command
    given_up = plainly(command.causes)
    if given_up is None:
        seen.judged[f"not judged: {written(command.causes)}"] += 1
        return
    try:
        best = optimum(plain, state, given_up)
        off, plain_off = (float(np.abs(v - best).max()) for v in (found, command.v))
        if off < SAME:
            seen.judged["the plain law is off"] += 1
            return
        moved = max(_moved(plain, state, given_up, best, k) for k in range(SAMPLES))
    except UndeterminedError:
        seen.judged["not judged: undetermined"] += 1
        return
    if off <= FACTOR * moved:
        seen.judged["rounding of the numbers moves the optimum as far"] += 1
        return
    seen.judged[f"the kernel is {'further ' if off > plain_off else ''}off"] += 1
    seen.kernel_off.append((where, off, moved))


def _moved(plain: QPLaw, state: State, given_up: bool, best: Array, seed: int) -> float:
    """How far the optimum moves where all Jacobians move by their last digit."""
    rng = np.random.default_rng(seed)
    exact = plain.exact
    stacks = [plain._fallback._tasks] if given_up else plain.stacks
    blocks = [state.J_loop, exact.hard.J, exact.scaled.J, *(s.J for s in stacks)]
    levels = [plain._fallback._attempts[0].level] if given_up else plain.levels
    blocks += [level.qp.A for level in levels[:1]]
    kept = [block.copy() for block in blocks]
    try:
        for block in blocks:
            block *= 1.0 + np.finfo(float).eps * rng.uniform(-1.0, 1.0, block.shape)
        return float(np.abs(optimum(plain, state, given_up) - best).max())
    finally:
        for block, was in zip(blocks, kept, strict=True):
            block[:] = was


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.kernel.agreement", description=__doc__)
    parser.add_argument("--problems", type=int, default=1000, help="random ones")
    parser.add_argument("--ticks", type=int, default=40, help="of each")
    parser.add_argument("--seed", type=int, default=0, help="of the first; others count up")
    parser.add_argument("--scenarios", action="store_true", help="shipped ones alone")
    asked, everything = parser.parse_args(), Seen()
    for name in LOADABLE:
        scenario = load(name)
        if any(isinstance(c, QPController) for c in scenario.controllers.values()):
            problem = scenario.problem()
            seen = compare(name, problem, scenario.schedule[0].ticks(scenario.dt))
            tell(name, seen)
            everything.add(seen)
    random = Seen()
    for seed in range(asked.seed, asked.seed + (0 if asked.scenarios else asked.problems)):
        problem = draw(seed).problem
        if reason := why_not(problem):
            random.left[reason] += asked.ticks
            random.ticks += asked.ticks
        else:
            random.add(compare(f"seed {seed}", problem, asked.ticks))
    tell(f"{0 if asked.scenarios else asked.problems} random problems", random)
    everything.add(random)
    for where, off, moved in everything.kernel_off:
        click.echo(f"  the kernel is off by {off:.1e} at {where}; rounding moves it by {moved:.1e}")
    return 1 if everything.kernel_off else 0


def tell(name: str, seen: Seen) -> None:
    """One line, and one for each kind of tick that is not alike."""
    decided = seen.ticks - sum(seen.left.values())
    click.echo(f"{name}: {seen.ticks} ticks, {decided} by the kernel, {seen.alike} alike")
    for what, count in seen.judged.most_common():
        click.echo(f"  {count} of up to {seen.worst:.1e} rad/s: {what}")
    for what, count in seen.left.most_common():
        click.echo(f"  {count} ({count / seen.ticks:.2%}) left to the plain law: {what}")


if __name__ == "__main__":
    sys.exit(main())
