"""The kernel against the plain law: ``python -m tests.kernel.agreement --problems 1000``.

The plain law drives along whole motions of the shipped scenarios, towards random goals with bodies
that are kept apart, and for some ticks of random problems; the kernel is asked at the same states.
Where the two differ by more than 1e-10 rad/s an oracle in extended precision says which is off
(tests/oracle.py), and by how much the optimum itself moves where the numbers that it is made of
move by their last digit. Exit code 1 where the kernel is off by more than that. What was left to
the plain law is counted, with reasons.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from itertools import count as counted
from itertools import islice
from pathlib import Path

import click

sys.path.insert(0, str(Path(__file__).parents[1]))  # what tests share

from judged import Seen, compare
from scenario_files import LOADABLE
from stress.draw import draw
from watched_bodies import driven, watched

from coopqp.controllers.qp import QPController
from coopqp.kernel.flat import why_not
from coopqp.scenario.loader import load

#: Of each scenario with self-collision and things nearby: random goals, and ticks on the way.
GOALS, TICKS = 3, 200


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.kernel.agreement", description=__doc__)
    parser.add_argument("--problems", type=int, default=1000, help="random ones")
    parser.add_argument("--ticks", type=int, default=40, help="of each")
    parser.add_argument("--seed", type=int, default=0, help="of the first; others count up")
    parser.add_argument("--outside", action="store_true", help="only such as start outside")
    parser.add_argument("--scenarios", action="store_true", help="shipped ones alone")
    asked, everything = parser.parse_args(), Seen()
    for name in LOADABLE:
        scenario = load(name)
        if any(isinstance(c, QPController) for c in scenario.controllers.values()):
            problem = scenario.problem()
            seen = compare(name, problem, scenario.schedule[0].ticks(scenario.dt))
            tell(name, seen)
            everything.add(seen)
    for name in watched():
        for seed in range(GOALS):
            seen = compare(f"{name} with bodies apart, goal {seed}", driven(name, seed), TICKS)
            tell(f"{name} with bodies apart, goal {seed}", seen)
            everything.add(seen)
    random = Seen()
    seeds: Iterator[int] = counted(asked.seed)
    if asked.outside:
        seeds = (seed for seed in seeds if draw(seed).start == "outside")
    for seed in islice(seeds, 0 if asked.scenarios else asked.problems):
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
