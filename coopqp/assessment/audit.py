"""What limits had left in a run: asked of each, and checked, since a limit may be the user's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coopqp.assessment.limits import JUDGED_OTHERWISE
from coopqp.base.errors import InvalidValueError
from coopqp.base.qp import Row
from coopqp.base.spec import Array, type_name
from coopqp.base.wording import raised, written_in
from coopqp.limit import Limit
from coopqp.model.closed_chain import ClosedChain


@dataclass(frozen=True)
class Audit:
    """Of all limits, as the trace has it.

    Attributes:
        margins: after each tick, by row. starts: before the first, at rest.
        unaudited: limits that do not say so, by name, with why where they say it wrongly.
    """

    margins: dict[Row, Array]
    starts: dict[Row, float]
    unaudited: tuple[str, ...]


def audit(limits: Sequence[Limit], chain: ClosedChain, q: Array, v: Array, dt: float) -> Audit:
    """Ask limits what they had left.

    Args:
        limits: of the run.
        chain: what they limit.
        q: configurations, shape (T + 1, n) [rad, m].
        v: velocities of the ticks, shape (T, n) [rad/s, m/s].
        dt: control period [s].
    """
    margins, starts, unaudited = dict[Row, Array](), dict[Row, float](), list[str]()
    for limit in limits:
        name = type_name(type(limit))
        try:
            own = left(limit, chain, q, v, dt)
            begun = left(limit, chain, q[[0, 0]], np.zeros_like(q[:1]), dt)
            if not limit.audited(chain):
                unaudited.append(name)
        except InvalidValueError as error:
            unaudited.append(f"{name} ({error})")
            continue
        margins |= own
        starts |= {row: float(margin[0]) for row, margin in begun.items()}
    return Audit(margins, starts, tuple(dict.fromkeys(unaudited)))


def left(limit: Limit, chain: ClosedChain, q: Array, v: Array, dt: float) -> dict[Row, Array]:
    """What one limit had left after each tick: :meth:`coopqp.limit.Limit.margins`, checked.

    Raises:
        InvalidValueError: with its file, and what it raises or gives instead.
    """
    file = written_in(limit, "bind")
    try:
        found = limit.margins(chain, q, v, dt)
        rows = {row: np.asarray(margin, float) for row, margin in found.items()}
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise InvalidValueError(raised(error, file)) from error
    own = type(limit).__module__.startswith("coopqp.limits.")
    for row, margin in rows.items():
        if wrong := _wrong_with(row, margin, len(v), () if own else JUDGED_OTHERWISE):
            raise InvalidValueError(f"{file}: margins() {wrong}")
    return rows


def _wrong_with(row: object, margin: Array, ticks: int, taken: Sequence[str]) -> str:
    """Why a margin cannot be used; empty where it can."""
    if not isinstance(row, Row):
        return f"has the key {row!r:.40}, needs a Row"
    if row.owner in taken:
        return f"has a row of the owner '{row.owner}', which coopqp's own limit is; rename it"
    if margin.shape != (ticks,):
        return f"gives the shape {margin.shape} for '{row}', needs ({ticks},)"
    if not (margin > -np.inf).all():
        return f"gives {margin.min()} for '{row}', needs a number, or inf where nothing is near"
    return ""
