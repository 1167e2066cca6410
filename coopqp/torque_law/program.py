"""The QPs of the torque law: one for each level of priority, all with the same constraints.

    x = [a; tau of the motors; h of the hands that hold; sigma where some press]

Later levels minimise their own tasks with J a (and C h) of earlier soft tasks as decided there.
sigma is how far the cones of hands that press are violated [N]: zero, unless they are infeasible,
and then minimal.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from coopqp.base.qp import QP, Row, Rows
from coopqp.base.rank import independent_rows, least_squares
from coopqp.base.spec import Array
from coopqp.closed_loop.dynamics import ClosedLoopDynamics, Saddle
from coopqp.closed_loop.grasp_matrix import UNITS
from coopqp.closed_loop.hands import WrenchStack
from coopqp.controller import ControlProblem
from coopqp.model.closed_chain import AXES
from coopqp.model.state import State
from coopqp.qp_law.bounds import Bounds
from coopqp.solver import Solution, Status, Verifier
from coopqp.torque_law.hand_wrenches import HandWrenches
from coopqp.torque_law.task_dynamics import TaskDynamics

Indices = NDArray[np.intp]

#: Cost of squared wrenches, so that those that nothing else decides are the least [1/N2].
WRENCH_COST = 1e-5
#: Cost of leaving a cone, per newton and squared: far above what any task gains by it.
LEAVING = (1e4, 1.0)
#: Weight of a hard task, over its own, where it has to become soft.
SOFTENED = 100.0
#: Rows of a task that are independent of all before them by less than this are decided already.
DECIDED = 1e-9


@dataclass(frozen=True)
class Costs:
    """Weights of what no task asks for, :class:`coopqp.controllers.torque_qp.TorqueQp`."""

    damping: float
    damping_time: float
    effort: float
    grip: float


class Layout:
    """Where the variables and rows of a torque QP are, and what fills them at all levels."""

    def __init__(
        self,
        level: TaskDynamics,
        hands: HandWrenches,
        wrenches: WrenchStack,
        bounds: Bounds,
        costs: Costs,
    ) -> None:
        self.level, self.hands, self.wrenches, self.costs = level, hands, wrenches, costs
        chain, dynamics = level.dynamics.chain, level.dynamics
        self.n, self.k, self.m = chain.n, len(dynamics.actuated), len(dynamics.drift)
        ends = np.cumsum([0, self.n, self.k, hands.size, int(hands.pressing)]).tolist()
        self.a, self.tau = slice(ends[0], ends[1]), slice(ends[1], ends[2])
        self.h, self.sigma = slice(ends[2], ends[3]), slice(ends[3], ends[4])
        joints = list(zip(chain.joint_names, chain.joint_units, strict=True))
        motors, force = [joints[i] for i in dynamics.actuated], {"rad": "N m", "m": "N"}
        self.variables = (
            *(Row(name=f"a[{x}]", kind="joint", unit=f"{u}/s2", joint=x) for x, u in joints),
            *(Row(name=f"tau[{x}]", kind="motor", unit=force[u], joint=x) for x, u in motors),
            *hands.variables,
            *([Row(name="sigma", kind="hand", unit="N")] if hands.pressing else []),
        )
        self.inequalities = (*bounds.rows, *hands.cone_rows)
        self.cones = slice(len(bounds.rows), len(self.inequalities))
        axes, row = zip(AXES, UNITS, strict=True), partial(Row, kind="dynamics")
        self.equalities = (
            *(row(name=f"dynamics[{x}]", unit=force[u], joint=x) for x, u in joints),
            *(row(name=f"object.{axis}", unit=unit) for axis, unit in axes),
            *chain.loops.kept_rows[: self.m],
        )
        self.common = len(self.equalities)


class Program:
    """One level, with the last tick's ``qp`` and its ``solution``.

    Args:
        problem, layout: shared by all levels.
        own: which motion rows and which wrench rows are its own.
        must: which must hold: hard ones, and the soft ones of the levels before.
    """

    def __init__(
        self,
        problem: ControlProblem,
        layout: Layout,
        own: tuple[Indices, Indices],
        must: tuple[Indices, Indices],
    ) -> None:
        self._layout, self._own, self._must = layout, own, must
        level, hands, wrenches, costs = layout.level, layout.hands, layout.wrenches, layout.costs
        exact = [level.tasks.rows[i] for i in must[0]] + [wrenches.rows[i] for i in must[1]]
        self.qp = QP(Rows(layout.variables, layout.inequalities, (*layout.equalities, *exact)))
        self.solution = Solution(self.qp)
        n, k = layout.n, layout.k
        dynamics = level.dynamics
        self._diagonal = np.repeat([costs.damping, costs.effort, WRENCH_COST], [n, k, hands.size])
        effort = dynamics.chain.model.effortLimit[dynamics.actuated]
        self.qp.lb[layout.tau], self.qp.ub[layout.tau] = -effort, effort
        self.qp.A[dynamics.actuated, n + np.arange(k)] = -1.0
        if hands.pressing:
            self.qp.G[layout.cones, layout.sigma] = -1.0
        self.keep_cones(keep=True)
        curvature = float(self._diagonal.min())
        self._verifier = Verifier(self.qp, self.solution, problem.budget, curvature)
        self._solve = problem.solver.open(self.qp, self.solution)

    def solve(self) -> Status:
        self._solve()
        self.solution.status = self._verifier.check()
        return self.solution.status

    def keep_cones(self, *, keep: bool) -> None:
        """Whether hands that press must stay in their cones, or only as well as they can."""
        sigma = self._layout.sigma
        self.qp.lb[sigma] = 0.0
        self.qp.ub[sigma] = 0.0 if keep else np.inf

    def assemble(
        self,
        state: State,
        wanted: Array,
        bounds: tuple[Array, Array, Array, Array],
        loops: Array,
        before: Array | None = None,
        *,
        soften: bool = False,
        wrench: Array | None = None,
    ) -> None:
        """Fill the QP.

        Args:
            state: of this tick.
            wanted: J a that each motion row asks for, shape (k,).
            bounds: lb, ub, G, h of the limits on a.
            loops: right side of the loop rows, shape (m,).
            before: the solution of the levels before; None for the first.
            soften: whether hard rows only count with a weight.
            wrench: of the surroundings on the object, shape (6,); None where unknown.
        """
        self._fill_cost(state, wanted, soften)
        self._fill_dynamics(loops, wrench)
        self._fill_bounds(bounds)
        self._fill_exact(wanted, before, soften)
        self.qp.seal()

    def _fill_cost(self, state: State, wanted: Array, soften: bool) -> None:
        qp, layout, costs = self.qp, self._layout, self._layout.costs
        tasks, hands, wrenches = layout.level.tasks, layout.hands, layout.wrenches
        qp.P[:], qp.q[:] = 0.0, 0.0
        P, q = self._of_level(0, tasks.J, tasks.weights, wanted, soften)
        qp.P[layout.a, layout.a], qp.q[layout.a] = P, q
        if hands.hands:
            grip, pull = hands.cost(wrenches)
            P, q = self._of_level(1, wrenches.J, wrenches.weights, wrenches.wanted, soften)
            qp.P[layout.h, layout.h], qp.q[layout.h] = costs.grip * grip + P, costs.grip * pull + q
        qp.P[: len(self._diagonal), : len(self._diagonal)] += np.diag(self._diagonal)
        qp.q[layout.a] += costs.damping / costs.damping_time * state.v
        if hands.pressing:
            qp.q[layout.sigma], qp.P[layout.sigma, layout.sigma] = LEAVING

    def _of_level(
        self, of: int, rows: Array, weights: Array, wanted: Array, soften: bool
    ) -> tuple[Array, Array]:
        """P and q of the level's own motion rows (0) or wrench rows (1), and of softened ones."""
        own, must = self._own[of], self._must[of]
        at = np.concatenate([own, must]) if soften else own
        J, w = rows[at], weights[at]
        w[len(own) :] *= SOFTENED
        weighted = J * w[:, None]
        return weighted.T @ J, -wanted[at] @ weighted

    def _fill_dynamics(self, loops: Array, wrench: Array | None) -> None:
        qp, layout = self.qp, self._layout
        dynamics, hands = layout.level.dynamics, layout.hands
        n = layout.n
        tree, body, closed = slice(0, n), slice(n, n + 6), slice(n + 6, layout.common)
        J_0, (M, b) = dynamics.J_object, dynamics.object_inertia()
        qp.A[tree, layout.a], qp.A[tree, layout.h] = dynamics.A, hands.to_tau
        qp.b[tree] = -dynamics.H
        qp.b[body] = 0.0  # of an object that stands, whatever the arms do
        if hands.hands:
            qp.A[body, layout.a], qp.A[body, layout.h] = M @ J_0, -hands.G
            qp.b[body] = -(M @ dynamics.drift_arms[:6] + b)
        if wrench is not None and hands.hands:
            qp.b[tree] += J_0.T @ wrench
            qp.b[body] += wrench
        qp.A[closed, layout.a], qp.b[closed] = dynamics.J, loops

    def _fill_bounds(self, bounds: tuple[Array, Array, Array, Array]) -> None:
        qp, layout, hands = self.qp, self._layout, self._layout.hands
        lb, ub, G, h = bounds
        qp.lb[layout.a], qp.ub[layout.a] = lb, ub
        qp.G[: len(h), layout.a], qp.h[: len(h)] = G, h
        if hands.pressing:
            qp.G[layout.cones, layout.h], qp.h[layout.cones] = hands.cones, hands.upper

    def _fill_exact(self, wanted: Array, before: Array | None, soften: bool) -> None:
        """Hard rows, and what was decided before, as far as they are independent."""
        qp, layout, (motion, forces) = self.qp, self._layout, self._must
        level, wrenches, first = layout.level, layout.wrenches, layout.common
        rows, right = qp.A[first:], qp.b[first:]
        rows[:], right[:] = 0.0, 0.0
        if not len(right):
            return
        hard = np.concatenate([level.tasks.hard[motion], wrenches.hard[forces]])
        if soften and not (~hard).any():
            return
        rows[: len(motion), layout.a] = level.tasks.J[motion]
        rows[len(motion) :, layout.h] = wrenches.J[forces]
        right[: len(motion)] = wanted[motion]
        right[len(motion) :] = wrenches.wanted[forces]
        if before is not None:
            right[~hard] = rows[~hard] @ before
        if soften:
            rows[hard], right[hard] = 0.0, 0.0
        if before is not None:
            # What follows from rows above is decided; solvers mind a row that says it again.
            Q = np.linalg.qr(qp.A[:first].T)[0]
            left = rows - (rows @ Q) @ Q.T
            left[np.linalg.norm(left, axis=1) < DECIDED * np.abs(rows).max()] = 0.0
            again = np.setdiff1d(np.arange(len(rows)), independent_rows(left))
            rows[again], right[again] = 0.0, 0.0


