"""Strict priorities: a sequence of QPs, each in the null space of those before.

Level 0 decides v_0. What its tasks and the loops see of it is fixed for the levels after:

    v = v_0 + Z z,   Z an orthonormal basis of the null space of the rows decided so far,

so that level 1 chooses z, a :class:`coopqp.qp_law.level.Step`, and so on. Z comes from singular
value decompositions, which tolerate redundant rows: of the loops, then of what the tasks add to
them. At a singular pose that has directions which are noise, and would freeze another motion in
each tick. Such a direction is released gradually, at the cost MOST_DAMPING s^6 / (1 - s^6) with
s = sigma / NOISE; a threshold alone would let stretched arms oscillate between this level and those
before it. The power is high because rows may lack MET, along the direction MET / sigma.

For a unit of joint motion the rows turn by L / sigma, fast near a singularity. Multipliers y on
them call for short steps: y L / sigma adds to the level's damping, like second derivatives of tasks
(:class:`coopqp.qp_law.equations.Damping`), up to MOST_DAMPING; beyond it the step is shortened.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from coopqp.base.rank import directions, matrix_rank
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.limit import states_along
from coopqp.model.state import State
from coopqp.qp_law.equations import MOST_DAMPING, held_pull
from coopqp.qp_law.level import Given, Step
from coopqp.solver import Status
from coopqp.task import Task, TaskStack

SAMPLES = 6  # configurations at which ranks are taken, beside the start
#: Singular values of task rows up to the first ask for nothing, from there to the second in part
#: [m/rad, 1]; what these cost is MOST_DAMPING over WALL at most.
IDLE, NOISE, WALL = 1e-8, 1e-6, 1e-5


class Order:
    """Which tasks of a problem decide when: exact ones, then soft ones level by level.

    All references set out from the state ``start``. ``groups`` are soft tasks by priority, then
    secondary objectives by theirs, as long as anything is left to decide; the first is empty where
    there are hard or scaled tasks.
    """

    def __init__(self, problem: ControlProblem) -> None:
        self.start = State(problem.chain)
        soft, self.hard, self.scaled = (
            [task for task in problem.tasks if task.mode == mode]
            for mode in ("soft", "hard", "scaled")
        )
        self.groups = [] if soft and len(soft) == len(problem.tasks) else [list[Task]()]
        for tasks in (soft, problem.secondary):
            for priority in sorted({task.priority for task in tasks}):
                if self.groups and self._nothing_left():
                    return
                self.groups.append([task for task in tasks if task.priority == priority])

    def _nothing_left(self) -> bool:
        """Whether the loops and the tasks so far decide all joints, generically."""
        tasks = [*self.hard, *self.scaled, *itertools.chain(*self.groups)]
        if any(task.joint_space and task.all_joints for task in tasks):
            return True
        chain = self.start.chain
        if len(chain.loops.solver_rows) + sum(len(task.rows(chain)) for task in tasks) < chain.n:
            return False
        stack = TaskStack(tasks, self.start)
        anywhere = states_along(chain, chain.sample(np.random.default_rng(0), SAMPLES))
        for state in itertools.chain([self.start], anywhere):
            stack.update(state)
            if matrix_rank(np.vstack([state.J_loop, stack.J])) == chain.n:
                return True
        return False


class LaterLevel(Step):
    """A step in the null space of the tasks ``before``; ``share`` of it is made."""

    def __init__(self, given: Given, tasks: TaskStack, before: Sequence[TaskStack]) -> None:
        super().__init__(given, tasks)
        self._before, self.share = before, 1.0
        self._bound = max(float(stack.curvature_bounds.max(initial=0.0)) for stack in before)

    def improve(self, state: State, loops: Array, v: Array, pull: Array) -> tuple[Array, Status]:
        """Improve v in the null space, at an up-to-date state.

        ``loops`` are orthonormal rows along the loops; ``pull`` (1,) is sum |y| L / sigma, updated.
        """
        damping = self._given.damping
        needed, own = damping.of(pull[0], state), damping.of_tasks(self.tasks, state)
        d = damping.base + own + min(needed, MOST_DAMPING)
        self.share = MOST_DAMPING / max(needed, MOST_DAMPING)
        decided = np.concatenate([stack.J for stack in self._before])
        if not np.isfinite(decided).all():
            return v, Status.INACCURATE
        sizes, ways = directions(decided.dot(loops.T))
        rank, ways = int(np.count_nonzero(sizes > NOISE)), ways.dot(loops)
        free, part = ways[rank:], (np.maximum(sizes[rank:] - IDLE, 0.0) / (NOISE - IDLE)) ** 6
        held = MOST_DAMPING * part / np.maximum(1.0 - part, WALL)
        found = self.step(v, free, d, held)
        made = self.v - v
        y = np.concatenate([ways[:rank].dot(self.slope), held * free.dot(made)])
        pull[0] = held_pull(float(np.abs(y).dot(self._bound / np.maximum(sizes, IDLE))), pull[0])
        return v + self.share * made, found
