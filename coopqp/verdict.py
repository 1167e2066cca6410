"""One sentence on a run: does it get there, keep the limits and the loops closed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from coopqp.checked import Array
from coopqp.hold import CLOSED_ORIENTATION, CLOSED_POSITION
from coopqp.limit import ROUNDING
from coopqp.overrun import Overrun, at_limits, broken, matters, outside
from coopqp.solver import Status
from coopqp.trace import Trace

#: A gap between the hands and the model below both is not worth saying [m], [rad].
WORTH_SAYING = (1e-3, 5e-3)
#: Beyond one of these the model should be calibrated [m], [rad].
WORTH_CALIBRATING = (5e-3, 20e-3)
#: What a run that gave something up has done, by cause.
GIVEN_UP = {
    "TASKS_RELAXED": "does not meet hard or scaled tasks in full",
    "CONTACT_GIVEN_UP": "asks for more than friction can bear",
    "ACCELERATION_GIVEN_UP": "gives up an acceleration limit",
    "SQUEEZE_GIVEN_UP": "stands at most_way without the squeeze",
}
#: A speed beyond its limit by less than this share is not worth a word.
FASTER = 1e-3
#: Speeds below so many times the limit are told by what they are beyond it.
HARDLY = 1.1
#: A motor that is at its limit in less than this share of the ticks was only passing.
PASSING = 0.01
#: Joints that can bring about less than this share of what they could at the start are singular.
SINGULAR = 0.02
MOST_NAMES = 3
#: An object that moves along a hand by more has slipped; less is the creep of simulated contacts.
SLIPPED = 1e-3  # [m]
#: A smaller share of the friction is none.
WORTH_A_NUMBER = 5e-3
#: With less of a pad between the pressure and its edge the pad stands on the edge.
ON_EDGE = 1e-3


def verdict(trace: Trace, metrics: Mapping[str, Any], unseen: Sequence[str] = ()) -> str:
    """Say in one sentence whether it gets there, keeps the limits and the loop closed.

    Args:
        trace: of the run.
        metrics: of the trace, by name.
        unseen: what the limits ought to bound and cannot, one sentence each.
    """
    parts = [
        *_broken(trace), _hold(trace, metrics), _arrival(trace, metrics), _limits(trace, unseen),
        _speed(trace), _loop(trace, metrics),
        _gap(metrics), _motors(trace), _ticks(trace, metrics),
    ]  # fmt: skip
    text = "; ".join(part for part in parts if part)
    return text[0].upper() + text[1:] + "."


def fell(trace: Trace) -> bool:
    """Whether hands that press have lost the object, so that it is nowhere any more."""
    held = trace.signals.get("held")
    return held is not None and not held[:, 0].all()


def _arrival(trace: Trace, metrics: Mapping[str, Any]) -> str:
    if trace.broke_down or fell(trace):
        return "reaches no goal"
    if unheard := _unheard(metrics):
        return f"reaches no goal: {unheard}"
    missed = [
        k
        for k, (task, error) in enumerate(zip(trace.tasks, trace.final_error, strict=True))
        if not error <= task.tolerance  # a NaN has reached nothing
    ]
    if not missed and (yielded := _gives_way(trace)):
        return yielded
    if not missed:
        torn = any(trace.torn)
        return "ends at the goal, but loses the object on the way" if torn else "reaches the goal"
    shares = [trace.final_error[k] / trace.tasks[k].tolerance for k in missed]
    k = missed[int(np.argmax(shares))]  # which takes a NaN for the largest
    task, error = trace.tasks[k], trace.final_error[k]
    if np.isnan(error):
        return f"loses '{task.name}': its error is no number"
    far = f"{1e3 * error:.1f} mm" if task.unit == "m" else f"{error:.3g} {task.unit}"
    if _swings(trace, k):
        return f"swings to the end up to {far} off the goal of '{task.name}'"
    return f"ends {far} off the goal of '{task.name}'{_where(trace, k)}"


def _gives_way(trace: Trace) -> str:
    """How far impedances have given way to what pushes the object to the end, as asked."""
    said = []
    for k, task in enumerate(trace.tasks):
        far = float(trace.task_error[trace.last_instants[k], k])
        if trace.pushed(k) and far > task.tolerance and not trace.torn[k]:
            amount = f"{1e3 * far:.1f} mm" if task.unit == "m" else f"{far:.3g} {task.unit}"
            said.append(f"gives way {amount} to what pushes it, as '{task.name}' was asked to")
    return "; ".join(said)


def _swings(trace: Trace, k: int) -> bool:
    """Whether what task k asks for, missed at its end, is only passed through or about."""
    task, off = trace.tasks[k], trace.at_end(k)
    last = trace.last_instants[k] + 1
    own = [i for i, row in enumerate(trace.task_rows) if row.startswith(f"{task.name}.")]
    rows = trace.e[last - len(off) : last, own]
    about = (rows.min(axis=0) < -task.tolerance) & (rows.max(axis=0) > task.tolerance)
    return bool(off.min() <= task.tolerance or about.any())


def _unheard(metrics: Mapping[str, Any]) -> str:
    """Why goals that are inputs are not what was sent; empty if they are."""
    found = metrics.get("input_ticks")
    if found and found["nothing_at"]:
        return f"nothing that can be used arrives at the input {_listed(found['nothing_at'])}"
    if found and found["refused_at_end"]:
        return "what arrives at an input is refused to the end"
    return ""


def _where(trace: Trace, k: int) -> str:
    """What can be seen where task k is missed; ``coopqp explain`` finds out why."""
    if trace.leverage[k] < SINGULAR:
        return ", at a pose in which the arms can hardly move it that way"
    names = at_limits(trace, trace.last_instants[k])
    if not names:
        return ""
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return f", with {_listed(names[:MOST_NAMES])}{more} at the limit"


def _limits(trace: Trace, unseen: Sequence[str]) -> str:
    if trace.broke_down:
        return ""
    others = "; ".join(_beyond(overrun) for overrun in broken(trace))
    beyond = outside(trace)
    worst = int(beyond.max(axis=0).argmax())
    farthest, at_start = float(beyond[:, worst].max()), float(beyond[0, worst])
    if not matters(farthest, trace.units[worst]):
        return others or f"keeps {_kept(trace, unseen)}"
    if farthest <= at_start + ROUNDING:
        joints = _way_back(trace, beyond.max(axis=1), worst)
    else:
        far = _amount(farthest, trace.units[worst])
        joints = f"drives {trace.joints[worst]} {far} beyond its limit"
    return f"{joints}; {others}" if others else joints


def _kept(trace: Trace, unseen: Sequence[str]) -> str:
    """What is kept, where nothing was broken."""
    others = any(not row.joint for row in trace.margins)
    if others and unseen:
        told, *more = dict.fromkeys(line.partition(":")[0] for line in unseen)
        others_too = f" and {len(more)} more, see the notes" if more else ""
        return f"every limit as far as it is watched: {told}{others_too}"
    return "every limit" if others else "every joint inside its limits"


def _beyond(overrun: Overrun) -> str:
    """A limit other than a joint's, and how far it was broken."""
    row, far = overrun.row, _amount(overrun.by, overrun.row.unit)
    if row.unit not in ("m", "rad"):
        return f"exceeds the {row.words} by {far}"
    if row.bodies:
        return _too_near(overrun)
    if not overrun.farther:
        out = matters(overrun.at_end, row.unit)
        return f"starts {far} beyond {row.words} and {'ends outside' if out else 'comes back'}"
    start = f" ({_amount(overrun.at_start, row.unit)} at the start)" if overrun.at_start else ""
    return f"goes {far} beyond {row.words}{start}"


