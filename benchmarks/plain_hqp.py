"""Where a plain hierarchical QP ends on goals that no configuration inside the limits holds.

    python benchmarks/plain_hqp.py [--goals 13]

Written apart from coopqp's levels: in every tick quadprog solves min |J v - w|^2 + 1e-6 |v|^2 for
the tasks, then for the secondary objectives with J v of the tasks kept; loops hard, joint positions
and speeds bounded, no verification, no growing damping. Goals are those of docs/statistics.md, the
first of each robot that inverse kinematics cannot hold. docs/statistics.md has the result.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import quadprog

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from random_goals.draw import arenas, draw
from random_goals.reach import holds_inside
from random_goals.trial import AFTER, OTHERS

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.model.state import State
from coopqp.task import TaskStack

DAMPING = 1e-6
SHARES = (1.0, 0.5, 0.1, 0.0)  # of the Baumgarte term, until the bounds leave a motion
LONGER = 8  # times the run where the two do not end alike
ALIKE = 1e-3  # difference of |e| [m, rad]
OPEN = 1e-4  # loop error that counts [m]


def plain(problem: ControlProblem, ticks: int) -> State:
    """Where the plain hierarchy ends."""
    start, state = State(problem.chain), State(problem.chain)
    start.update()
    groups = [list(group) for group in (problem.tasks, problem.secondary) if group]
    levels = [TaskStack(group, start) for group in groups]
    for _ in range(ticks):
        state.update()
        for level in levels:
            level.update(state)
        state.advance(_velocity(problem, state, levels), problem.dt)
    return state


def _velocity(problem: ControlProblem, state: State, levels: list[TaskStack]) -> Array:
    chain, dt = problem.chain, problem.dt
    lb = np.clip((chain.lower - state.q) / dt, -chain.velocity, 0.0)
    ub = np.clip((chain.upper - state.q) / dt, 0.0, chain.velocity)
    U, s, Vt = np.linalg.svd(state.J_loop)
    rank = int((s > 1e-8 * s[0]).sum())
    closing = (U.T @ (-problem.kappa * state.e_loop))[:rank] / s[:rank]
    for share in SHARES:
        C, c, v = Vt[:rank], share * closing, np.zeros(chain.n)
        try:
            for level in levels:
                roots = np.sqrt(level.weights)
                M, m = roots[:, None] * level.J, roots * level.wanted
                P = M.T @ M + DAMPING * np.eye(chain.n)
                A = np.vstack([C, np.eye(chain.n), -np.eye(chain.n)])
                v = quadprog.solve_qp(P, M.T @ m, A.T, np.concatenate([c, lb, -ub]), len(C))[0]
                _, s, N = np.linalg.svd(level.J - (level.J @ C.T) @ C, full_matrices=False)
                new = N[s > 1e-6]
                C, c = np.vstack([C, new]), np.concatenate([c, new @ v])
        except ValueError:  # of quadprog: the constraints are inconsistent
            if not v.any():
                continue
        return np.clip(v, lb, ub)
    return np.zeros(chain.n)


def ours(problem: ControlProblem, ticks: int) -> State:
    """Where the controller `qp` ends."""
    law = QPController().build(problem)
    state = law.start()
    for _ in range(ticks):
        law.step(state)
    return state


def errors(problem: ControlProblem, state: State) -> tuple[float, float]:
    """|e| of the tasks [m, rad], and the loop error [m]."""
    tasks = TaskStack(list(problem.tasks), State(problem.chain))
    state.update()
    tasks.update(state)
    return float(np.linalg.norm(tasks.e)), state.loop_position_error


def unreachable(robot: str) -> Iterator[tuple[int, ControlProblem]]:
    """Goals that inverse kinematics cannot hold inside the limits, with their seeds."""
    for seed in itertools.count():
        drawn = draw(robot, seed, OTHERS)
        if not holds_inside(drawn.problem, (drawn.problem.chain.q_start, *drawn.elsewhere)):
            yield seed, drawn.problem


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--goals", type=int, default=13, help="on each robot")
    asked = parser.parse_args()
    both = (plain, ours)
    alike, later, number, wide = 0, 0, 0, [0, 0]
    for robot in arenas():
        for seed, problem in itertools.islice(unreachable(robot), asked.goals):
            ticks = round((max(task.end for task in problem.tasks) + AFTER) / problem.dt)
            (a, loop_a), (b, loop_b) = (errors(problem, act(problem, ticks)) for act in both)
            number, wide = number + 1, [wide[0] + (loop_a > OPEN), wide[1] + (loop_b > OPEN)]
            print(
                f"{robot} {seed}: |e| {a:.5f} plain, {b:.5f} qp; loops {loop_a:.1e}, {loop_b:.1e} m"
            )
            if abs(a - b) < ALIKE:
                alike += 1
                continue
            (a, _), (b, _) = (errors(problem, act(problem, LONGER * ticks)) for act in both)
            later += abs(a - b) < ALIKE
            print(f"  after {LONGER} times as long {a:.5f} and {b:.5f}")
    print(
        f"{alike} of {number} within {1e3 * ALIKE:g} mm, {later} more after {LONGER} times as long"
    )
    print(f"loops open by more than {1e3 * OPEN:g} mm at the end: {wide[0]} plain, {wide[1]} qp")


if __name__ == "__main__":
    main()
