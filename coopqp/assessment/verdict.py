"""One sentence on a run: does it get there, keep the limits and the loops closed."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from coopqp.assessment import thresholds
from coopqp.assessment.assessment import Assessment, TaskEnd, pushed
from coopqp.assessment.limits import LimitViolation, beyond
from coopqp.assessment.thresholds import matters, resolved
from coopqp.signal import CLOCK
from coopqp.solver import Status
from coopqp.trace import Trace

#: What a run that relaxed something has done, by cause.
RELAXED = {
    "TASKS_RELAXED": "does not meet hard or scaled tasks in full",
    "CONTACT_GIVEN_UP": "asks for more than friction can bear",
    "ACCELERATION_GIVEN_UP": "gives up an acceleration limit",
    "SQUEEZE_GIVEN_UP": "stands at most_way without the squeeze",
}
#: Speeds and accelerations below so many times the limit are told by what they are beyond it.
HARDLY = 1.1
MAX_NAMES = 3


def verdict(run: Assessment, metrics: Mapping[str, Any], unseen: Sequence[str] = ()) -> str:
    """Say in one sentence whether it gets there, keeps the limits and the loop closed.

    ``unseen`` is what the limits ought to bound and cannot, one sentence each.
    """
    opens = run.held is not False and not run.loop_closed
    loop = f"lets the loop open by {loop_words(run)}" if opens else ""
    parts = [
        *_broken(run.trace), _hold(run, metrics), _arrival(run), _waits(run),
        _motion(run), _limits(run, unseen), _speed(run), _acceleration(run), loop,
        _loop_offset(metrics), saturation_words(run, "saturates "), _oscillation(run),
        _ticks(run, metrics),
    ]  # fmt: skip
    text = "; ".join(part for part in parts if part)
    return text[0].upper() + text[1:] + "."


def _arrival(run: Assessment) -> str:
    if run.ended or run.held is False:
        return "reaches no goal"
    if unfollowed := not_followed(run):
        return f"reaches no goal: {unfollowed}"
    if not run.missed and (yielded := _gives_way(run)):
        return yielded
    if not run.missed:
        torn = any(task.torn for task in run.tasks)
        return "ends at the goal, but loses the object on the way" if torn else "reaches the goal"
    task = run.missed[0]
    if np.isnan(task.error):
        return f"loses {_called(task)}: its error is no number"
    far = _far(task.error, task.unit)
    if task.oscillates:
        return f"oscillates to the end, up to {far} off the goal of {_called(task)}{_others(run)}"
    where = _where(run, run.tasks.index(task))
    return f"ends {far} off the goal of {_called(task)}{_others(run)}{where}"


def _called(task: TaskEnd) -> str:
    """What a sentence calls a task: with its mode where that puts it before others."""
    name = f"'{task.name}'"
    return name if task.mode == "soft" else f"{task.mode} task {name}"


def _others(run: Assessment) -> str:
    """How far off other missed tasks are: those that come after the first, then the rest."""
    later = run.gave_way
    others = [task for task in run.missed[1:] if task not in later]
    verb = "comes" if len(later) == 1 else "come"
    after = f" and {_off(later)}, which {verb} after it" if later else ""
    return f"{after}{',' if later and others else ''}{f' and {_off(others)}' if others else ''}"


def _off(tasks: Sequence[TaskEnd]) -> str:
    clauses = [
        f"at no number of that of {_called(task)}"
        if np.isnan(task.error)
        else f"{_far(task.error, task.unit)} off that of {_called(task)}"
        for task in tasks[:MAX_NAMES]
    ]
    more = [f"that of {len(tasks) - MAX_NAMES} more"] if len(tasks) > MAX_NAMES else []
    return " and ".join([*clauses, *more])


def _motion(run: Assessment) -> str:
    """Of a run that has missed a place, that it is still on its way."""
    places = [task for task in run.missed if not task.unit.endswith("/s")]
    if not places or run.motion != "moving" or not run.fastest:
        return ""
    joint, speed, unit = run.fastest
    return f"still moves when the run ends, {joint} at {_amount(speed, unit)}"


def _waits(run: Assessment) -> str:
    """How far each phase has come along a way whose clock waits, if not to its end."""
    trace, clauses = run.trace, list[str]()
    phases = [(phase.first, f" of '{phase.name}'") for phase in trace.phases] or [(0, "")]
    ends = [*(first for first, _ in phases[1:]), trace.ticks]
    for name in (name for name, kept in trace.inputs.items() if kept.kind == CLOCK):
        gone = trace.inputs[name].value[:, 0]
        for (first, of), end in zip(phases, ends, strict=True):
            tasks = [task.end for task in trace.tasks if (task.rows.start or 0) == first]
            whole = max(tasks, default=0.0) - float(trace.t[first])
            lasted = float(trace.t[end - 1] - trace.t[first])
            if end and gone[end - 1] < min(whole, lasted) - trace.dt:
                words = f"the joints are held back at {gone[end - 1]:.2f} of the {whole:.2f} s"
                clauses.append(f"{words}{of}")
    return "; ".join(clauses)


def _far(error: float, unit: str) -> str:
    """One digit behind the point of millimetres, two digits of less than a tenth."""
    if unit != "m":
        return f"{error:.3g} {unit}"
    return f"{1e3 * error:.1f} mm" if error >= 1e-4 else f"{1e3 * error:.2g} mm"


def _gives_way(run: Assessment) -> str:
    """How far impedances have given way to what pushes the object to the end, as asked."""
    clauses, trace = [], run.trace
    for k, task in enumerate(run.tasks):
        far = float(trace.task_error[trace.last_instants[k], k])
        if pushed(trace, k) and far > task.tolerance and not task.torn:
            amount = _far(far, task.unit)
            clauses.append(f"yields {amount} to the push, as '{task.name}' specifies")
    return "; ".join(clauses)


def not_followed(run: Assessment) -> str:
    """Why goals that are inputs are not what was sent; empty if they are."""
    if run.inputs.nothing_at:
        listed = " and ".join(run.inputs.nothing_at)
        return f"no usable value arrives at the input {listed}"
    if run.inputs.refused_at_end:
        return "the last values at an input are refused"
    return ""


def _where(run: Assessment, k: int) -> str:
    """What can be seen where task k is missed; a search would make comparisons wait."""
    if run.trace.manipulability[k] < thresholds.SINGULAR:
        return ", near a singularity in that direction"
    names = run.at_limits(k)
    return f", with {listed_limits(names)} at the limit; 'coopqp explain' says why" if names else ""


def listed_limits(names: Sequence[str]) -> str:
    """The first of the limits at which a run ends, and how many more there are."""
    more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    return f"{' and '.join(names[:MAX_NAMES])}{more}"


def _limits(run: Assessment, unseen: Sequence[str]) -> str:
    if run.ended:
        return ""
    unaudited = run.trace.unaudited
    verb = "is" if len(unaudited) == 1 else "are"
    silent = [f"{' and '.join(unaudited)} {verb} not audited"] if unaudited else []
    others = "; ".join((*map(_beyond, run.limits), *silent))
    if not run.joints and not run.limits:
        return ", but ".join((f"keeps {_kept(run.trace, unseen)}", *silent))
    if not run.joints:
        return others
    worst = next((violation for violation in run.joints if violation.farther), run.joints[0])
    if worst.farther:
        far = _amount(worst.by, worst.row.unit)
        joints = f"drives {worst.name} {far} beyond its limit"
    else:
        joints = _recovery(run, worst)
    return f"{joints}; {others}" if others else joints


def _kept(trace: Trace, unseen: Sequence[str]) -> str:
    """What is kept, where nothing was broken."""
    others = any(not row.joint for row in trace.margins)
    if not others:
        return "every joint inside its limits"
    if not unseen:
        return "every limit"
    first, *more = dict.fromkeys(line.partition(":")[0] for line in unseen)
    others_too = f" and {len(more)} more, see the notes" if more else ""
    return f"every limit as far as it is watched: {first}{others_too}"


def _beyond(violation: LimitViolation) -> str:
    """A limit other than a joint's, and how far it was broken."""
    row, far = violation.row, _amount(violation.by, violation.row.unit)
    if row.unit not in ("m", "rad"):
        return f"exceeds the {row.label} by {far}"
    if row.bodies:
        return _too_near(violation)
    if not violation.farther:
        out = matters(violation.at_end, row.unit)
        return f"starts {far} beyond {row.label} and {'ends outside' if out else 'comes back'}"
    start = f" ({_amount(violation.at_start, row.unit)} at the start)" if violation.at_start else ""
    return f"goes {far} beyond {row.label}{start}"


