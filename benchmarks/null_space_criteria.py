"""Which criterion in the null space keeps NAO's joints inside their limits, and at which gain.

    python benchmarks/null_space_criteria.py [--goals 80] [--seed 8]

Goals of point_on_point up to 10 cm from the start, in any direction, at which the plain
pseudoinverse leaves a position limit, but does not run away. docs/statistics.md has the table.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import coopqp
from coopqp.scenario.scenario import Scenario
from coopqp.task import Task
from coopqp.tasks import JointCentering, JointLimitBarrier

FARTHEST = 0.1  # distance of a goal [m]
RUNS_AWAY = 1.0  # a violation beyond this is no question of limits [rad]
ROUNDING = 1e-6  # a violation that counts as none [rad]
WORTH = 1e-3  # a difference of violations that counts [rad]

NULL_SPACE = "pseudoinverse_null_space"
LAWS: dict[str, tuple[str, tuple[Task, ...]]] = {
    "pseudoinverse": ("pseudoinverse", ()),
    **{
        f"joint_centering, gain {gain:g}": (NULL_SPACE, (JointCentering(gain=gain),))
        for gain in (0.5, 5.0, 50.0)
    },
    **{
        f"joint_limit_barrier, gain {gain:g}": (NULL_SPACE, (JointLimitBarrier(gain=gain),))
        for gain in (0.5, 2.0, 5.0, 20.0)
    },
    "weighted_least_norm": ("weighted_least_norm", ()),
    "saturation_null_space": ("saturation_null_space", ()),
}


def violation(scenario: Scenario, law: str) -> float:
    """Of the worst position limit [rad]; negative inside."""
    controller, secondary = LAWS[law]
    with np.errstate(all="ignore"):  # laws that run away leave the range of numbers
        trace = coopqp.run(replace(scenario, secondary=secondary), controller=controller)
    return float(np.maximum(trace.lower - trace.q, trace.q - trace.upper).max())


def goals(scenario: Scenario, seed: int) -> Iterator[Scenario]:
    """The scenario with one goal after the other at which the pseudoinverse leaves a limit."""
    rng, start = np.random.default_rng(seed), scenario.chain.start_position
    while True:
        way = rng.normal(size=3)
        way *= rng.uniform(0.1, 1.0) * FARTHEST / np.linalg.norm(way)
        task = replace(scenario.tasks[0], goal=tuple((start + way).tolist()))
        aimed = replace(scenario, tasks=(task,))
        if ROUNDING < violation(aimed, "pseudoinverse") < RUNS_AWAY:
            yield aimed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--goals", type=int, default=80)
    parser.add_argument("--seed", type=int, default=8)
    asked = parser.parse_args()
    drawn = goals(coopqp.load("point_on_point"), asked.seed)
    chosen = itertools.islice(drawn, asked.goals)
    worst = np.array([[violation(aimed, law) for law in LAWS] for aimed in chosen])
    print(f"{'law':30s} {'inside':>6s} {'median':>7s} {'better':>6s} {'worse':>6s}")
    for law, found in zip(LAWS, worst.T, strict=True):
        change = found - worst[:, 0]
        print(
            f"{law:30s} {np.sum(found <= ROUNDING):6d} {np.median(found):7.3f} "
            f"{np.sum(change < -WORTH):6d} {np.sum(change > WORTH):6d}"
        )


if __name__ == "__main__":
    main()
