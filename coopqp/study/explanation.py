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
from coopqp.errors import CoopqpError
from coopqp.limit import bound_rows
from coopqp.qp import QP, Rows
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.law import QPLaw
from coopqp.row import Row, Side, names_of
from coopqp.solver import Budget, Solution, Solver, Status, Verifier, written
from coopqp.state import State
from coopqp.task import TaskStack

#: A relaxation below this is nothing [rad/s, m/s].
NOTHING = 1e-7

#: A task row is missed by more than this [rad/s, m/s], and by more than a share of what is wanted:
#: the damping holds ordinary ticks back by some percent of it.
MISSED, MISSED_SHARE = 1e-4, 0.02

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
        variables, inequality_rows, equality_rows: what they are.
        lb_rows, ub_rows: the limit that each bound on v comes from.
        J, wanted, task_rows: rows of all tasks.
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
    variables: list[Row]
    inequality_rows: list[Row]
    equality_rows: list[Row]
    lb_rows: list[Row]
    ub_rows: list[Row]
    J: list[list[float]]
    wanted: list[float]
    task_rows: list[Row]
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
        n, p, m = len(self.variables), len(self.inequality_rows), len(self.equality_rows)
        k = len(self.task_rows)
        shapes = (
            (self.P, (n, n)), (self.q_cost, (n,)), (self.lower, (n + p + m,)),
            (self.upper, (n + p + m,)),
            (self.wanted, (k,)), (self.answer, (n,)), (self.first_answer, (n,)),
        )  # fmt: skip
        tables = ((self.C, p + m), (self.J, k))
        return (
            all(np.shape(values) == shape for values, shape in shapes)
            and all(np.shape(rows) == (count, n) for rows, count in tables if count)
            and self.inequalities == p
            and len(self.lb_rows) == len(self.ub_rows) == n
        )

    def qp(self) -> QP:
        """The program, in arrays."""
        qp = QP(Rows(tuple(self.variables), tuple(self.inequality_rows), tuple(self.equality_rows)))
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

    def as_json(self) -> dict[str, Any]:
        """For machines."""
        return {**asdict(self), "status": self.status.value, "v": self.v.tolist()}


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
    memory = state.memory.numbers.tolist()
    command = law.tick(state)
    first_answer = law.solution.v.tolist()
    state.memory.numbers[:] = memory  # as the tick had it
    law.assemble(state)
    qp, problem = law.first.qp, law.problem
    shares = qp.rows.variables[problem.chain.n :]
    pad = ((0, 0), (0, len(shares)))
    below = [*bounding(problem, state, "lower"), *(_share_bound(s, "lower") for s in shares)]
    above = [*bounding(problem, state, "upper"), *(_share_bound(s, "upper") for s in shares)]
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
        damping=law.first.curvature,
        budget=problem.budget,
        P=qp.P.tolist(),
        q_cost=qp.q.tolist(),
        C=qp.C.tolist(),
        lower=_finite(qp.lower),
        upper=_finite(qp.upper),
        inequalities=qp.p,
        variables=list(qp.rows.variables),
        inequality_rows=list(qp.rows.inequalities),
        equality_rows=list(qp.rows.equalities),
        lb_rows=below,
        ub_rows=above,
        J=np.pad(tasks.J, pad).tolist(),
        wanted=tasks.wanted.tolist(),
        task_rows=list(tasks.rows),
        answer=command.v.tolist() + [command.scale] * len(shares),
        first_answer=first_answer,
        status=written(command.causes),
    )


def bounding(problem: ControlProblem, state: State, side: Side) -> list[Row]:
    """The limit that each joint's lower or upper bound on v comes from."""
    chain = problem.chain
    tightest = np.full(chain.n, np.inf)
    found = [
        Row(name=f"no limit[{joint}].{side}", kind="limit", joint=joint, side=side)
        for joint in chain.joint_names
    ]
    for limit in problem.limits:
        alone = Bounds(chain, [limit], state, problem.dt)
        alone.update(state)
        bound = -alone.lb if side == "lower" else alone.ub
        for i, row in enumerate(bound_rows(limit, chain, side)):
            if bound[i] < tightest[i]:
                tightest[i], found[i] = bound[i], row
    return found


def _share_bound(share: Row, side: Side) -> Row:
    return replace(share, name=f"scale.{side}", side=side)


def explain(record: TickRecord) -> Explanation:
    """The smallest relaxation of the limits that would let loops and tasks hold."""
    qp, J = record.qp(), np.array(record.J).reshape(-1, len(record.variables))
    wanted, names = np.array(record.wanted), names_of(record.task_rows)
    gap = np.abs(J @ np.array(record.answer) - wanted)
    allowed = MISSED + MISSED_SHARE * np.abs(wanted)
    missed = tuple(name for name, g, a in zip(names, gap, allowed, strict=True) if g > a)
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
    kept = [i for i, row in enumerate(record.equality_rows) if row.kind == "loop"]
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
    rows = [*record.lb_rows, *record.ub_rows, *record.inequality_rows]
    found = [
        Relaxation(row.name, float(amount) * (record.dt if row.of_place else 1.0), row.unit)
        for row, amount in zip(rows, r, strict=True)
        if amount > NOTHING
    ]
    return tuple(sorted(found, key=lambda relaxation: -relaxation.amount))


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


def _finite(values: Array) -> list[float]:
    clipped: list[float] = np.clip(values, -1e30, 1e30).tolist()
    return clipped


def _infinite(values: Sequence[float]) -> Array:
    array = np.array(values, float)
    array[np.abs(array) >= 1e30] *= np.inf
    return array
