"""Every variant of the kernel gives the same bits: ``python -m tests.kernel.bits --problems 300``.

Whole motions of the shipped scenarios, and some ticks of random problems, are driven by all of them
that run on this processor. Exit code 1 where velocities, joints, what the law remembers, or who
decided a tick are not equal to the last bit; it then says by how much they differ.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import click

sys.path.insert(0, str(Path(__file__).parents[1]))  # what tests share

from scenario_files import LOADABLE
from stress.draw import draw
from variants import apart, variants
from watched_bodies import driven, watched

from coopqp.controller import ControlProblem
from coopqp.controllers.qp import QPController
from coopqp.kernel.flat import why_not
from coopqp.scenario.loader import load


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.kernel.bits", description=__doc__)
    parser.add_argument("--problems", type=int, default=300, help="random ones")
    parser.add_argument("--ticks", type=int, default=100, help="of each")
    parser.add_argument("--seed", type=int, default=0, help="of the first; others count up")
    asked = parser.parse_args()
    if len(variants()) < 2:
        raise SystemExit("there are no two variants here")
    differ, ticks, decided = 0, 0, 0
    for name, problem, count in _motions(asked.problems, asked.ticks, asked.seed):
        off, by_kernel = apart(problem, count)
        ticks, decided = ticks + count, decided + by_kernel
        if off:
            differ += 1
            click.echo(f"{name}: apart by {off:.1e}")
    click.echo(f"{ticks} ticks, {decided} of them the kernel's; {differ} motions differ")
    return 1 if differ else 0


def _motions(problems: int, ticks: int, first: int) -> Iterator[tuple[str, ControlProblem, int]]:
    for name in LOADABLE:
        scenario = load(name)
        if any(isinstance(c, QPController) for c in scenario.controllers.values()):
            yield name, scenario.problem(), scenario.schedule[0].ticks(scenario.dt)
    for name in watched():
        yield f"{name} with bodies apart", driven(name, 0), 200
    for seed in range(first, first + problems):
        problem = draw(seed).problem
        if not why_not(problem):
            yield f"seed {seed}", problem, ticks


if __name__ == "__main__":
    sys.exit(main())