def _too_near(violation: LimitViolation) -> str:
    """Two bodies that were nearer to each other than their limit allows."""
    row, far = violation.row, _amount(violation.by, "m")
    one, other = row.bodies
    left = row.kept - violation.by
    what = f"{one} {far} closer to {other} than allowed"
    if left > 0.0:
        what += f" ({_round(1e3 * left)} of {_round(1e3 * row.kept)} mm left)"
    elif left < 0.0:
        what += f", {_amount(-left, 'm')} inside it"
    if not violation.farther:
        end = "ends so" if matters(violation.at_end, "m") else "separates"
        return f"starts with {what} and {end}"
    start = f", {_amount(violation.at_start, 'm')} at the start" if violation.at_start else ""
    return f"brings {what}{start}"


def _recovery(run: Assessment, worst: LimitViolation) -> str:
    """Of a run that starts outside, and goes no farther out."""
    trace = run.trace
    far = _amount(worst.at_start, worst.row.unit)
    start = f"starts with {worst.name} {far} beyond its limit"
    outside = beyond(trace).max(axis=1)
    if outside[-1] > thresholds.OUTSIDE:
        return f"{start} and ends outside"
    back = float(trace.t[1 + int(np.flatnonzero(outside > thresholds.OUTSIDE)[-1])] - trace.t[0])
    return f"{start}, is inside after {back:.2g} s and stays there"


