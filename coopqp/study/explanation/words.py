"""The sentences: names and numbers together, in units that a person has for them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coopqp.assessment import Assessment
from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.row import Row
from coopqp.study.explanation.contradiction import Contradiction
from coopqp.study.explanation.cure import Cure, Need
from coopqp.study.explanation.diagnosis import OutOfReach, TooFewFreedoms
from coopqp.study.explanation.goal import PartOfTask
from coopqp.study.explanation.leg import Leg
from coopqp.study.explanation.search import Place
from coopqp.study.explanation.shares import Share, thing_of
from coopqp.task import Task

#: A direction this near to an axis is the axis.
ALONG = 0.97
#: Most limits that are named.
MOST = 4


def listed(names: Sequence[str]) -> str:
    """``a, b and c``."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"


def size(amount: float, unit: str) -> str:
    """An error or an amount; lengths in millimetres."""
    if unit == "m" and amount < 1.0:
        return f"{1e3 * amount:.3g} mm"
    return f"{amount:.3g} {unit}"


def with_note(row: Row, note: str) -> str:
    """A limit's words with a note in its brackets."""
    words = row.words
    return f"{words[:-1]}, {note})" if words.endswith(")") else f"{words} ({note})"


def stops(leg: Leg) -> str:
    """What the worst part of a task ended off by."""
    return stops_short(*leg.missed[0])


def stops_short(part: PartOfTask, error: float) -> str:
    """What a part of a task is off by."""
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
        return f"{shares[0].row.words} holds it back alone"
    named = shares[:MOST]
    words = [
        with_note(share.row, f"{100.0 * share.share:.0f} %{' of the force' if i == 0 else ''}")
        for i, share in enumerate(named)
    ]
    more = [f"{len(shares) - MOST} more"] if len(shares) > MOST else []
    return f"{listed([*words, *more])} hold it back"


def cure(found: Cure | None, shares: Sequence[Share]) -> str:
    """What would do, and whether it was seen to."""
    if found is None:
        return "even without limits of place the law does not get there"
    now = {thing_of(share.row) for share in shares}
    first = [need for need in found.needs if thing_of(need.row) in now]
    later = [need for need in found.needs if thing_of(need.row) not in now]
    text = f"to get there {needed(first)}" if first else "to get there"
    if later:
        text += (
            f"{'; next' if first else ' next'} would come {needed(later, alone=False)}, idle now"
        )
    if found.reached and found.time is not None:
        return f"{text} and the run {found.time:.3g} s (tried: reached)"
    if found.reached:
        return f"{text} (tried: reached)"
    if found.reached is None:
        return f"{text} (not tried: no setting gives so much)"
    assert found.left
    return f"{text}; tried, but then {stops(found.left)}"


def needed(needs: Sequence[Need], *, alone: bool = True) -> str:
    """Amounts that limits would have to give, each beside its limit; the verb with the first."""
    said: list[str] = []
    for need in needs:
        name = need.row.words if need.space is None else _thing(need.row)
        amount = size(need.amount, need.row.unit)
        verb = "would need " if alone and not said else ""
        said.append(f"{name} {verb}{amount} more{'' if need.space is None else ' room'}")
    return listed(said)


def _thing(row: Row) -> str:
    """A limit in space as a whole."""
    return row.owner.replace("_", " ")


def elsewhere(place: Place, chain: ClosedChain) -> str:
    """Where it would be reached inside the limits."""
    where = start(place.q, chain)
    return f"it can be reached inside the limits from another configuration, such as {where}"


def start(q: Array, chain: ClosedChain) -> str:
    """A configuration by arm, as a scenario's start has it; the digits close its loops."""
    at = dict(zip(chain.joint_names, q.tolist(), strict=True))
    arms = []
    for arm in chain.arms:
        numbers = ", ".join(f"{at[joint]:.5f}" for joint in chain.robot.arm_joints(arm))
        arms.append(f"{arm.name} [{numbers}]")
    return "; ".join(arms)


