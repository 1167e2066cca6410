"""Checks of a loop's options."""

import math
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from inspect import signature
from numbers import Real
from typing import Any, Literal, get_args

from coopqp.base.errors import InvalidValueError, unknown_name
from coopqp.base.wording import raised
from coopqp.model.loop_observer import Observer
from coopqp.online.arrivals import as_time
from coopqp.scenario.scenario import needs_scenario

Reference = Literal["commanded", "measured"]
HowHeld = Literal["as_held", "as_written"]
PhasesEnd = Literal["by_time", "asked"]

CHOICES = {"reference": Reference, "grasp": HowHeld, "phases": PhasesEnd}
#: Longest history in memory [s].
MAX_KEPT = 3600.0


def check_options(options: Mapping[str, Any]) -> None:
    """Refuse options that are none."""
    found = [f"{name}: {words}" for name, words in _faults(options)]
    if found:
        raise InvalidValueError("\n".join(found))


def time_fault(found: Any, *, none: bool = False, zero: bool = False, maximum: float = 0.0) -> str:
    """What is wrong with a time [s]; empty if nothing is."""
    if found is None and none:
        return ""
    needs = "a finite time, " + ("at least 0" if zero else "more than 0")
    if maximum:
        needs += f" and at most {maximum:g} s"
    if isinstance(found, bool) or not isinstance(found, Real):
        return f"found {found!r}; needs {needs}{', or None' if none else ''}"
    time = float(found)
    if (time >= 0.0 if zero else time > 0.0) and time < math.inf and time <= (maximum or math.inf):
        return ""
    return f"found {found} s; needs {needs}"


def _faults(options: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    scenario, controller = options["scenario"], options["controller"]
    try:
        needs_scenario(scenario)
    except InvalidValueError as error:
        yield "scenario", str(error).removeprefix("scenario: ")
    if not isinstance(controller, str):
        yield "controller", f"found {controller!r}; needs a name"
    for name, kind in CHOICES.items():
        if options[name] not in get_args(kind):
            yield name, unknown_name("choice", str(options[name]), get_args(kind))
    faults = {
        "speed_up": time_fault(options["speed_up"], none=True),
        "patience": time_fault(options["patience"]),
        "keep": time_fault(options["keep"], maximum=MAX_KEPT),
        "silent_after": time_fault(options["silent_after"], zero=True),
        "clock": _clock_fault(options["clock"]),
        "out": _folder_fault(options["out"]),
    }
    yield from ((name, fault) for name, fault in faults.items() if fault)
    if not (options["observer"] is None or isinstance(options["observer"], Observer)):
        yield "observer", f"found {options['observer']!r}; needs a coopqp.Observer"
    if not (options["record"] is None or callable(options["record"])):
        yield "record", f"found {options['record']!r}; needs a function that makes a recording"


def _clock_fault(clock: Any) -> str:
    if clock is None:
        return ""
    if not callable(clock):
        return f"found {clock!r}; needs a function that says the time, or None to count ticks"
    with suppress(ValueError):  # some of C say nothing of their arguments
        try:
            signature(clock).bind()
        except TypeError as error:
            return f"{error}; needs a function without arguments"
    try:
        now = clock()
    except Exception as error:  # noqa: BLE001 - it is a user's
        return raised(error)
    return "" if as_time(now) is not None else f"says {now!r}; needs seconds"


def _folder_fault(out: Any) -> str:
    if out is None:
        return ""
    if not isinstance(out, str | os.PathLike):
        return f"found {out!r}; needs a folder"
    name = os.fspath(out)
    if not isinstance(name, str) or not name or "\0" in name:
        return f"found {name!r}; needs a folder's name"
    return ""