def programs(problem: ControlProblem, layout: Layout) -> Sequence[Program]:
    """The program of each level of priority, first to last; at least one."""
    both = [(of.hard, of.priorities) for of in (layout.level.tasks, layout.wrenches)]
    levels = sorted({rank for mine, ranks in both for rank in ranks[~mine].tolist()})

    def program(number: int) -> Program:
        motion, forces = (np.flatnonzero(~mine & (ranks == number)) for mine, ranks in both)
        must = tuple(np.flatnonzero(mine | (ranks < number)) for mine, ranks in both)
        return Program(problem, layout, (motion, forces), (must[0], must[1]))

    return [program(number) for number in levels or [0]]


#: Changes that cones keep: that of a tick, and as much again, because no two ticks are the same.
AHEAD = 2.0


class HeldTorques:
    """Cones at a tick's end: torques are held over a tick, and wrenches change as the arms move on.

    By the tick's end gravity and inertia are those of the next pose, and h has become h + d: little
    compared with the arms' weight, but possibly much for a light object. Cones hold for both, with
    twice the change:

        C h <= upper,   C (h + 2 d) <= upper

    d is observed on the last answer: in the dynamics of this instant, with the torques of the tick
    before, the least change of its accelerations and wrenches. A steady motion repeats it.

    Memory: the "answer", with wrenches in contact axes, zero for none, and "back", the acceleration
    by which it closes open loops.
    """

    def __init__(self, hands: HandWrenches, layout: Layout, dynamics: ClosedLoopDynamics) -> None:
        self._hands, self._layout, self._dynamics = hands, layout, dynamics
        self._loops = slice(layout.common - layout.m, layout.common)
        square = layout.common == layout.n + hands.size
        self._saddle = Saddle(layout.n, hands.size) if square else None
        sizes = {"answer": layout.h.stop, "back": layout.m}
        self.memory_sizes: dict[str, int] = sizes if hands.pressing else {}

    def foresee(self, state: State, qp: QP) -> None:
        """Tighten ``hands.upper`` and the QP's cones, whose dynamics are those of this instant."""
        hands, layout = self._hands, self._layout
        if not hands.pressing:
            return
        answer = state.memory["answer"].copy()
        hands.upper[:] = hands.stated
        if answer.any():
            answer[layout.h] = _turned(answer[layout.h], hands.turned.transpose(0, 2, 1))
            A, b = qp.A[: layout.common, : layout.h.stop], qp.b[: layout.common].copy()
            # What is seen of the loops since then is no part of what the arms' motion does.
            b[self._loops] = -self._dynamics.drift - state.memory["back"]
            change = self._smallest_change(A, b - A @ answer)
            hands.upper -= AHEAD * hands.in_cone * np.maximum(hands.cones @ change, 0.0)
        qp.h[layout.cones] = hands.upper

    def _smallest_change(self, A: Array, right: Array) -> Array:
        """The wrenches of the smallest change with that effect; normally it is unique."""
        layout, n, saddle = self._layout, self._layout.n, self._saddle
        if saddle is None:
            return least_squares(np.hstack([A[:, layout.a], A[:, layout.h]]), right)[n:]
        saddle.top[:], saddle.right[:] = A[:n, layout.a], A[:n, layout.h]
        saddle.left[:], saddle.corner[:] = A[n:, layout.a], A[n:, layout.h]
        return np.asarray(saddle.solve(right)[0][n:])

    def remember(self, state: State, qp: QP, x: Array | None) -> None:
        """Keep an answer for the next tick; None where other torques are commanded."""
        if not self._hands.pressing:
            return
        answer, h = state.memory["answer"], self._layout.h
        answer[:] = 0.0 if x is None else x[: h.stop]
        answer[h] = _turned(answer[h], self._hands.turned)
        state.memory["back"][:] = -self._dynamics.drift - qp.b[self._loops]


def _turned(h: Array, R: Array) -> Array:
    """Wrenches of hands in other axes, shape (6 N,)."""
    return np.asarray(h.reshape(-1, 2, 3) @ R.transpose(0, 2, 1)).ravel()
