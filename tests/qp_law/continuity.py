"""Jumps of the command at the border of reach: ``python -m tests.qp_law.continuity --seeds 20``.

On every robot a point goes slowly round a circle of which one half is unreachable, as a soft, a
hard and a scaled task (tests/crossing.py), alone and before other levels. Told is what is left of
the largest change of the command v between two neighbouring states after halving their distance 52
times, and of the largest change that the task sees, J v. Exit code 1 where one of them is more
than 1e-4 rad/s or m/s for a task alone, or the second for a hard one beside others.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

import click

sys.path.insert(0, str(Path(__file__).parents[1]))  # what tests share

from crossing import LEFT, Jump, Mode, jump, problem
from stress import arrangements
from unreachable_goals import chain_of, robots

from coopqp.controllers import QPController


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.qp_law.continuity", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="circles on each robot")
    parser.add_argument("--engine", default="auto", choices=["auto", "python", "kernel"])
    asked, faults = parser.parse_args(), 0
    for alone in (True, False):
        for mode in get_args(Mode):
            for robot in robots():
                found = driven(robot, mode, asked.engine, asked.seeds, alone=alone)
                tell(f"{mode:6} {'alone' if alone else 'beside':6} {robot:12}", found)
                if alone:
                    faults += sum(max(one.left, one.seen) > LEFT for one in found)
                elif mode == "hard":
                    faults += sum(one.seen > LEFT for one in found)
    return 1 if faults else 0


def driven(robot: str, mode: Mode, engine: str, seeds: int, *, alone: bool) -> list[Jump]:
    """The jumps of a robot's circles."""
    own = robot not in arrangements.names()
    chain = chain_of(robot, "its own" if own else arrangements.grasps_of(robot)[0])
    controller = QPController(engine=engine)  # type: ignore[arg-type]
    problems = (problem(chain, mode, seed, alone=alone) for seed in range(seeds))
    return [jump(controller.build(one)) for one in problems]


def tell(which: str, found: Sequence[Jump]) -> None:
    """How many circles jump, and the worst of them."""
    jumping = sum(max(one.left, one.seen) > LEFT for one in found)
    seen = max(one.seen for one in found)
    worst = max(range(len(found)), key=lambda seed: found[seed].left)
    one = found[worst]
    click.echo(
        f"{which} {jumping} of {len(found)} circles jump; worst: {one.left:.1e} rad/s left of "
        f"{one.step:.1e} (seed {worst}, tick {one.tick}, {one.relaxed:.0%} of its ticks not "
        f"OPTIMAL; {' | '.join(one.said)}); the task sees {seen:.1e}"
    )


if __name__ == "__main__":
    sys.exit(main())
