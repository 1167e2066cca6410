"""Jumps of the command at the border of reach: ``python -m tests.qp_law.continuity --seeds 20``.

On every robot a point goes slowly round a circle of which one half is unreachable, as a soft, a
hard and a scaled task (tests/crossing.py), alone and before other levels. Told is what is left of
the largest change of the command v between two neighbouring states after halving their distance 52
times, and of the largest change that the task sees, J v.

The optimum of a strict hierarchy jumps by itself where limits begin to depend on the rows decided
before, and that of one scaled task may be as steep. Such a jump is the optimum's own where an
independent cascade in extended precision (tests/lexicographic.py) is with the command on both
sides, and moves as well, by half as far at least, within a small part of the tick's step. Nearer
to it than 1e-8 of the step the last digits of a double decide which of its values a command takes,
so that all of the optimum's values within it count.

Exit code 1 where a task alone, or a hard one beside others, sees a jump of more than 1e-4 rad/s or
m/s, or where one is not the optimum's own.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import get_args
from unittest.mock import patch

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # what tests share

import lexicographic
import oracle
from crossing import DT, LEFT, Asked, Jump, Left, Mode, jump, problem
from stress import arrangements
from unreachable_goals import chain_of, robots

from coopqp.base.spec import Array
from coopqp.controller import Law
from coopqp.controllers import QPController
from coopqp.qp_law.equations import Damping
from coopqp.qp_law.priorities import Order
from coopqp.solver import Status

DAMPING, ERROR_DAMPING = 1e-6, 0.5
SAME = 1e-6  # as near to the optimum as that a command is it [rad/s, m/s]
BESIDE = 10.0 ** np.arange(-11.0, -2.0, 0.5)  # how far from a jump that is seen to, of the step
LAST_DIGITS = 1e-8  # of the step: what a state's last digits may decide
#: What the cascade takes for dependent rows, as near to none as 64 bits of mantissa allow.
SHARP = {
    lexicographic: {"RELEASED": 0.0, "NOISE": 1e-12, "CLEAR": 1e-9, "FAILS": 2e-9, "PROBE": 1e-18},
    oracle: {"DOUBTFUL": 1e-11, "ACTIVE": 1e-13, "DEPENDENT": 1e-15},
}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.qp_law.continuity", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="circles on each robot")
    parser.add_argument("--engine", default="auto", choices=["auto", "python", "kernel"])
    asked, faults, own = parser.parse_args(), 0, list[float]()
    for alone in (True, False):
        for mode in get_args(Mode):
            for robot in robots():
                laws = built(robot, mode, asked.engine, asked.seeds, alone=alone)
                found = [jump(law) for law in laws]
                tell(f"{mode:6} {'alone' if alone else 'beside':6} {robot:12}", found)
                firm = alone or mode == "hard"
                faults += sum(firm and one.seen > LEFT for one in found)
                for seed, (law, one) in enumerate(zip(laws, found, strict=True)):
                    for left in one.jumps:
                        moves = optimum_moves(law, left)
                        tell_of(seed, left, moves)
                        own += [left.size] * (moves >= 0.5 * left.size)
                        faults += moves < 0.5 * left.size
    click.echo(f"{len(own)} jumps are the optimum's own, up to {max(own, default=0.0):.1e} rad/s")
    click.echo(f"{faults} are not")
    return 1 if faults else 0


def built(robot: str, mode: Mode, engine: str, seeds: int, *, alone: bool) -> list[Law]:
    """The laws of a robot's circles."""
    own = robot not in arrangements.names()
    chain = chain_of(robot, "its own" if own else arrangements.grasps_of(robot)[0])
    controller = QPController(engine=engine)  # type: ignore[arg-type]
    problems = (problem(chain, mode, seed, alone=alone) for seed in range(seeds))
    return [controller.build(one) for one in problems]


def optimum_moves(law: Law, left: Left) -> float:
    """How far the optimum moves across a jump; 0 where the command is not the optimum beside it.

    Args:
        law: whose command jumps.
        left: the jump.
    """
    found = list[Array](), list[Array]()
    for side, way, beside in zip(left.sides, (-left.step, left.step), found, strict=True):
        for far in BESIDE:
            if beside and far > LAST_DIGITS:
                break
            _, v, best = compared(law, side + far * way)
            if best is not None and np.abs(v - best).max() <= SAME:
                beside.append(best)
    return float(np.ptp([*found[0], *found[1]], axis=0).max()) if all(found) else 0.0


def compared(law: Law, packed: Array) -> tuple[Status, Array, Array | None]:
    """What a law says and commands at a state, and the optimum there; None if undetermined."""
    asked = Asked(law)
    groups = [task for group in Order(law.problem).groups for task in group]
    kept = tuple(task for task in law.problem.secondary if task in groups)
    decided, damping = replace(law.problem, secondary=kept), Damping(DAMPING, ERROR_DAMPING, DT)
    with ExitStack() as stack:
        stack.enter_context(np.errstate(invalid="ignore"))  # beside the first tick dampings are < 0
        for module, digits in SHARP.items():
            stack.enter_context(patch.multiple(module, **digits))
        try:
            best = lexicographic.Cascade(decided, asked.state(packed), damping).optimum().v
        except oracle.UndeterminedError:
            best = None
    v = asked.at(packed)
    return law.command.status, v, best


def tell_of(seed: int, left: Left, moves: float) -> None:
    """Whose a jump is."""
    whose = "the optimum's own" if moves >= 0.5 * left.size else "NOT the optimum's"
    click.echo(
        f"    seed {seed}: {left.size:.1e} rad/s at t = {left.sides[0][0]:.4f} s, {whose}, which "
        f"moves by {moves:.1e} beside it ({' | '.join(left.said)})"
    )


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
