"""Jumps of the command at the border of reach: ``python -m tests.qp_law.continuity --seeds 20``.

On every robot a point goes slowly round a circle of which one half is out of reach, as a soft, a
hard and a scaled task (tests/crossing.py). Told is what is left of the largest change of the
command between two neighbouring states after halving their distance 24 times. Exit code 1 where
that is more than 1e-4 rad/s.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import get_args

import click

sys.path.insert(0, str(Path(__file__).parents[1]))  # what tests share

from crossing import LEFT, Mode, jump, problem
from out_of_reach import chain_of, robots

from coopqp.controllers import QPController
from coopqp.study.stress import arrangements


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.qp_law.continuity", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="circles on each robot")
    parser.add_argument("--engine", default="auto", choices=["auto", "python", "kernel"])
    asked, jumps = parser.parse_args(), 0
    for mode in get_args(Mode):
        for robot in robots():
            own = robot not in arrangements.names()
            chain = chain_of(robot, "its own" if own else arrangements.grasps_of(robot)[0])
            found = {
                seed: jump(QPController(engine=asked.engine).build(problem(chain, mode, seed)))
                for seed in range(asked.seeds)
            }
            jumping = [seed for seed, one in found.items() if one.left > LEFT]
            worst = max(found, key=lambda seed: found[seed].left)
            one = found[worst]
            click.echo(
                f"{mode:6} {robot:12} {len(jumping)} of {asked.seeds} circles jump; worst: "
                f"{one.left:.1e} rad/s left of {one.step:.1e} (seed {worst}, tick {one.tick}, "
                f"{one.relaxed:.0%} of its ticks not OPTIMAL; {' | '.join(one.said)})"
            )
            jumps += len(jumping)
    return 1 if jumps else 0


if __name__ == "__main__":
    sys.exit(main())
