"""One sentence on a run: does it get there, keep the limits and the loops closed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from coopqp.checked import Array
from coopqp.hold import CLOSED_ORIENTATION, CLOSED_POSITION
from coopqp.trace import Trace

#: A gap between the hands and the model below both is not worth saying [m], [rad].
WORTH_SAYING = (1e-3, 5e-3)
#: Beyond one of these the model should be calibrated [m], [rad].
WORTH_CALIBRATING = (5e-3, 20e-3)
#: What a run that gave something up has done, by cause.
GIVEN_UP = {
    "TASKS_GIVEN_UP": "gives up hard or scaled tasks",
    "ACCELERATION_GIVEN_UP": "gives up an acceleration limit",
}

#: A limit overrun below this is rounding [rad, rad/s].
ROUNDING = 1e-9


def verdict(trace: Trace, metrics: Mapping[str, Any]) -> str:
    """Say in one sentence whether it gets there, keeps the limits and the loop closed."""
    parts = [
        *_broken(trace), _arrival(trace), _limits(trace), _speed(trace), _loop(metrics),
        _gap(metrics), _ticks(metrics),
    ]  # fmt: skip
    text = "; ".join(part for part in parts if part)
    return text[0].upper() + text[1:] + "."


def _arrival(trace: Trace) -> str:
    missed = [
        (task, error)
        for task, error in zip(trace.tasks, trace.final_error, strict=True)
        if not error <= task.tolerance  # a NaN has reached nothing
    ]
    if not missed:
        return "reaches the goal"
    shares = [error / task.tolerance for task, error in missed]
    task, error = missed[int(np.argmax(shares))]  # which takes a NaN for the largest
    if np.isnan(error):
        return f"loses '{task.name}': its error is no number"
    far = f"{1e3 * error:.1f} mm" if task.unit == "m" else f"{error:.3g} {task.unit}"
    at_limit = _joints_at_limit(trace)
    why = f", held back by {at_limit}" if at_limit else ""
    return f"ends {far} off the goal of '{task.name}'{why}"


def _joints_at_limit(trace: Trace) -> str:
    """Joints that end at a limit they never left."""
    end, beyond = trace.q[-1], np.maximum(trace.lower - trace.q, trace.q - trace.upper)
    near = np.minimum(np.abs(end - trace.lower), np.abs(trace.upper - end)) < 1e-6
    kept = beyond.max(axis=0) <= ROUNDING
    return " and ".join(np.array(trace.joints)[near & kept][:3])


def _limits(trace: Trace) -> str:
    outside = np.maximum(trace.lower - trace.q, trace.q - trace.upper)
    beyond = outside.max(axis=0)
    worst = int(beyond.argmax())
    if beyond[worst] <= ROUNDING:
        return "keeps every joint inside its limits"
    if beyond[worst] <= outside[0, worst] + ROUNDING:
        return _way_back(trace, outside.max(axis=1), worst)
    far = f"{_round(beyond[worst])} {trace.units[worst]}"
    return f"drives {trace.joints[worst]} {far} beyond its limit"


def _way_back(trace: Trace, outside: Array, worst: int) -> str:
    """Of a run that starts outside, and goes no farther out."""
    far = f"{_round(outside[0])} {trace.units[worst]}"
    start = f"starts with {trace.joints[worst]} {far} beyond its limit"
    if outside[-1] > ROUNDING:
        return f"{start} and ends outside"
    back = float(trace.t[1 + int(np.flatnonzero(outside > ROUNDING)[-1])] - trace.t[0])
    return f"{start}, is inside after {back:.2g} s and stays there"


def _speed(trace: Trace) -> str:
    share = np.abs(trace.v).max(axis=0, initial=0.0) / trace.velocity
    worst = int(share.argmax())
    if share[worst] <= 1.0 + ROUNDING:
        return ""
    return f"asks {_round(share[worst])} times the speed {trace.joints[worst]} has"


def _loop(metrics: Mapping[str, Any]) -> str:
    error = metrics["loop_error_max"]
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


def _round(value: float) -> str:
    """Two digits, and never an exponent for large numbers."""
    return f"{value:.2g}" if value < 100.0 else f"{value:,.0f}"


def _broken(trace: Trace) -> list[str]:
    """What is first to be said where code raised an error, or the plant broke down."""
    said = [failure for failure in trace.failures if failure.note]
    return [f"stands still from {trace.t[said[0].tick]:.3g} s: {said[0].note}"] if said else []


def _ticks(metrics: Mapping[str, Any]) -> str:
    failed = metrics["failed_ticks"]
    said = [f"holds still in {failed} of {metrics['ticks']} ticks"] if failed else []
    given_up = metrics["fallback_ticks"]
    said += [
        f"{words} in {given_up[cause]} of {metrics['ticks']} ticks"
        for cause, words in GIVEN_UP.items()
        if cause in given_up
    ]
    return "; ".join(said)
