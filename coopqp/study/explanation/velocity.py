"""Velocities that could not be followed at the end of a run: a twist has no goal to search for.

At the last tick, with u the direction that is missed and Z the motions that keep the loops closed:

    contradiction   all tasks' rows together have no solution within the loops, each alone has one
    reach           |Z' J' u| has fallen below a share of what it was at the start, or the speed
                    that is needed is far beyond the joints'
    limits, speed   by the multipliers of the ticks, as in :mod:`coopqp.study.explanation.asked`
"""

from __future__ import annotations

import numpy as np

from coopqp.base.rank import null_space
from coopqp.base.spec import Array
from coopqp.study.explanation import words
from coopqp.study.explanation.asked import TickBatch, held_up, speed_share
from coopqp.study.explanation.diagnosis import contradicting as smallest
from coopqp.study.explanation.explained_phase import ExplainedPhase
from coopqp.study.explanation.goal import PartOfTask
from coopqp.study.explanation.suggested_relaxation import by_rerun, with_suggestion
from coopqp.study.explanation.words import RunExplanation
from coopqp.task import Task

#: Singular below this share of the start's, or when so many times the joints' speed is needed.
SINGULAR, BEYOND = 0.02, 20.0
#: Rows have a solution where the least-squares residual is a smaller share of what is wanted.
SOLVED = 1e-3
#: Singular values below this share of the largest are no motion.
CUT = 1e-4
#: Last ticks that are evaluated, and the share of position limits from which they are the cause.
LAST, MOSTLY = 50, 0.5


def explain(leg: ExplainedPhase, base: RunExplanation) -> RunExplanation:
    """Why a velocity was missed, at the last tick."""
    part = next(part for part, _ in leg.missed if part.task.asks_velocity)
    k = len(leg.v) - 1
    if tasks := contradicting(leg):
        names = tuple(task.name for task in tasks)
        said = f"{words.listed(names)} cannot hold together: they ask for different motions"
        return base.because("contradiction", said, tasks=names)
    needed = _speed_needed(leg, k, part.rows)
    if _singular(leg, k, part) or needed > BEYOND:
        return _at_the_edge(leg, k, part, base)
    held = held_up(leg, range(max(0, k - LAST), k + 1))
    if held and speed_share(held) <= MOSTLY:
        return with_suggestion(base, held, by_rerun(leg, None))
    why = words.slow(held) if held else "the law does not follow it"
    more = f"; it asks for {needed:.2g} times the speed there is" if needed > 1.0 else ""
    return base.because("speed", why + more, held, tasks=(part.task.name,))


def _at_the_edge(
    leg: ExplainedPhase, k: int, part: PartOfTask, base: RunExplanation
) -> RunExplanation:
    look = TickBatch(leg)
    u = look.look(k)[part.rows]
    names = [row.name.rpartition(".")[2] for row in look.stack.rows[part.rows]]
    i = int(np.abs(u).argmax())
    along = f"{'+' if u[i] > 0 else '-'}{names[i]}"
    of = " of its own axes" if getattr(part.task, "axes", "world") == "object" else ""
    said = (
        f"the object is at the edge of its reach along {along}{of}: whatever the limits and "
        "speeds, the loops leave no motion there"
    )
    missed = dict(zip(names, u.tolist(), strict=True))
    way = np.array([missed.get(axis, 0.0) for axis in "xyz"])
    size = float(np.linalg.norm(way))
    unit = tuple((way / size).tolist()) if size else ()
    return base.because("reach", said, tasks=(part.task.name,), way=unit)


def _speed_needed(leg: ExplainedPhase, k: int, rows: slice) -> float:
    """Least share of the joints' speeds with which some rows could be followed at tick k.

    Infinite where the loops leave no such motion. A linear program: minimise the largest |v|/v_max
    under J_c v = 0 and J v = wanted.
    """
    from scipy.optimize import linprog  # which takes a sixth of a second to come

    look = TickBatch(leg)
    look.look(k)
    J, most = look.stack.J[rows], leg.problem.chain.velocity
    known, n = np.isfinite(most), len(most)
    sides = np.vstack([np.eye(n)[known], -np.eye(n)[known]])
    G = np.hstack([sides, -np.tile(most[known], 2)[:, None]])
    loops = look.state.J_loop
    A = np.hstack([np.vstack([loops, J]), np.zeros((len(loops) + len(J), 1))])
    b = np.concatenate([np.zeros(len(loops)), look.stack.wanted[rows]])
    cost = np.concatenate([np.zeros(n), [1.0]])
    found = linprog(cost, A_ub=G, b_ub=np.zeros(len(G)), A_eq=A, b_eq=b, bounds=(None, None))
    return float(found.fun) if found.success else np.inf


def _singular(leg: ExplainedPhase, k: int, part: PartOfTask) -> bool:
    """Whether the loops have all but taken away the direction that is missed."""
    look = TickBatch(leg)
    u = look.look(k)[part.rows]
    now = _freedom(look, part, u)
    look.look(0)
    return now < SINGULAR * _freedom(look, part, u)


def _freedom(look: TickBatch, part: PartOfTask, u: Array) -> float:
    Z = null_space(look.state.J_loop)
    return float(np.linalg.norm(Z.T @ look.stack.J[part.rows].T @ (u / np.linalg.norm(u))))


def contradicting(leg: ExplainedPhase) -> tuple[Task, ...]:
    """Tasks whose velocities at the last tick rule each other out; none where they do not."""
    look = TickBatch(leg)
    look.look(len(leg.v) - 1)
    Z, stack = null_space(look.state.J_loop), look.stack
    rows = dict(zip((task.name for task in stack.tasks), stack.slices, strict=True))

    def fails(some: tuple[Task, ...]) -> bool:
        chosen = np.concatenate([np.arange(rows[t.name].start, rows[t.name].stop) for t in some])
        JZ, wanted = stack.J[chosen] @ Z, stack.wanted[chosen]
        if not np.linalg.norm(wanted):
            return False
        y = np.linalg.lstsq(JZ, wanted, rcond=CUT)[0]
        return bool(np.linalg.norm(JZ @ y - wanted) > SOLVED * np.linalg.norm(wanted))

    return smallest([task for task in stack.tasks if not task.joint_space], fails)