def _too_near(overrun: Overrun) -> str:
    """Two bodies that were nearer to each other than asked."""
    row, far = overrun.row, _amount(overrun.by, "m")
    one, other = row.bodies
    left = row.kept - overrun.by
    what = f"{one} {far} nearer to {other} than asked"
    if left > 0.0:
        what += f" ({_round(1e3 * left)} of {_round(1e3 * row.kept)} mm left)"
    elif left < 0.0:
        what += f", {_amount(-left, 'm')} deep in it"
    if not overrun.farther:
        return f"starts with {what} and {'ends so' if matters(overrun.at_end, 'm') else 'parts'}"
    start = f", {_amount(overrun.at_start, 'm')} at the start" if overrun.at_start else ""
    return f"brings {what}{start}"


def _way_back(trace: Trace, outside: Array, worst: int) -> str:
    """Of a run that starts outside, and goes no farther out."""
    far = _amount(outside[0], trace.units[worst])
    start = f"starts with {trace.joints[worst]} {far} beyond its limit"
    if outside[-1] > ROUNDING:
        return f"{start} and ends outside"
    back = float(trace.t[1 + int(np.flatnonzero(outside > ROUNDING)[-1])] - trace.t[0])
    return f"{start}, is inside after {back:.2g} s and stays there"


def _speed(trace: Trace) -> str:
    share = np.abs(trace.v).max(axis=0, initial=0.0) / trace.velocity
    worst = int(share.argmax())
    if share[worst] <= 1.0 + FASTER:
        return ""
    if share[worst] < HARDLY:
        return (
            f"needs {100.0 * (share[worst] - 1.0):.1g} % more speed than {trace.joints[worst]} has"
        )
    return f"needs {_round(share[worst])} times the speed {trace.joints[worst]} has"