def reach(found: OutOfReach) -> str:
    """How far out of reach, which way, and what the limits cost beside."""
    part = found.part
    name, unit = part.task.name, part.part.unit
    several = len(found.shares) > 1
    held = listed(
        [with_note(s.row, f"{100.0 * s.share:.0f} %") if several else s.row.words
         for s in found.shares[:MOST]]
    )  # fmt: skip
    if found.cost > found.distance:
        verb = "hold" if several else "holds"
        text = f"{held} {verb} {name} back by {size(found.cost, unit)}; beyond that it"
    else:
        text = name
    text += f" is out of reach by {size(found.distance, unit)}"
    if found.in_world:
        text += f" along {direction(found.gap)}"
    elif part.part.name:
        text += f" of {part.part.name}"
    text += ", whatever the limits"
    if found.in_world:
        text += f"; the nearest point is {point(_reached_point(found))}"
    if 0.0 < found.cost <= found.distance:
        text += f"; limits cost another {size(found.cost, unit)}: {held}"
    if found.elsewhere is not None:
        e = np.linalg.norm(found.elsewhere.e[part.rows])
        text += f"; from another configuration {size(float(e), unit)}"
    return text


def _reached_point(found: OutOfReach) -> Array:
    """Where the point of the object that the task moves is, as near as it gets."""
    found.goal.look(found.nearest.q)
    return found.goal.state.point(np.array(getattr(found.part.task, "point", (0.0, 0.0, 0.0))))


def direction(way: Array) -> str:
    """``+x``, or a unit vector."""
    u = way / max(float(np.linalg.norm(way)), 1e-300)
    i = int(np.abs(u).argmax())
    if abs(u[i]) > ALONG:
        return f"{'+' if u[i] > 0 else '-'}{'xyz'[i]}"
    return point(u, 2)


def point(p: Array, digits: int = 3) -> str:
    """``(0.210, 0.000, 0.100)``."""
    rounded = np.round(p, digits) + 0.0
    return f"({', '.join(f'{x:.{digits}f}' for x in rounded)})"


def contradiction(
    found: Contradiction, missed: Sequence[tuple[PartOfTask, float]], *, ordered: bool
) -> str:
    """Which tasks, what they miss, and who comes first."""
    where = "on any robot" if found.any_robot else "on this robot, whatever the limits"
    text = f"{listed([task.name for task in found.tasks])} cannot hold together, {where}"
    mine = [(part, e) for part, e in missed if part.task in found.tasks]
    if not mine:
        return text
    ranks = {_rank(task) for task in found.tasks}
    offs = [f"{part.name} stays {size(e, part.part.unit)} off" for part, e in mine]
    if ordered and len(ranks) > 1:
        first = [task.name for task in found.tasks if _rank(task) == min(ranks)]
        verb = "comes" if len(first) == 1 else "come"
        return f"{text}; {listed(first)} {verb} first, {listed(offs)}"
    sizes = {size(e, part.part.unit) for part, e in mine}
    if len(mine) > 1 and len(sizes) == 1:
        return f"{text}; they end {sizes.pop()} off each"
    return f"{text}; {listed(offs)}"


def _rank(task: Task) -> int:
    return -1 if task.mode != "soft" else task.priority


def freedoms(found: TooFewFreedoms) -> str:
    """How many motions are asked for and left."""
    name = found.goal.tasks[0].name
    return f"{name} asks for {found.asked} motions, the loops leave {found.left}"


def broken(found: Assessment) -> str:
    """Limits that a run went beyond; empty where there are none."""
    overruns = [o for o in (*found.joints, *found.limits, *found.speeds) if o.farther]
    if not overruns:
        return ""
    said = [f"{o.row.words} by {size(o.by - o.at_start, o.row.unit)}" for o in overruns[:MOST]]
    more = [f"{len(overruns) - MOST} more"] if len(overruns) > MOST else []
    return f"beyond limits: {listed([*said, *more])}"


def slow(shares: Sequence[Share]) -> str:
    """Speeds that hold up."""
    named = [with_note(share.row, f"{100.0 * share.share:.0f} %") for share in shares[:MOST]]
    return f"{listed(named)} {'holds' if len(named) == 1 else 'hold'} it up"
