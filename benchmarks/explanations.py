"""How often `coopqp explain` is right: blocked runs, unreachable goals, tasks that contradict.

    python benchmarks/explanations.py [--seed 0] [--blocked 100] [--far 100] [--pairs 50]

prints what docs/explain.md says, in about twenty minutes. Everything is seeded. What is true
is known by construction, or found by code that shares nothing with the explanation:

* blocked: a goal that a walk along the loops reaches when the limits are left out, and the QP law
  does not; soft, hard and scaled tasks, a wall or an acceleration limit at times. Cured where a run
  with a robot and a wall that are wider by exactly what is said reaches the goal.
* far: a goal beyond the sum of the links from both ends, or off the manifold by scipy's
  least_squares from many random starts.
* pairs: two tasks that ask one point or axis to be in two places.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from explained_cases import ROBOTS, Case, blocked, far, pairs, scipy_distance

from coopqp.assessment import assess
from coopqp.execution.controller_run import run
from coopqp.limits import Workspace
from coopqp.robot import Robot, RobotModel
from coopqp.scenario.scenario import Scenario
from coopqp.study.explanation import RunExplanation, explain_run


@dataclass(frozen=True)
class Outcome:
    """An explanation, and how long it took [s]."""

    robot: str
    found: RunExplanation
    seconds: float
    scenario: Scenario


def explained(case: Case) -> Outcome:
    """Run and explain."""
    trace = run(case.scenario, controller="qp")
    before = time.perf_counter()
    found = explain_run(case.scenario, trace)
    return Outcome(case.robot, found, time.perf_counter() - before, case.scenario)


@dataclass(frozen=True)
class Wider(Robot):
    """A robot that is there already, with other position limits."""

    model: RobotModel

    def build(self) -> RobotModel:
        return self.model


def cured(outcome: Outcome) -> bool:
    """Whether the goal is reached when exactly what is said is given, by code of its own."""
    scenario, limits = outcome.scenario, list(outcome.scenario.limits)
    robot = scenario.robot_model
    model = robot.model.copy()
    for need in outcome.found.needed:
        if need.limit.startswith("limit.position["):
            joint, side = need.limit.removeprefix("limit.position[").split("].")
            i = model.idx_qs[model.getJointId(joint)]
            if side == "upper":
                model.upperPositionLimit[i] += need.amount
            else:
                model.lowerPositionLimit[i] -= need.amount
        else:
            own = limits.pop()
            assert isinstance(own, Workspace)
            n = np.array(own.normal) / np.linalg.norm(own.normal)
            x, y, z = (np.array(own.through) - need.amount * n).tolist()
            limits.append(replace(own, through=(x, y, z)))
    wider = Wider(replace(robot, model=model))
    duration = outcome.found.time or scenario.duration
    other = replace(scenario, robot=wider, limits=tuple(limits), duration=duration)
    trace = run(other, controller="qp")
    return bool(assess(trace).errors[0] <= scenario.tasks[0].tolerance)


# Tables


def count_blocked(count: int, seed: int) -> None:
    """Blocked runs: what is said of them and how many of those called curable are cured."""
    done: list[Outcome] = []
    for case in blocked(seed):
        outcome = explained(case)
        if outcome.found.kind != "reached":
            done.append(outcome)
        if len(done) == count:
            break
    kinds = tally(o.found.kind for o in done)
    limits = [o for o in done if o.found.kind == "limits"]
    tried = [o for o in limits if o.found.tried]
    print(f"blocked runs: {len(done)} {kinds}")
    print(f"  called curable: {len(tried)} of {len(limits)} blamed on limits")
    print(f"  cured by exactly what is said: {sum(map(cured, tried))} of {len(tried)}")
    print(f"  not cured, said so: {[o.found.sentence for o in limits if not o.found.tried]}")
    others = [o for o in done if o.found.kind not in ("limits", "elsewhere")]
    for o in others:
        print(f"  {o.robot} {o.found.kind}: {o.found.sentence}")
    times(done)


def count_far(count: int, seed: int) -> None:
    """Unreachable goals: how many are blamed on what."""
    done = []
    for case in far(seed):
        done.append(explained(case))
        if len(done) == count:
            break
    print(f"unreachable goals: {len(done)} {tally(o.found.kind for o in done)}")
    rng, off, ended = np.random.default_rng(seed), [], []
    for o in done:
        if o.found.kind != "reach":
            print(f"  {o.robot} {o.found.kind}: {o.found.sentence}")
            continue
        assert o.found.distance is not None
        goal = np.array(o.scenario.tasks[0].goal)  # type: ignore[attr-defined]
        chain = o.scenario.chain
        off.append(o.found.distance - scipy_distance(chain, goal, rng, 6))
        nearest = scipy_distance(chain, goal, rng, 12, inside=True)
        ended.append(o.found.missed[0].error - nearest)
    gaps = 1e3 * np.array(off)
    print(
        f"  distance less scipy's nearest of 6 [mm]: median {np.median(gaps):.2f}, "
        f"within 1 mm {int((np.abs(gaps) < 1).sum())}, nearer {int((gaps < -1).sum())}, "
        f"farther {int((gaps > 1).sum())} (another configuration)"
    )
    ends = 1e3 * np.array(ended)
    print(
        f"  the law ended within 1 mm of the nearest place inside the limits (scipy, 12 starts) in "
        f"{int((ends < 1).sum())} of {len(ends)}, within 10 mm in {int((ends < 10).sum())}"
    )
    times(done)


def count_pairs(count: int, seed: int) -> None:
    """Pairs of contradicting tasks: how many are named."""
    done, named = [], 0
    for (case, names), _ in zip(pairs(seed), range(count), strict=False):
        outcome = explained(case)
        done.append(outcome)
        right = set(outcome.found.tasks) == names and outcome.found.kind == "contradiction"
        named += right
        if not right:
            print(f"  {case.robot} {sorted(names)}: {outcome.found.kind}: {outcome.found.sentence}")
    print(f"pairs of contradicting tasks: {count}, named {named}")
    times(done)


def tally(kinds: Iterator[str]) -> dict[str, int]:
    """How many of each."""
    counts: dict[str, int] = {}
    for kind in kinds:
        counts[kind] = counts.get(kind, 0) + 1
    return dict(sorted(counts.items()))


def times(done: list[Outcome]) -> None:
    """Median and worst time of an explanation by robot."""
    for robot in ROBOTS:
        some = [o.seconds for o in done if o.robot == robot]
        if some:
            print(
                f"  {robot}: {len(some)} explained in {np.median(some):.2f} s, most {max(some):.2f}"
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    for key, default in {"seed": 0, "blocked": 100, "far": 100, "pairs": 50}.items():
        parser.add_argument(f"--{key}", type=int, default=default)
    asked = parser.parse_args()
    if asked.blocked:
        count_blocked(asked.blocked, asked.seed)
    if asked.far:
        count_far(asked.far, asked.seed)
    if asked.pairs:
        count_pairs(asked.pairs, asked.seed)
