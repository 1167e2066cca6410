"""Strict priorities: a sequence of QPs, each within what the ones before leave free.

Level 0 decides v_0. What its tasks and the loops see of it is fixed for the levels after:

    Q v = Q v_0,   Q an orthonormal basis of the rows decided so far,

so that level 1 moves in their null space alone, and so on. Q comes from a singular value
decomposition, which minds no redundant rows.

The rows turn with the arms, by L / sigma for a unit of joint motion where they come from singular
values sigma: fast near a stretched pose. A level that pulls at them, with multipliers y, must
therefore not step far: y L / sigma is part of what its damping is made of, like the second
derivative of its own tasks (:func:`coopqp.qp_law.equations.step_damping`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.controller import ControlProblem
from coopqp.program import Programs, sees_twist
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.exact_tasks import ExactTasks
from coopqp.qp_law.level import Level
from coopqp.rank import RANK_TOLERANCE, matrix_rank
from coopqp.row import Row
from coopqp.solver import Status
from coopqp.state import State
from coopqp.task import Task, TaskStack

TWIST = 6  # numbers of the object's twist
SAMPLES = 6  # configurations at which ranks are taken, beside the start
NOISE = 1e-6  # singular values of task rows up to this ask for nothing [m/rad, 1]


def groups(problem: ControlProblem) -> list[list[Task]]:
    """Soft tasks by priority, then the secondary objectives by theirs; the first may be empty."""
    soft = [task for task in problem.tasks if task.mode == "soft"]
    first = min((task.priority for task in soft), default=0)
    main = [
        [k for k in soft if k.priority == p] for p in sorted({first, *(k.priority for k in soft)})
    ]
    later = [
        [k for k in problem.secondary if k.priority == p]
        for p in sorted({k.priority for k in problem.secondary})
    ]
    # What a scaled task can do comes before all soft ones, whatever their weights.
    first_alone: list[list[Task]] = (
        [[]] if any(task.mode == "scaled" for task in problem.tasks) else []
    )
    return [*first_alone, *main, *later]


def deciding(problem: ControlProblem, programs: Programs) -> list[list[Task]]:
    """The :func:`groups` that have anything left to decide: none after all joints are decided.

    Ranks are taken only where the number of rows does not tell.

    Args:
        problem: whose tasks.
        programs: of tasks, from the state from which their references set out.
    """
    found = list[list[Task]]()
    exact = [task for task in problem.tasks if task.mode != "soft"]
    for group in groups(problem):
        before = [*exact, *(task for earlier in found for task in earlier)]
        if found and _all_decided(programs, before):
            break
        found.append(group)
    return found


def _all_decided(programs: Programs, tasks: Sequence[Task]) -> bool:
    """Whether the loops and these tasks leave no joint free."""
    chain = programs.start.chain
    if any(task.joint_space and task.all_joints for task in tasks):
        return True
    if len(chain.loops.solver_rows) + sum(len(task.rows(chain)) for task in tasks) < chain.n:
        return False
    most = most_rank(tasks, programs)
    if most < chain.n:
        return False
    return _general_rank(State(chain), [TaskStack(tasks, programs.start)], most) == chain.n


def most_rank(tasks: Sequence[Task], programs: Programs) -> int:
    """A rank that the rows of the loops and of these tasks cannot exceed.

    Rows that see nothing but the object's twist are together of rank six at most.

    Args:
        tasks: any.
        programs: of tasks.
    """
    chain, twist, others = programs.start.chain, 0, 0
    for task in tasks:
        if sees_twist(programs.of(task)):
            twist += len(task.rows(chain))
        else:
            others += len(task.rows(chain))
    return min(chain.n, len(chain.loops.solver_rows) + min(twist, TWIST) + others)


class LaterLevel:
    """A level after the first.

    Args:
        problem: what to control.
        before: the soft tasks of all levels before it, level by level.
        exact: the hard and scaled tasks.
        tasks: the soft tasks of this level.
        bounds: the limits.
        damping: cost of |v|^2.

    Attributes:
        level: its QP.
        pull: sum of |y| L / sigma over the decided rows in the last tick, of the cost without its
            damping.
    """

    def __init__(
        self,
        problem: ControlProblem,
        before: Sequence[TaskStack],
        exact: ExactTasks,
        tasks: TaskStack,
        bounds: Bounds,
        damping: float,
    ) -> None:
        stacks = (*before, exact.hard, exact.scaled)
        self._decided = Decided(problem.chain, stacks)
        rows = tuple(Row(name=f"decided[{i}]", kind="decided") for i in range(self._decided.rank))
        self.level = Level(problem, tasks, rows, bounds, damping)
        self.pull = 0.0

    def improve(
        self, state: State, bounds: Bounds, v: Array, status: Status, extra_damping: float
    ) -> tuple[Status, Array]:
        """Improve v where it is still free; keep it when this level fails."""
        level, Q = self.level, self._decided.basis(state)
        level.assemble(bounds, extra_damping)
        level.A[:] = Q
        Q.dot(v, level.b)
        own = level.solve()
        if not own.usable:
            self.pull = 0.0
            return Status.INACCURATE, v
        # Damping pulls at the rows too; left in, it would feed itself.
        y = level.solution.y + level.curvature * level.b
        self.pull = float(np.abs(y).dot(self._decided.turns))
        return (status if own is Status.OPTIMAL else own), level.v


class Decided:
    """The rows that the loops and the levels so far have decided, as an orthonormal basis.

    Args:
        chain: whose loops.
        stacks: the tasks that have been decided.

    Attributes:
        rank: how many of the rows are independent in general, so that a singular start leaves
            nothing undecided.
        turns: how fast each row of the basis turns, L / sigma with L the largest second derivative
            of the tasks; 0 for the loops' rows, shape (rank,).
    """

    def __init__(self, chain: ClosedChain, stacks: Sequence[TaskStack]) -> None:
        self._blocks = [np.zeros((0, chain.n)), *(stack.J for stack in stacks)]
        tasks = [task for stack in stacks for task in stack.tasks]
        state = State(chain)
        self.rank = _general_rank(state, stacks, most_rank(tasks, Programs(state)))
        self._Q, self.turns = np.zeros((self.rank, chain.n)), np.zeros(self.rank)
        self._lever = max((float(stack.levers.max(initial=0.0)) for stack in stacks), default=0.0)

    def basis(self, state: State) -> Array:
        """Q at a state for which the stacks are up to date, shape (rank, n).

        First the loops, which no later level may ever open; then what the tasks add to them. Where
        that is next to nothing, as at a singular pose, its direction is noise, which would freeze
        another motion in each tick: such rows are zero.
        """
        Q, tasks = self._Q, np.vstack(self._blocks)
        if not (np.isfinite(tasks).all() and np.isfinite(state.J_loop).all()):
            Q[:] = np.nan
            return Q
        Q[:], self.turns[:] = 0.0, 0.0
        loops, _ = _directions(state.J_loop, RANK_TOLERANCE)
        m = len(loops)
        Q[:m] = loops
        added, sizes = _directions(tasks - tasks.dot(loops.T).dot(loops), NOISE)
        end = min(m + len(added), self.rank)
        Q[m:end], self.turns[m:end] = added[: end - m], self._lever / sizes[: end - m]
        return Q


def _general_rank(state: State, stacks: Sequence[TaskStack], most: int) -> int:
    """How many rows of the loops and of tasks are independent in general, which is most at most.

    The state is written.
    """
    rank = 0
    for q in _places(state.chain):
        state.q[:] = q
        state.update()
        for stack in stacks:
            stack.update(state)
        rank = max(rank, matrix_rank(np.vstack([state.J_loop, *(stack.J for stack in stacks)])))
        if rank >= most:
            break
    return min(rank, state.chain.n)


def _places(chain: ClosedChain) -> Iterator[Array]:
    """The start, and some configurations anywhere for those who need more."""
    yield chain.q_start
    yield from chain.sample(np.random.default_rng(0), SAMPLES)


def _directions(rows: Array, least: float) -> tuple[Array, Array]:
    """Orthonormal basis of the rows with singular values above ``least``, and these values."""
    if not len(rows):
        return rows, np.zeros(0)
    _, values, Vt = np.linalg.svd(rows, full_matrices=False)
    kept = values > least
    return Vt[kept], values[kept]
