"""Why a tick could not do what its tasks asked, by name, with an open solver (HiGHS).

A tick is kept as its QP with the names of all rows. The explanation is the smallest relaxation, in
the sum of what each limit would have to give, with which loops and tasks can all hold:

    minimise    sum r
    subject to  J_c v = b,   J_task v = wanted,   lb - r <= v <= ub + r,   G v <= h + r,   r >= 0
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ConfigDict, TypeAdapter, with_config
from scipy.optimize import linprog

from coopqp.checked import Array
from coopqp.controller import ControlProblem
from coopqp.controllers.qp import QPLaw
from coopqp.errors import CoopqpError
from coopqp.hierarchy import Bounds
from coopqp.qp import QP, RowNames
from coopqp.solver import Budget, Solution, Solver, Status, Verifier
from coopqp.state import State
from coopqp.task import TaskStack

#: A relaxation below this is nothing [rad/s, m/s].
NOTHING = 1e-7

#: A task row is missed by more than this [rad/s, m/s]. Damping alone holds ordinary ticks back by
#: half of it; by more where the task error is large or the pose nearly singular.
MISSED = 1e-4

#: Task rows that the loops leave less than this share of are impossible, not merely blocked.
IMPOSSIBLE = 1e-7


@with_config(ConfigDict(extra="forbid", strict=True))
@dataclass(frozen=True)
class TickRecord:
    """One tick of a QP controller, whole: it can be saved, explained and solved again.

    Attributes:
        scenario, controller, tick: where it is from.
        t, q, v, memory: the state that the tick began with.
        dt: control period [s].
        damping: least curvature of the cost.
        budget: what an answer may be off by.
        P, q_cost, C, lower, upper: the first level's QP, :class:`coopqp.qp.QP`.
        inequalities: number of rows of G in C.
        variables, inequality_names, equality_names: names.
        lb_names, ub_names: the limit that each bound on v comes from.
        J, wanted, task_names: rows of the first level's tasks.
        answer, status: what the controller made of it, all levels included.
        first_answer: what its solver made of this QP.
    """

    scenario: str
    controller: str
    tick: int
    t: float
    q: list[float]
    v: list[float]
    memory: list[float]
    dt: float
    damping: float
    budget: Budget
    P: list[list[float]]
    q_cost: list[float]
    C: list[list[float]]
    lower: list[float]
    upper: list[float]
    inequalities: int
    variables: list[str]
    inequality_names: list[str]
    equality_names: list[str]
    lb_names: list[str]
    ub_names: list[str]
    J: list[list[float]]
    wanted: list[float]
    task_names: list[str]
    answer: list[float]
    first_answer: list[float]
    status: str

    def text(self) -> str:
        """As JSON; infinite bounds as 1e30."""
        return json.dumps(asdict(self), indent=1) + "\n"

    def save(self, path: Path) -> None:
        """Write :meth:`text`."""
        path.write_text(self.text(), encoding="utf-8")

    @staticmethod
    def read(path: Path) -> TickRecord:
        """Read what :meth:`save` wrote.

        Raises:
            CoopqpError: no such file, or not a saved tick.
        """
        try:
            text = path.read_text(encoding="utf-8")
            record = _RECORD.validate_json(text)
            if not record.fits():
                raise ValueError("shapes")
            return record
        except OSError as error:
            raise CoopqpError(f"{path}: cannot be read: {error.strerror}") from None
        except (ValueError, TypeError):
            raise CoopqpError(f"{path}: is not a tick saved by 'coopqp explain --save'") from None

    def fits(self) -> bool:
        """Whether all shapes belong together."""
        n, p, m = len(self.variables), len(self.inequality_names), len(self.equality_names)
        k = len(self.task_names)
        shapes = (
            (self.P, (n, n)), (self.q_cost, (n,)), (self.lower, (n + p + m,)),
            (self.upper, (n + p + m,)), (self.lb_names, (n,)), (self.ub_names, (n,)),
            (self.wanted, (k,)), (self.answer, (n,)), (self.first_answer, (n,)),
        )  # fmt: skip
        tables = ((self.C, p + m), (self.J, k))
        return (
            all(np.shape(values) == shape for values, shape in shapes)
            and all(np.shape(rows) == (count, n) for rows, count in tables if count)
            and self.inequalities == p
        )

    def qp(self) -> QP:
        """The program, in arrays."""
        qp = QP(
            RowNames(
                tuple(self.variables), tuple(self.inequality_names), tuple(self.equality_names)
            )
        )
        qp.P[:], qp.q[:] = self.P, self.q_cost
        if self.C:
            qp.C[:] = self.C
        qp.lower[:], qp.upper[:] = _infinite(self.lower), _infinite(self.upper)
        return qp


_RECORD = TypeAdapter(TickRecord)


@dataclass(frozen=True)
class Relaxation:
    """What one limit would have to give.

    Attributes:
        name: of the limit's row.
        amount: for this tick; ``unit`` says of what.
        unit: of amount: position limits in rad or m, the others per second.
    """

    name: str
    amount: float
    unit: str


@dataclass(frozen=True)
class Explanation:
    """Why a tick could not do what its tasks asked.

    Attributes:
        missed: task rows that the answer misses.
        impossible: those that the loops alone rule out, whatever the limits.
        relaxations: the smallest that would let all others hold; empty when nothing is missed.
        sentence: the same in words.
    """

    missed: tuple[str, ...]
    impossible: tuple[str, ...]
    relaxations: tuple[Relaxation, ...]
    sentence: str


@dataclass(frozen=True)
class Replay:
    """A saved tick solved again.

    Attributes:
        status: as verified.
        v: the answer.
        primal_residual, dual_residual: of the answer.
        difference: largest distance to the answer that was saved [rad/s].
    """

    status: Status
    v: Array
    primal_residual: float
    dual_residual: float
    difference: float


def record_tick(
    law: QPLaw, state: State, *, scenario: str, controller: str, tick: int
) -> TickRecord:
    """Keep the tick that a law would do at a state.

    Args:
        law: the controller, built for the scenario.
        state: updated; its memory is the law's.
        scenario: its name, for the record.
        controller: likewise.
        tick: likewise.
    """
    memory = state.memory.tolist()
    command = law.tick(state)
    first_answer = law.solution.v.tolist()
    law.assemble(state)
    qp, problem = law.first.qp, law.problem
    lb_names, ub_names = bound_names(problem, state)
    shares = qp.n - problem.chain.n
    tasks = TaskStack(problem.tasks, State(problem.chain))
    tasks.update(state)
    return TickRecord(
        scenario=scenario,
        controller=controller,
        tick=tick,
        t=state.t,
        q=state.q.tolist(),
        v=state.v.tolist(),
        memory=memory,
        dt=problem.dt,
        damping=law.damping,
        budget=problem.budget,
        P=qp.P.tolist(),
        q_cost=qp.q.tolist(),
        C=qp.C.tolist(),
        lower=_finite(qp.lower),
        upper=_finite(qp.upper),
        inequalities=qp.p,
        variables=list(qp.names.variables),
        inequality_names=[f"limit.{name}" for name in qp.names.inequalities],
        equality_names=list(qp.names.equalities),
        lb_names=lb_names + ["scale.lower"] * shares,
        ub_names=ub_names + ["scale.upper"] * shares,
        J=np.pad(tasks.J, ((0, 0), (0, shares))).tolist(),
        wanted=tasks.wanted.tolist(),
        task_names=list(tasks.names),
        answer=command.v.tolist() + [command.scale] * shares,
        first_answer=first_answer,
        status=command.status.name,
    )


def bound_names(problem: ControlProblem, state: State) -> tuple[list[str], list[str]]:
    """The limit that each lower and upper bound on v comes from."""
    n, joints = problem.chain.n, problem.chain.joint_names
    lb, ub = np.full(n, -np.inf), np.full(n, np.inf)
    below = [f"no limit[{joint}].lower" for joint in joints]
    above = [f"no limit[{joint}].upper" for joint in joints]
    for limit in problem.limits:
        alone = Bounds(_with_limit(problem, limit), state)
        alone.update(state)
        word = _word(limit)
        for i, joint in enumerate(joints):
            if alone.lb[i] > lb[i]:
                lb[i], below[i] = alone.lb[i], f"limit.{word}[{joint}].lower"
            if alone.ub[i] < ub[i]:
                ub[i], above[i] = alone.ub[i], f"limit.{word}[{joint}].upper"
    return below, above


def explain(record: TickRecord) -> Explanation:
    """The smallest relaxation of the limits that would let loops and tasks hold."""
    qp, J = record.qp(), np.array(record.J).reshape(-1, len(record.variables))
    wanted, names = np.array(record.wanted), record.task_names
    gap = np.abs(J @ np.array(record.answer) - wanted)
    missed = tuple(name for name, g in zip(names, gap, strict=True) if g > MISSED)
    if not missed:
        return Explanation((), (), (), "nothing was in the way: every task row was met")
    possible = _possible_rows(_loops(record, qp), J)
    impossible = tuple(name for i, name in enumerate(names) if i not in possible)
    answer = _relax(record, qp, J[possible], wanted[possible])
    relaxations = _named(record, answer) if answer is not None else ()
    return Explanation(
        missed, impossible, relaxations, _sentence(missed, impossible, relaxations, answer)
    )


def replay(record: TickRecord, solver: Solver) -> Replay:
    """Solve a saved tick with any solver."""
    qp = record.qp()
    solution = Solution(qp)
    solver.open(qp, solution)()
    status = Verifier(qp, solution, record.budget, record.damping).check()
    return Replay(
        status,
        solution.v.copy(),
        float(solution.primal_residual),
        float(solution.dual_residual),
        float(np.abs(solution.v - np.array(record.first_answer)).max()),
    )


def _loops(record: TickRecord, qp: QP) -> tuple[Array, Array]:
    """The loop rows alone; hard and scaled tasks are tasks here."""
    kept = [i for i, name in enumerate(record.equality_names) if name.startswith("loop")]
    return qp.A[kept], qp.b[kept]


def _possible_rows(loops: tuple[Array, Array], J: Array) -> list[int]:
    """Task rows that loops leave open, and that no earlier row decides already."""
    rows, kept = list(loops[0]), []
    for i, row in enumerate(J):
        basis = np.linalg.qr(np.array(rows).T)[0] if rows else np.zeros((len(row), 0))
        left = row - basis @ (basis.T @ row)
        if np.linalg.norm(left) > IMPOSSIBLE * max(float(np.linalg.norm(row)), 1e-12):
            rows.append(row)
            kept.append(i)
    return kept


def _relax(record: TickRecord, qp: QP, J: Array, wanted: Array) -> Array | None:
    """R of [lb; ub; h], or None when no relaxation helps."""
    n, p = qp.n, qp.p
    A, b = _loops(record, qp)
    equal = np.vstack([A, J])
    zeros = np.zeros((len(equal), 2 * n + p))
    eye, none = np.eye(n), np.zeros((n, n))
    rows = [
        np.hstack([-eye, -eye, none, np.zeros((n, p))]),
        np.hstack([eye, none, -eye, np.zeros((n, p))]),
        np.hstack([qp.G, np.zeros((p, 2 * n)), -np.eye(p)]),
    ]
    bounded = np.concatenate([-qp.lb, qp.ub, qp.h])
    kept = np.isfinite(bounded)
    result = linprog(
        np.concatenate([np.zeros(n), np.ones(2 * n + p)]),
        A_ub=np.vstack(rows)[kept],
        b_ub=bounded[kept],
        A_eq=np.hstack([equal, zeros]),
        b_eq=np.concatenate([b, wanted]),
        bounds=[(None, None)] * n + [(0.0, None)] * (2 * n + p),
    )
    return np.asarray(result.x[n:], float) if result.success else None


def _named(record: TickRecord, r: Array) -> tuple[Relaxation, ...]:
    names = [*record.lb_names, *record.ub_names, *record.inequality_names]
    found = []
    for name, amount in zip(names, r, strict=True):
        if amount > NOTHING:
            position = name.startswith("limit.position")
            step = record.dt if position else 1.0
            found.append(Relaxation(name, float(amount) * step, _unit(name)))
    return tuple(sorted(found, key=lambda relaxation: -relaxation.amount))


def _unit(name: str) -> str:
    if name.startswith("limit.position"):
        return "rad"
    of_joints = ("limit.velocity", "limit.acceleration")
    return "rad/s" if name.startswith(of_joints) or ".rot_" in name else "m/s"


def _sentence(
    missed: Sequence[str],
    impossible: Sequence[str],
    relaxations: Sequence[Relaxation],
    answer: Array | None,
) -> str:
    along = _listed([name for name in missed if name not in impossible])
    said = []
    if impossible:
        said.append(f"the loops alone leave no motion along {_listed(impossible)}")
    if along and relaxations:
        blocks = _listed([relaxation.name for relaxation in relaxations])
        more = _listed([f"{r.amount:.3g} {r.unit} more" for r in relaxations])
        said.append(f"the loop and {blocks} leave no motion along {along}; {more} would do")
    elif along and answer is None:
        said.append(f"no relaxation of the limits makes {along} possible")
    elif along:
        said.append(f"{along} could be met; damping, weights or a later level gave it up")
    return "; ".join(said)


def _listed(names: Sequence[str]) -> str:
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"


def _word(limit: object) -> str:
    """``position`` for JointPosition, ``object_speed`` for ObjectSpeed."""
    name = type(limit).__module__.rsplit(".", 1)[-1]
    return name.removeprefix("joint_")


def _with_limit(problem: ControlProblem, limit: Any) -> ControlProblem:
    return replace(problem, limits=(limit,))


def _finite(values: Array) -> list[float]:
    clipped: list[float] = np.clip(values, -1e30, 1e30).tolist()
    return clipped


def _infinite(values: Sequence[float]) -> Array:
    array = np.array(values, float)
    array[np.abs(array) >= 1e30] *= np.inf
    return array