def _speed(run: Assessment) -> str:
    if not run.speeds:
        return ""
    worst = run.speeds[0]
    limit = run.trace.velocity[run.trace.joints.index(worst.row.joint)]
    share = 1.0 + worst.by / limit
    if share < HARDLY:
        return f"exceeds the speed limit of {worst.row.joint} by {_round(100.0 * (share - 1.0))} %"
    return f"needs {_round(share)} times the speed limit of {worst.row.joint}"


def _acceleration(run: Assessment) -> str:
    worst = run.acceleration
    if worst is None or not worst.exceeds:
        return ""
    share = worst.value / worst.allowed
    hardly = f"{_round(100.0 * (share - 1.0))} % more than"
    beyond = hardly if share < HARDLY else f"{_round(share)} times"
    what = f"accelerates {worst.joint} at {_amount(worst.value, worst.unit)}, {beyond} what"
    advice = ": add joint_acceleration to limits" if run.acceleration_free else ""
    return f"{what} the loop for robots allows{advice}"


def loop_words(run: Assessment) -> str:
    """How far the loops were open at most."""
    position, orientation = run.loop
    sizes = []
    if resolved(position, thresholds.LOOP_CLOSED):
        sizes.append(f"{_round(1e3 * position)} mm")
    if resolved(orientation, thresholds.LOOP_CLOSED_ANGLE):
        sizes.append(f"{_round(np.degrees(orientation))} degrees")
    return " and ".join(sizes)


def _loop_offset(metrics: Mapping[str, Any]) -> str:
    position, orientation = (metrics["loop_offset"][of] for of in ("position", "orientation"))
    if position <= thresholds.MODEL_OFF and orientation <= thresholds.MODEL_OFF_ANGLE:
        return ""
    apart = [f"{_round(1e3 * position)} mm"] if resolved(position, thresholds.MODEL_OFF) else []
    if resolved(orientation, thresholds.MODEL_OFF_ANGLE):
        apart.append(f"{_round(1e3 * orientation)} mrad")
    off = position > thresholds.CALIBRATE or orientation > thresholds.CALIBRATE_ANGLE
    advice = ": calibrate" if off else ""
    return f"the hands are {' and '.join(apart)} from where the model has them{advice}"


