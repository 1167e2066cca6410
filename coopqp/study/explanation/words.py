"""The explanation of a run, and its sentences: names and numbers, in units for people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from coopqp.assessment import Assessment
from coopqp.assessment.verdict import loop_words
from coopqp.base.qp import Row
from coopqp.base.spec import Array
from coopqp.base.wording import counted
from coopqp.model.closed_chain import ClosedChain
from coopqp.study.explanation.diagnosis import Contradiction, Elsewhere, TooFar, Unreachable
from coopqp.study.explanation.goal import Missed, PartOfTask, Place, Share
from coopqp.task import Mode

#: A direction this near to an axis is the axis.
ALONG = 0.97
#: Most limits that are named.
MAX_NAMED = 4


def listed(names: Sequence[str]) -> str:
    """``a, b and c``."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"


def _first(names: Sequence[str]) -> str:
    more = [f"{len(names) - MAX_NAMED} more"] if len(names) > MAX_NAMED else []
    return listed([*names[:MAX_NAMED], *more])


def size(amount: float, unit: str) -> str:
    """An error or an amount; lengths in millimetres."""
    if unit == "m" and amount < 1.0:
        return f"{1e3 * amount:.3g} mm"
    return f"{amount:.3g} {unit}"


def percent(share: float) -> str:
    """A share, in words."""
    if share < 0.01:
        return "less than 1 %"
    return "more than 99 %" if 0.99 < share < 1.0 else f"{100.0 * share:.0f} %"


def with_note(row: Row, note: str) -> str:
    """A limit's words with a note in its brackets."""
    words = row.label
    return f"{words[:-1]}, {note})" if words.endswith(")") else f"{words} ({note})"


def _with_percents(shares: Sequence[Share], of: str = "") -> list[str]:
    """Limits with their shares, the first with what these are shares of."""
    return [
        with_note(share.row, f"{100.0 * share.share:.0f} %{'' if i else of}")
        for i, share in enumerate(shares)
    ]


def stops_short(part: PartOfTask, error: float) -> str:
    """How far a part of a task stops short."""
    if np.isnan(error):
        return f"the error of {part.name} is no number"
    amount = size(error, part.part.unit)
    if part.task.asks_velocity:
        return f"{part.name} misses by {amount}"
    return f"{part.name} stops {amount} short"


def holding(shares: Sequence[Share]) -> str:
    """Limits with their shares of the force, and the verb."""
    if not shares:
        return "the limits hold it back"
    if len(shares) == 1:
        return f"{shares[0].row.label} alone holds it back"
    return f"{_first(_with_percents(shares, ' of the constraint force'))} hold it back"


def slow(shares: Sequence[Share]) -> str:
    """Speed limits that slow it down, with their shares."""
    verb = "slows" if len(shares) == 1 else "slow"
    return f"{listed(_with_percents(shares[:MAX_NAMED]))} {verb} it down"


def geometry(
    cause: Unreachable, missed: Sequence[Missed], chain: ClosedChain, *, ordered: bool
) -> str:
    """What keeps a chain from its goal, if not limits alone; ordered: as the law has levels."""
    if isinstance(cause, Contradiction):
        return _contradiction(cause, missed, ordered=ordered)
    if isinstance(cause, TooFar):
        return _reach(cause)
    short = stops_short(*missed[0])
    if isinstance(cause, Elsewhere):
        return f"{short}; {holding(cause.shares)}; {elsewhere(cause.place, chain)}"
    needs = f"{cause.tasks[0].name} needs {cause.requested} degrees of freedom"
    return f"{short}; {needs}, the loops leave {cause.left}"


def elsewhere(place: Place, chain: ClosedChain) -> str:
    """Where it would be reached inside the limits."""
    where = start(place.q, chain)
    return f"it can be reached inside the limits from another configuration, such as {where}"


def start(q: Array, chain: ClosedChain) -> str:
    """A configuration by arm, as a scenario's start; with these digits its loops are closed."""
    at = {name: f"{x:.5f}" for name, x in zip(chain.joint_names, q.tolist(), strict=True)}
    arms = ((arm.name, map(at.__getitem__, chain.robot.arm_joints(arm))) for arm in chain.arms)
    return "; ".join(f"{name} [{', '.join(numbers)}]" for name, numbers in arms)


def _reach(cause: TooFar) -> str:
    part, several, named = cause.part, len(cause.shares) > 1, cause.shares[:MAX_NAMED]
    text, unit = part.task.name, part.part.unit
    held = listed(_with_percents(named) if several else [share.row.label for share in named])
    if cause.cost > cause.distance:
        verb = "hold" if several else "holds"
        text = f"{held} {verb} {text} back by {size(cause.cost, unit)}; beyond that it"
    text += f" is unreachable by {size(cause.distance, unit)}"
    if cause.in_world:
        text += f" along {_direction(cause.gap)}"
    elif part.part.name:
        text += f" of {part.part.name}"
    text += ", whatever the limits"
    if cause.in_world:
        cause.goal.look(cause.nearest.q)
        point = cause.goal.state.point(np.array(getattr(part.task, "point", (0.0, 0.0, 0.0))))
        text += f"; the nearest point is {_point(point)}"
    if 0.0 < cause.cost <= cause.distance:
        text += f"; limits cost another {size(cause.cost, unit)}: {held}"
    if cause.elsewhere is not None:
        text += f"; from another configuration {size(part.size(cause.elsewhere.e), unit)}"
    return text