def _loop(trace: Trace, metrics: Mapping[str, Any]) -> str:
    error = metrics["loop_error_max"]
    if fell(trace):
        return ""
    if error["position"] <= CLOSED_POSITION and error["orientation"] <= CLOSED_ORIENTATION:
        return ""
    return (
        f"lets the loop open by {_round(1e3 * error['position'])} mm and "
        f"{_round(np.degrees(error['orientation']))} degrees"
    )


def _gap(metrics: Mapping[str, Any]) -> str:
    position, orientation = metrics["gap"]["position"], metrics["gap"]["orientation"]
    if position <= WORTH_SAYING[0] and orientation <= WORTH_SAYING[1]:
        return ""
    beyond = position > WORTH_CALIBRATING[0] or orientation > WORTH_CALIBRATING[1]
    return (
        f"the hands are {_round(1e3 * position)} mm and {_round(1e3 * orientation)} mrad apart "
        f"from what the model says{': calibrate' if beyond else ''}"
    )


def _motors(trace: Trace) -> str:
    """Motors that ask for more torque than they have."""
    if "saturated" not in trace.signals:
        return ""
    share = (trace.signals["saturated"] > 0.0).mean(axis=0)
    worst = int(share.argmax())
    if share[worst] <= PASSING:
        return ""
    percent = f"{100.0 * share[worst]:.0f} % of the ticks"
    return f"saturates the motor of {trace.joints[worst]} in {percent}"


def _broken(trace: Trace) -> list[str]:
    """What is first to be said where code raised an error, or the plant broke down."""
    lost = Status.OBJECT_LOST.value
    said = [failure for failure in trace.failures if failure.note and failure.cause != lost]
    return [f"stands still from {trace.t[said[0].tick]:.3g} s: {said[0].note}"] if said else []


def _hold(trace: Trace, metrics: Mapping[str, Any]) -> str:
    """Whether hands that press hold the object, and how much friction they leave unused."""
    held = metrics.get("held")
    if held is None:
        return ""
    if not held["held"]:
        lost = [f.note for f in trace.failures if f.cause == Status.OBJECT_LOST.value]
        why = f": {lost[0].removeprefix('the object is lost: ')}" if lost else ""
        return f"loses the object at {held['lost_at']:.3g} s{why}"
    margin, edge, slip = (
        metrics[name] for name in ("friction_margin", "edge_margin", "slip_distance")
    )
    if margin is None:  # a run that was over before they pressed
        return "holds the object so far"
    said = "at the edge of its friction"
    if margin >= WORTH_A_NUMBER:
        said = f"with {100.0 * margin:.0f} % of the friction unused"
    if edge is not None and edge <= ON_EDGE:
        said += " and a pad on its edge"
    slipped = f"; it slips {_round(1e3 * slip)} mm" if slip > SLIPPED else ""
    return f"holds the object {said}{slipped}"


def _ticks(trace: Trace, metrics: Mapping[str, Any]) -> str:
    failed = 0 if trace.broke_down and _lost(trace) else metrics["failed_ticks"]
    given_up = metrics["fallback_ticks"]
    said = []
    if failed:
        said.append(f"holds still in {failed} of {metrics['ticks']} ticks: {_cause(trace)}")
    said += _input_ticks(metrics)
    said += [
        f"{words} in {given_up[cause]} of {metrics['ticks']} ticks"
        for cause, words in GIVEN_UP.items()
        if cause in given_up
    ]
    return "; ".join(said)


def _input_ticks(metrics: Mapping[str, Any]) -> list[str]:
    """In how many ticks inputs were refused, and stale."""
    found = metrics.get("input_ticks") or {}
    words = {"refused": "has an input refused", "stale": "has an input stale"}
    return [
        f"{said} in {found[key]} of {metrics['ticks']} ticks"
        for key, said in words.items()
        if found.get(key)
    ]


def _lost(trace: Trace) -> bool:
    """Whether the run ended where the object was lost."""
    return any(failure.cause == Status.OBJECT_LOST.value for failure in trace.failures)


def _cause(trace: Trace) -> str:
    """Why most of the failed ticks failed, without what is said first already."""
    ((cause, _),) = Counter(failure.cause for failure in trace.failures).most_common(1)
    return cause.removeprefix("stands still: ")


def _listed(names: Sequence[str]) -> str:
    return " and ".join(names)


def _amount(value: float, unit: str) -> str:
    """With a unit for people."""
    return f"{_round(1e3 * value)} mm" if unit == "m" else f"{_round(value)} {unit}"


def _round(value: float) -> str:
    """Two digits, and never an exponent for large numbers."""
    return f"{value:.2g}" if value < 100.0 else f"{value:,.0f}"
