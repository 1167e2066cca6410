"""Velocities that could not be followed at the end of a run: a twist has no goal to search for.

At the last tick, with u the direction that is missed and Z the motions that keep the loops closed:

    contradiction   all tasks' rows together have no solution within the loops, each alone has one
    reach           |Z' J' u| has fallen below a share of what it was at the start, or the speed
                    that is needed is far beyond the joints'
    limits, speed   by the multipliers of the ticks, as in :mod:`coopqp.study.explanation.motion`
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coopqp.checked import Array
from coopqp.rank import null_space
from coopqp.scenario.scenario import Scenario
from coopqp.study.explanation import words
from coopqp.study.explanation.contradiction import irreducible
from coopqp.study.explanation.cure import Cure, way_of
from coopqp.study.explanation.goal import PartOfTask
from coopqp.study.explanation.leg import Leg
from coopqp.study.explanation.motion import Ticks, held_up, is_speed, speed_needed
from coopqp.study.explanation.room import Room
from coopqp.study.explanation.shares import Share
from coopqp.task import Task

#: Singular below this share of the start's, or when so many times the joints' speed is needed.
SINGULAR, BEYOND = 0.02, 20.0
#: Rows have a solution where least squares leaves less than this share of what is wanted.
SOLVED = 1e-3
#: Singular values below this share of the largest are no motion.
CUT = 1e-4
#: Ticks at the end that are looked at, and the share of places from which on they are the cause.
LAST, MOSTLY = 50, 0.5


@dataclass(frozen=True)
class VelocityAnswer:
    """Why a velocity was missed.

    Attributes:
        kind: contradiction, reach, limits or speed.
        sentence: in words.
        shares: of the limits that held it back.
        cure: of limits of place.
        tasks: that contradict each other, or cannot go on.
        way: unit vector of what was missed, where it is a translation.
    """

    kind: str
    sentence: str
    shares: tuple[Share, ...] = ()
    cure: Cure | None = None
    tasks: tuple[str, ...] = ()
    way: tuple[float, ...] = ()


def explain(scenario: Scenario, controller: str, leg: Leg, room: Room) -> VelocityAnswer:
    """Why, at the last tick.

    Args:
        scenario: as the controller holds it.
        controller: its name.
        leg: that missed velocities alone.
        room: its limits.
    """
    part = next(part for part, _ in leg.missed if part.task.asks_velocity)
    k = len(leg.v) - 1
    tasks = contradicting(leg)
    if tasks:
        names = tuple(task.name for task in tasks)
        said = f"{words.listed(names)} cannot hold together: they ask for different motions"
        return VelocityAnswer("contradiction", said, tasks=names)
    needed = speed_needed(leg, k, part.rows)
    if _singular(leg, k, part) or needed > BEYOND:
        return _at_the_edge(leg, k, part)
    held = held_up(leg, range(max(0, k - LAST), k + 1))
    if sum(share.share for share in held if is_speed(share.row)) > MOSTLY or not held:
        return _too_fast(leg, held, needed, part)
    found = way_of(scenario, controller, leg, room, None)
    said = f"{words.holding(held)}; {words.cure(found, held)}"
    return VelocityAnswer("limits", said, held, found)


def _too_fast(leg: Leg, held: tuple[Share, ...], needed: float, part: PartOfTask) -> VelocityAnswer:
    why = words.slow(held) if held else "the law does not follow it"
    more = f"; it asks for {needed:.2g} times the speed there is" if needed > 1.0 else ""
    return VelocityAnswer("speed", why + more, held, tasks=(part.task.name,))


def _at_the_edge(leg: Leg, k: int, part: PartOfTask) -> VelocityAnswer:
    u = Ticks(leg).look(k)[part.rows]
    names = [name.rpartition(".")[2] for name in _row_names(leg, part)]
    i = int(np.abs(u).argmax())
    along = f"{'+' if u[i] > 0 else '-'}{names[i]}"
    of = " of its own axes" if getattr(part.task, "axes", "world") == "object" else ""
    said = (
        f"the object is at the edge of its reach along {along}{of}: whatever the limits and "
        "speeds, the loops leave no motion there"
    )
    way = np.zeros(3)
    for name, component in zip(names, u, strict=True):
        if name in ("x", "y", "z"):
            way["xyz".index(name)] = component
    size = float(np.linalg.norm(way))
    return VelocityAnswer(
        "reach", said, tasks=(part.task.name,), way=tuple((way / size).tolist()) if size else ()
    )


def _row_names(leg: Leg, part: PartOfTask) -> list[str]:
    return [row.name for row in Ticks(leg).stack.rows[part.rows]]


def _singular(leg: Leg, k: int, part: PartOfTask) -> bool:
    """Whether the loops have all but taken away the direction that is missed."""
    look = Ticks(leg)
    u = look.look(k)[part.rows]
    now = _freedom(look, part, u)
    look.look(0)
    return now < SINGULAR * _freedom(look, part, u)


def _freedom(look: Ticks, part: PartOfTask, u: Array) -> float:
    Z = null_space(look.state.J_loop)
    return float(np.linalg.norm(Z.T @ look.stack.J[part.rows].T @ (u / np.linalg.norm(u))))


def contradicting(leg: Leg) -> tuple[Task, ...]:
    """Tasks whose velocities at the last tick rule each other out; none where they do not."""
    look = Ticks(leg)
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

    tasks = tuple(task for task in stack.tasks if not task.joint_space)
    found = irreducible(tasks, fails) if tasks and fails(tasks) else ()
    return found if len(found) > 1 else ()
