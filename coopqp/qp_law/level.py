"""The QPs of a tick: all of v, or a step from where the levels before have come to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coopqp.base.qp import QP, Row, Rows, joint_rows
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.model.state import State
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.equations import SCALE_WEIGHT, Damping
from coopqp.solver import Solution, Status, Verifier
from coopqp.task import TaskStack

#: Limits of whose rows directions see a smaller share than this give way, farther and farther,
DECIDED = 1e-7
#: and of a smaller one than this ask for nothing.
UNSEEN = 3e-8


@dataclass(frozen=True)
class Given:
    """What levels share; whoever owns the limits updates them."""

    problem: ControlProblem
    bounds: Bounds
    damping: Damping


class Program:
    """A QP, its solver and verification; ``curvature`` is the damping, P's least eigenvalue."""

    def __init__(self, problem: ControlProblem, rows: Rows, damping: float) -> None:
        self.qp = QP(rows)
        self.solution, self.curvature = Solution(self.qp), damping
        self._verifier = Verifier(self.qp, self.solution, problem.budget, damping)
        self._solve = problem.solver.open(self.qp, self.solution)

    def solve(self) -> Status:
        """Solve, verify and polish."""
        self.qp.seal()
        self._solve()
        self._verifier.curvature = min(self.curvature, SCALE_WEIGHT)
        self.solution.status = status = self._verifier.polish(self._verifier.check())
        return status


class Level(Program):
    """A program over v, then over shares s of what may be done in part only, the largest possible.

        minimise    sum_i w_i |J_i v - wanted_i|^2 + d |v|^2 + W |1 - s|^2
        subject to  J_c v = -kappa e,   more rows,   lb <= v <= ub,   G v <= h,   0 <= s <= 1

    The owner of the stack of soft ``tasks`` updates it. ``more`` rows come after the loops, eq.
    (14); ``shares`` names what has a share. With ``slows`` the Baumgarte correction has the only
    one, J_c v = -s kappa e.
    """

    def __init__(
        self, given: Given, tasks: TaskStack, more: Sequence[Row] = (),
        shares: Sequence[str] = (), *, slows: bool = False,
    ) -> None:  # fmt: skip
        chain, n, base = given.problem.chain, given.problem.chain.n, given.damping.base
        shares = ["Baumgarte stabilisation"] if slows else shares
        scales = (Row(name=f"scale[{name}]", kind="share", owner=name, unit="1") for name in shares)
        variables = (*joint_rows(chain.joint_names, chain.joint_units), *scales)
        rows = Rows(variables, given.bounds.rows, (*chain.loops.solver_rows, *more))
        super().__init__(given.problem, rows, base)
        self.tasks, self._bounds, self._base, self._slows = tasks, given.bounds, base, slows
        self.v, self.shares, self._eye = self.solution.v[:n], self.solution.v[n:], np.eye(n)
        self.qp.lb[n:], self.qp.ub[n:] = 0.0, 1.0
        np.fill_diagonal(self.qp.P[n:, n:], SCALE_WEIGHT)
        self.qp.q[n:] = -SCALE_WEIGHT

    def assemble(self, state: State, kappa: float, damping: float = 0.0) -> None:
        """Write objective, limits and loops; kappa in 1/s, damping is added to the base."""
        qp, n, m, J = self.qp, len(self.v), len(state.e_loop), self.tasks.J
        self.curvature = self._base + damping
        JW = J.T * self.tasks.weights
        qp.P[:n, :n] = JW.dot(J) + self.curvature * self._eye
        qp.q[:n] = -JW.dot(self.tasks.wanted)
        qp.lb[:n], qp.ub[:n] = self._bounds.lb, self._bounds.ub
        qp.G[:, :n], qp.h[:] = self._bounds.G, self._bounds.h
        qp.A[:m, :n], qp.b[:m] = state.J_loop, -kappa * state.e_loop
        if self._slows:
            qp.A[:m, n], qp.b[:m] = kappa * state.e_loop, 0.0


class Step:
    """The best step from a motion v that is inside the limits, in given directions Z.

        minimise    sum_i w_i |J_i (v + Z z) - wanted_i|^2 + d |v + Z z|^2 + sum_k held_k z_k^2
        subject to  lb - v <= Z z <= ub - v,   G Z z <= h - G v

    z = 0 is feasible. A limit of whose row Z sees next to nothing was decided with v and gives way.

    It ends at v (n,), with the gradient ``slope`` of tasks and active limits, without damping;
    ``curvature`` is d in the last tick.
    """

    def __init__(self, given: Given, tasks: TaskStack) -> None:
        self._given, self._programs = given, dict[int, Program]()
        self.tasks, self.curvature = tasks, given.damping.base
        self.v, self.slope = np.zeros((2, given.problem.chain.n))

    def step(self, v: Array, Z: Array, d: float, held: Array | float = 0.0) -> Status:
        """Find it; keep v where that fails. The rows of Z are orthonormal."""
        self.v[:], self.slope[:], self.curvature = v, 0.0, d
        if not len(Z):
            return Status.OPTIMAL
        tasks, bounds, program = self.tasks, self._given.bounds, self._program(len(Z))
        qp, solution, C, program.curvature = program.qp, program.solution, bounds.C, d
        JW, Z_T = tasks.J.T * tasks.weights, Z.T
        np.dot(Z.dot(JW), tasks.J.dot(Z_T), out=qp.P)
        qp.P.ravel()[:: len(Z) + 1] += d + held
        qp.q[:] = Z.dot(JW.dot(tasks.J.dot(v) - tasks.wanted) + d * v)
        rows, of_rows = C.dot(Z_T), np.linalg.norm(C, axis=1)
        sizes = np.linalg.norm(rows, axis=1)
        unseen = sizes <= UNSEEN * of_rows
        rows[unseen], sizes[unseen] = 0.0, 1.0  # which ask for nothing
        # Rows have length one, or solvers would take short ones for none.
        np.divide(rows, sizes[:, None], out=qp.G)
        slack = np.concatenate([bounds.ub, bounds.h, -bounds.lb]) - C.dot(v)
        way = DECIDED * of_rows * np.maximum(DECIDED * of_rows - sizes, 0.0)
        way /= np.maximum(sizes - UNSEEN * of_rows, 1e-300)
        np.divide(np.maximum(slack, 0.0) + way, sizes, out=qp.h)
        status = program.solve()
        if not status.usable:
            return Status.INACCURATE
        np.minimum(np.maximum(v + Z_T.dot(solution.v), bounds.lb), bounds.ub, out=self.v)
        self.slope[:] = JW.dot(tasks.J.dot(self.v) - tasks.wanted) + (solution.z / sizes).dot(C)
        return status

    def _program(self, size: int) -> Program:
        """For so many directions; at singular poses there are more."""
        if size not in self._programs:
            sides = len(self._given.bounds.C)
            free = tuple(Row(name=f"free[{i}]", kind="free") for i in range(size))
            limits = tuple(Row(name=f"limit[{i}]", kind="limit") for i in range(sides))
            self._programs[size] = Program(self._given.problem, Rows(free, limits), self.curvature)
        return self._programs[size]
