"""What a loop can be asked for."""

from __future__ import annotations

import math
from typing import Literal, get_args

from coopqp.errors import InvalidValueError, unknown_name

Reference = Literal["commanded", "measured"]
HowHeld = Literal["as_held", "as_written"]
PhasesEnd = Literal["by_time", "asked"]

CHOICES = {"reference": Reference, "grasp": HowHeld, "phases": PhasesEnd}


def check_options(choices: dict[str, str], times: dict[str, float | None]) -> None:
    """Refuse what a loop cannot be asked for.

    Args:
        choices: by the argument's name.
        times: the same, more than zero [s]; None is not asked for.

    Raises:
        InvalidValueError: with everything that is wrong.
    """
    found = [
        f"{name}: {unknown_name('choice', str(given), get_args(CHOICES[name]))}"
        for name, given in choices.items()
        if given not in get_args(CHOICES[name])
    ]
    found += [
        f"{name}: found {given} s; needs a finite time, more than 0"
        for name, given in times.items()
        if given is not None and not 0.0 < given < math.inf
    ]
    if found:
        raise InvalidValueError("\n".join(found))