def _direction(way: Array) -> str:
    """``+x``, or a unit vector."""
    u = way / max(float(np.linalg.norm(way)), 1e-300)
    i = int(np.abs(u).argmax())
    return f"{'+' if u[i] > 0 else '-'}{'xyz'[i]}" if abs(u[i]) > ALONG else _point(u, 2)


def _point(p: Array, digits: int = 3) -> str:
    rounded = np.round(p, digits) + 0.0
    return f"({', '.join(f'{x:.{digits}f}' for x in rounded)})"


def _contradiction(cause: Contradiction, missed: Sequence[Missed], *, ordered: bool) -> str:
    where = "on any robot" if cause.any_robot else "on this robot, whatever the limits"
    text = f"{listed([task.name for task in cause.tasks])} cannot hold together, {where}"
    mine = [(part, e) for part, e in missed if part.task in cause.tasks]
    if not mine:
        return text
    first = min(task.level for task in cause.tasks)
    offs = [f"{part.name} stays {size(e, part.part.unit)} off" for part, e in mine]
    before = [task.name for task in cause.tasks if task.level == first]
    if ordered and len(before) < len(cause.tasks):
        verb = "comes" if len(before) == 1 else "come"
        return f"{text}; {listed(before)} {verb} first, {listed(offs)}"
    sizes = {size(e, part.part.unit) for part, e in mine}
    if len(mine) > 1 and len(sizes) == 1:
        return f"{text}; they end {sizes.pop()} off each"
    return f"{text}; {listed(offs)}"


def opened(result: Assessment, kappa: float) -> str:
    """How far the loops opened, and what corrects it; empty where they were closed."""
    if result.loop_closed:
        return ""
    why = f"kappa {kappa:g} 1/s" if kappa else "kappa: 0, no Baumgarte stabilisation"
    return f"the loop opened by {loop_words(result)} ({why})"


def broken(result: Assessment) -> str:
    """Limits that a run went beyond; empty where there are none."""
    violated = [o for o in (*result.joints, *result.limits, *result.speeds) if o.farther]
    amounts = [f"{o.row.label} by {size(o.by, o.row.unit)}" for o in violated]
    return f"beyond limits: {_first(amounts)}" if amounts else ""


@dataclass(frozen=True, kw_only=True)
class Relaxed:
    """A hard or scaled task that is not met in full in some ticks of a run."""

    task: str
    mode: Mode
    ticks: int
    missing: float  # share of its rate that it lacks in the last tick

    @property
    def sentence(self) -> str:
        ticks = counted(self.ticks, "tick")
        end = f"lacks {percent(self.missing)} of its rate" if self.missing else "is met"
        return f"{self.mode} task '{self.task}' is not met in full in {ticks} and {end} at the end"


@dataclass(frozen=True, kw_only=True)
class MissedPart:
    """A part of a task that ended outside its tolerance."""

    task: str
    error: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class HeldBack:
    """A limit that holds back, with its share of the force."""

    limit: str
    words: str
    share: float


@dataclass(frozen=True, kw_only=True)
class Needed:
    """By how much a limit would have to be relaxed [rad or m]."""

    limit: str
    words: str
    amount: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class RunExplanation:
    """Why a run did not reach its goal."""

    controller: str
    phase: str  # that missed; empty if it is the only one
    tick: int  # its last
    # reached, broken, open, input, lost, limits, elsewhere, reach, contradiction, freedom, speed,
    # budget, short, rest, model, motors, springs, way, weight, failed or unplaced
    kind: str = ""
    sentence: str = ""
    # what ended outside its tolerance, hard and scaled tasks first, then the worst
    missed: tuple[MissedPart, ...] = ()
    held_back: tuple[HeldBack, ...] = ()  # limits by their share of the force
    needed: tuple[Needed, ...] = ()  # relaxations that would do
    # whether a rerun with these, or with the time needed, reached the goal; None if none
    tried: bool | None = None
    tasks: tuple[str, ...] = ()  # that contradict each other, or are unreachable
    any_robot: bool = False  # whether they would on any other robot
    distance: float | None = None  # to the nearest place [unit of what is missed most]
    # unit vector from there to the goal, where the task is a point of the world
    way: tuple[float, ...] = ()
    time: float | None = None  # that would do, or at which the object was lost [s]
    # joints at the goal inside the limits, where the run does not get there [rad, m]
    elsewhere: tuple[float, ...] = ()
    # whether a plan from the start was found; None if none was looked for
    way_round: bool | None = None
    relaxed: tuple[Relaxed, ...] = ()  # hard and scaled tasks that were not met in full on the way

    def because(
        self, kind: str, cause: str, shares: Sequence[Share] = (), **more: Any
    ) -> RunExplanation:
        """With its cause, in words after what it misses, and more attributes."""
        sentence = f"{self.sentence}; {cause}" if self.sentence else cause
        held = tuple(HeldBack(limit=s.row.name, words=s.row.label, share=s.share) for s in shares)
        return replace(self, kind=kind, sentence=sentence, held_back=held, **more)

    def as_json(self) -> dict[str, Any]:
        return asdict(self)
