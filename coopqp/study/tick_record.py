"""One tick of a QP controller, whole: saved, read, and solved again with any solver."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ConfigDict, TypeAdapter, ValidationError, with_config

from coopqp.base.errors import CoopqpError, InvalidValueError, one_line
from coopqp.base.qp import QP, Row, Rows, Side
from coopqp.base.reading import line_in_json, read_text
from coopqp.base.spec import Array
from coopqp.base.wording import Location, dotted
from coopqp.controller import ControlProblem, Law
from coopqp.limit import bound_rows
from coopqp.model.state import State
from coopqp.qp_law.bounds import Bounds
from coopqp.qp_law.law import QPLaw
from coopqp.solver import Budget, Solution, Solver, Status, Verifier, written
from coopqp.task import Mode, TaskStack

MAX_BYTES = 64 << 20  # of a file
SIDES: tuple[Side, Side] = "lower", "upper"
UNBOUNDED = 1e30  # what an infinite bound is written as


@with_config(ConfigDict(extra="forbid", strict=True, allow_inf_nan=False))
@dataclass(frozen=True)
class TickRecord:
    """All that explains one tick of a QP controller, and solves it again."""

    scenario: str
    controller: str
    tick: int
    # the state before the tick
    t: float
    q: list[float]
    v: list[float]
    memory: list[float]
    dt: float
    damping: float  # smallest curvature of the cost
    budget: Budget  # tolerances of an answer
    # the first level's QP: hard and scaled tasks as equality rows, or, where hard ones cannot hold,
    # as the cost (:class:`coopqp.qp_law.nearest.Nearest`), which has no shares of scaled tasks
    P: list[list[float]]
    q_cost: list[float]
    C: list[list[float]]
    lower: list[float]
    upper: list[float]
    inequalities: int  # number of rows of G in C
    variables: list[Row]
    inequality_rows: list[Row]
    equality_rows: list[Row]
    lb_rows: list[Row]  # the limit that each bound on v comes from
    ub_rows: list[Row]
    J: list[list[float]]  # this and the next two are of the rows of all tasks
    wanted: list[float]
    task_rows: list[Row]
    modes: dict[str, Mode]  # soft, hard or scaled, by the task's name
    answer: list[float]  # the controller's, all levels included, as is the status
    first_answer: list[float]  # its solver's, of this QP
    status: str

    def text(self) -> str:
        """As JSON; infinite bounds as 1e30."""
        return json.dumps(asdict(self), indent=1) + "\n"

    @staticmethod
    def read(path: Path) -> TickRecord:
        """Read what :meth:`text` gave; CoopqpError where it is no saved tick."""
        text = read_text(path, MAX_BYTES)
        try:
            record = _RECORD.validate_json(text)
        except ValidationError as error:
            detail = error.errors(include_url=False, include_context=False)[0]
            raise _refused(path, text, detail["loc"], detail["msg"]) from None
        if wrong := record._misfit() or record._wrong():
            raise _refused(path, text, *wrong)
        return record

    def _wrong(self) -> tuple[Location, str] | None:
        """Location and reason of the first fault; None if there is none."""
        unknown = [row.owner for row in self.task_rows if row.owner not in self.modes]
        if unknown:
            return ("modes",), f"has no task '{one_line(unknown[0])}', which has rows"
        for key in ("dt", "damping"):
            if not getattr(self, key) > 0.0:
                return (key,), f"found {getattr(self, key):g}, needs more than 0"
        for key in ("P", "C", "J", "q_cost", "lower", "upper", "wanted"):
            for place in np.argwhere(np.abs(np.array(getattr(self, key))) > UNBOUNDED).tolist():
                return (key, *place), f"a number is beyond {UNBOUNDED:g}"
        P = np.array(self.P)
        apart = np.argwhere(~np.isclose(P, P.T, rtol=1e-9, atol=1e-12)).tolist()
        if apart:
            i, j = apart[-1]
            return ("P", i, j), f"found {P[i, j]:g}, but [{j}][{i}] is {P[j, i]:g}: not symmetric"
        lowest, *_, highest = np.linalg.eigvalsh(np.pad(P, (0, 1)))  # padded: two at least
        if lowest < -1e-9 * highest:
            return ("P",), f"has the eigenvalue {lowest:.3g}, needs none below zero"
        return None

    def _misfit(self) -> tuple[Location, str] | None:
        """The first array whose size does not fit the others."""
        n, p, m = len(self.variables), len(self.inequality_rows), len(self.equality_rows)
        k = len(self.task_rows)
        if not n:
            return ("variables",), "needs one at least"
        if self.inequalities != p:
            return ("inequalities",), f"found {self.inequalities}, but there are {p} rows"
        counts = {
            "P": n, "q_cost": n, "C": p + m, "lower": n + p + m, "upper": n + p + m,
            "lb_rows": n, "ub_rows": n, "J": k, "wanted": k, "answer": n, "first_answer": n,
        }  # fmt: skip
        for key, count in counts.items():
            if (found := len(getattr(self, key))) != count:
                return (key,), f"found {found}, needs {count}, as many as belong to it"
        for key in ("P", "C", "J"):
            for i, row in enumerate(getattr(self, key)):
                if len(row) != n:
                    return (key, i), f"found {len(row)} numbers, needs {n}, one a variable"
        return None

    def qp(self) -> QP:
        qp = QP(Rows(tuple(self.variables), tuple(self.inequality_rows), tuple(self.equality_rows)))
        qp.P[:], qp.q[:] = self.P, self.q_cost
        if self.C:
            qp.C[:] = self.C
        bounds = np.array([self.lower, self.upper])
        bounds[np.abs(bounds) >= UNBOUNDED] *= np.inf
        qp.lower[:], qp.upper[:] = bounds
        return qp


_RECORD = TypeAdapter(TickRecord)


def _refused(path: Path, text: str, location: Location, why: str) -> CoopqpError:
    """The error for a file that is no tick, with its line."""
    broken = re.search(r" at line (\d+) column (\d+)", why)
    line = int(broken[1]) if broken else line_in_json(text, location)
    if broken and broken[2] == "0":  # it is the line break before that is wrong
        line -= 1
    where = f"{one_line(dotted(location))}: " if location else ""
    words = "is not a tick saved by 'coopqp explain --save'"
    return CoopqpError(f"{path}:{line}: {words}: {where}{' '.join(why.split())}")


def record_tick(
    law: QPLaw, state: State, *, scenario: str, controller: str, tick: int, by: Law | None = None
) -> TickRecord:
    """Record the tick that a law, or its compiled one, would do at an updated state."""
    memory = state.memory.numbers.tolist()
    command = (by or law).tick(state)
    if command.status is Status.RAISED:
        raise InvalidValueError(f"tick {tick} of '{controller}' has no QP: {command.note}")
    relaxed = state.memory["missed"].any()
    state.memory.numbers[:] = memory  # as the tick had it
    problem, level = law.problem, law.first
    if holds := not (by and relaxed):
        law.assemble(state)
        holds = level.solve().usable and not relaxed
    if by and not holds:  # then the levels of the plain law say more
        return record_tick(law, state, scenario=scenario, controller=controller, tick=tick)
    if not holds and problem.on_infeasible == "scale" and law.nearest.hard.solution.status.usable:
        level = law.nearest.hard  # where hard tasks cannot hold, theirs decides first
    qp = level.qp
    shares = qp.rows.variables[problem.chain.n :]
    pad = ((0, 0), (0, len(shares)))
    named = NamedBounds(problem, state)
    below, above = (
        [*rows, *(replace(share, name=f"scale.{side}", side=side) for share in shares)]
        for rows, side in zip((named.below, named.above), SIDES, strict=True)
    )
    tasks = TaskStack(problem.tasks, law.order.start)
    tasks.update(state)
    lower, upper = np.clip([qp.lower, qp.upper], -UNBOUNDED, UNBOUNDED).tolist()
    return TickRecord(
        scenario=scenario, controller=controller, tick=tick,
        t=state.t, q=state.q.tolist(), v=state.v.tolist(), memory=memory,
        dt=problem.dt, damping=level.curvature, budget=problem.budget,
        P=qp.P.tolist(), q_cost=qp.q.tolist(), C=qp.C.tolist(),
        lower=lower, upper=upper, inequalities=qp.p,
        variables=list(qp.rows.variables), inequality_rows=list(qp.rows.inequalities),
        equality_rows=list(qp.rows.equalities), lb_rows=below, ub_rows=above,
        J=np.pad(tasks.J, pad).tolist(), wanted=tasks.wanted.tolist(), task_rows=list(tasks.rows),
        modes={task.name: task.mode for task in problem.tasks},
        answer=command.v.tolist() + [command.scale] * len(shares),
        first_answer=level.solution.v.tolist(), status=written(command.causes),
    )  # fmt: skip


class NamedBounds:
    """The limits of a problem one by one, so that each bound on v has the name of one.

    lb and ub are the tightest, from the limits ``below`` and ``above``; G and h their rows.
    """

    def __init__(self, problem: ControlProblem, state: State) -> None:
        chain = problem.chain
        self._none = [
            [
                Row(name=f"no limit[{joint}].{side}", kind="limit", joint=joint, side=side)
                for joint in chain.joint_names
            ]
            for side in SIDES
        ]
        alone = [Bounds([limit], state, problem.dt) for limit in problem.limits]
        rows = [[bound_rows(limit, chain, side) for side in SIDES] for limit in problem.limits]
        self._each = list(zip(alone, rows, strict=True))
        self.update(state)

    def update(self, state: State) -> None:
        n = len(state.v)
        self.below, self.above = tightest_rows = [*self._none[0]], [*self._none[1]]
        tightest = np.full((2, n), np.inf)
        for alone, rows in self._each:
            alone.update(state)
            bounds = np.array([-alone.lb, alone.ub])
            for k, i in np.argwhere(bounds < tightest).tolist():
                tightest_rows[k][i] = rows[k][i]
            np.minimum(tightest, bounds, out=tightest)
        self.lb, self.ub = -tightest[0], tightest[1]
        self.G = np.vstack([np.zeros((0, n)), *(alone.G for alone, _ in self._each)])
        self.h = np.concatenate([np.zeros(0), *(alone.h for alone, _ in self._each)])

    @property
    def rows(self) -> list[Row]:
        """The limits that lb, ub and h come from, in this order."""
        return [*self.below, *self.above, *(row for alone, _ in self._each for row in alone.rows)]


@dataclass(frozen=True)
class Replay:
    """A saved tick solved again."""

    status: Status  # verified
    v: Array  # the answer
    primal_residual: float
    dual_residual: float
    difference: float  # largest distance to the answer that was saved [rad/s]

    def as_json(self) -> dict[str, Any]:
        return {**asdict(self), "status": self.status.value, "v": self.v.tolist()}


def replay(record: TickRecord, solver: Solver) -> Replay:
    """Solve a saved tick with any solver."""
    qp = record.qp()
    solution = Solution(qp)
    solver.open(qp, solution)()
    status = Verifier(qp, solution, record.budget, record.damping).check()
    v, difference = solution.v.copy(), np.abs(solution.v - np.array(record.first_answer)).max()
    primal, dual = float(solution.primal_residual), float(solution.dual_residual)
    return Replay(status, v, primal, dual, float(difference))