def saturation_words(run: Assessment, verb: str) -> str:
    """That it saturates the motor that is most often at its limit; empty where none is."""
    for joint, share in run.saturated.items():
        return f"{verb}the motor of {joint} in {100.0 * share:.0f} % of the ticks"
    return ""


def _oscillation(run: Assessment) -> str:
    oscillation = run.oscillation
    if oscillation is None:
        return ""
    size = _amount(oscillation.size, run.trace.units[oscillation.joint])
    joint = run.trace.joints[oscillation.joint]
    return f"{joint} oscillates to the end by {size} at {oscillation.frequency:.2g} Hz"


def _broken(trace: Trace) -> list[str]:
    """What is first to be said where code raised an error, or the plant broke down."""
    lost = Status.OBJECT_LOST.value
    noted = [failure for failure in trace.failures if failure.note and failure.cause != lost]
    return [f"stands still from {trace.t[noted[0].tick]:.3g} s: {noted[0].note}"] if noted else []


def _hold(run: Assessment, metrics: Mapping[str, Any]) -> str:
    """Whether hands that press hold the object, and how much friction they leave unused."""
    held = metrics.get("held")
    if held is None:
        return ""
    if not held["held"]:
        failures = run.trace.failures
        lost = [f.note for f in failures if f.cause == Status.OBJECT_LOST.value]
        why = f": {lost[0].removeprefix('the object is lost: ')}" if lost else ""
        return f"loses the object at {held['lost_at']:.3g} s{why}"
    names = "friction_margin", "edge_margin", "slip_distance"
    margin, edge, slip = (metrics[name] for name in names)
    if margin is None:  # a run that was over before they pressed
        return "holds the object so far"
    lately = run.trace.signals["slip"][-1 - round(thresholds.SETTLED / run.trace.dt) :]
    slips = (lately[-1] - lately[0]).max() > thresholds.SLIPPED
    if slips:  # whether friction holds it yet is not known
        return f"lets the object slip, by {_round(1e3 * slip)} mm and still at the end"
    clause = "at the edge of its friction"
    if margin >= thresholds.FRICTION_LEFT:
        clause = f"with {100.0 * margin:.0f} % of the friction unused"
    if edge is not None and edge <= thresholds.ON_EDGE:
        clause += " and a pad on its edge"
    slipped = f"; it slips {_round(1e3 * slip)} mm" if slip > thresholds.SLIPPED else ""
    return f"holds the object {clause}{slipped}"


def _ticks(run: Assessment, metrics: Mapping[str, Any]) -> str:
    failed, causes = run.failed
    relaxed, ticks = metrics["relaxed_ticks"], run.trace.ticks
    clauses = []
    if failed and Status.OBJECT_LOST.value not in causes:
        why = next(iter(causes)).removeprefix("stands still: ")
        clauses.append(f"holds still in {failed} of {ticks} ticks: {why}")
    if run.inputs.refused:
        clauses.append(f"has an input refused in {run.inputs.refused} of {ticks} ticks")
    if run.inputs.stale:
        clauses.append(f"has an input stale in {run.inputs.stale} of {ticks} ticks")
    clauses += [
        f"{words} in {relaxed[cause]} of {ticks} ticks"
        for cause, words in RELAXED.items()
        if cause in relaxed
    ]
    return "; ".join(clauses)


def _amount(value: float, unit: str) -> str:
    """With a unit for people."""
    return f"{_round(1e3 * value)} mm" if unit == "m" else f"{_round(value)} {unit}"


def _round(value: float) -> str:
    """Two digits, and never an exponent for large numbers."""
    return f"{value:.2g}" if value < 99.5 else f"{value:,.0f}"
