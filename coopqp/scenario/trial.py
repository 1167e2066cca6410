"""A trial of tasks and limits before the first tick: what they write, against what they promise.

A task promises e_dot = J v - rate. It is tried at its start and at two seeded configurations
nearby, with the loops closed, along a random v that keeps them closed: central differences of e
along v at one time must be J v, and over time at one configuration -rate. Without such a
derivative, only the declaration is tried: ``joint_space`` (J is the identity), ``asks_velocity`` (e
is zero), and e and rate always zero (J v itself is the error).

A limit with a clearance promises that its rows are dampers: G v is how fast the clearance shrinks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import FrozenInstanceError, dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.qp import Row, names_of
from coopqp.base.rank import null_space
from coopqp.base.spec import Array, taken_names, type_name
from coopqp.base.wording import counted, raised, written_in
from coopqp.limit import Clearance, Limit, LimitRows, Tighten
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.marker import markers_fault
from coopqp.model.state import State
from coopqp.plant import Plant
from coopqp.signal import Moment
from coopqp.task import Evaluate, Part, Task, TaskRows, evaluate_all

#: How far the configurations nearby are, as the standard deviation of a joint [rad or m].
NEARBY = 0.03
#: The same for those that are asked where a task disagrees nearby: it may start where it is
#: singular, as where an axis points against its goal, and rows hold other promises there.
FARTHER = 0.3
#: Newton steps that close the loops there; they converge quadratically.
CLOSING = 5
#: Loop error that they may leave [m, rad].
CLOSED = 1e-6
WIDENED = "widens the bounds; tighten them by np.maximum(rows.lb, ...), np.minimum(rows.ub, ...)"

#: When the reference is looked at, as shares of its time; away from where motion laws have kinks,
#: and with digits enough that no tick of a plan is met, at each of which its reference has one.
SHARES = (0.2134567, 0.4312345)
#: Step of the differences, in v's length [rad or m] and in time [s].
STEP = 1e-6
#: An error that no goal of arms has, whose differences are lost in rounding [m, rad].
FAR = 1e4
#: What derivatives may differ by: a share of their size, and of one unit per second.
RELATIVE, ABSOLUTE = 1e-3, 1e-5


Made = TypeVar("Made")


@dataclass(frozen=True)
class _Nearby:
    """A configuration with the loops closed, and a motion through it."""

    here: State
    ahead: State  # by half a difference
    behind: State
    v: Array  # along the loops, of length 1, shape (n,); zero where nothing can move


class Places:
    """Where tasks and limits are tried: the start of a chain and configurations near it."""

    def __init__(self, chain: ClosedChain, like: Places | None = None) -> None:
        self.start = State(chain)
        self.nearby: tuple[_Nearby, ...] = like.nearby if like else self._around(NEARBY)

    @cached_property
    def farther(self) -> tuple[_Nearby, ...]:
        """As many that are farther away."""
        return self._around(FARTHER)

    def _around(self, spread: float) -> tuple[_Nearby, ...]:
        rng = np.random.default_rng(0)
        return tuple(_nearby(self.start, rng, spread) for _ in SHARES)


def _nearby(start: State, rng: np.random.Generator, spread: float) -> _Nearby:
    chain, n = start.chain, start.chain.n
    way = rng.standard_normal(n)
    for nearer in (1.0, 0.5, 0.25, 0.0):  # where the loops cannot be closed, go less far
        here = State(chain, start.q + nearer * spread * way)
        here.close_loops(CLOSING)
        if np.abs(here.closed_error).max(initial=0.0) < CLOSED:
            break
    free = null_space(here.J_loop)
    v = free @ rng.standard_normal(free.shape[1])
    v /= max(float(np.linalg.norm(v)), STEP)
    return _Nearby(here, State(chain, here.q + STEP * v), State(chain, here.q - STEP * v), v)


def try_task(task: Task, places: Places, duration: float) -> None:
    """CoopqpError: the task cannot be bound, raises, or does not write what it must."""
    with blamed(task):
        start = places.start
        names = task.rows(start.chain)
        _check_list("rows", names, str, "names, such as ('z',)")
        _check_parts(names, task.parts(start.chain))
        columns = 6 * start.chain.holding if task.of_forces else start.chain.n
        look = _Look(task, names, _function(task.bind(start)), columns)
        look.at(start, start.t)
        for t in (0.0, duration):
            _check_marks(task.marks(Moment(t)))
        end = min(task.end, duration) or duration
        times = [start.t + share * end for share in SHARES]
        rows = [look.at(place.here, t) for place, t in zip(places.nearby, times, strict=True)]
        if task.joint_space or task.asks_velocity:
            for each in rows:
                _check_declared(task, names, each)
        elif not task.of_forces and any(r.e.any() or r.rate.any() for r in rows):
            for i, t in enumerate(times):
                if look.disagreement(places.nearby[i], t) and (
                    wrong := look.disagreement(places.farther[i], t)
                ):
                    raise look.too_far(places.farther[i], t) or _PromiseError(wrong)


def _check_parts(names: Sequence[str], parts: Sequence[Part]) -> None:
    count = sum(part.rows for part in parts)
    if count != len(names) or not names:
        raise _PromiseError(f"rows() names {counted(len(names), 'row')}, parts() has {count}")
    _check_names("rows", names)
    _check_names("parts", [part.name for part in parts])
    if wrong := [part.tolerance for part in parts if not part.tolerance > 0.0]:
        raise _PromiseError(f"parts(): found a tolerance of {wrong[0]}, needs more than 0")


def _check_list(method: str, found: Any, of: type, what: str) -> None:
    """Refuse a text, whose letters are texts as well, and one thing where several belong."""
    one = isinstance(found, str) or not isinstance(found, Sequence)
    if one or not all(isinstance(each, of) for each in found):
        raise _PromiseError(f"{method}() gives {found!r:.60}, needs a tuple of {what}")


def _function(found: Made) -> Made:
    if not callable(found):
        raise _PromiseError(f"bind() gives {found!r:.60}, needs to return the function inside it")
    return found


def _check_names(method: str, names: Sequence[str]) -> None:
    for _, taken in taken_names(names):
        raise _PromiseError(f"{method}(): {taken}; give each one of its own")


class _Look:
    """A task's rows at a state and a time; refuses what is not finite."""

    def __init__(self, task: Task, names: Sequence[str], evaluate: Evaluate, n: int) -> None:
        self.names, self._evaluate = names, evaluate
        self._J = np.eye(n) if task.joint_space else np.zeros((len(names), n))

    def at(self, state: State, t: float) -> TaskRows:
        k = len(self.names)
        rows = TaskRows(np.zeros(k), self._J.copy(), np.zeros(k))
        before, state.t = state.t, t
        try:
            evaluate_all([(self._evaluate, rows)], state)
        finally:
            state.t = before
        for key in ("e", "J", "rate"):
            _check_finite(key, self.names, getattr(rows, key), state.chain)
        return rows

    def disagreement(self, place: _Nearby, t: float) -> str:
        """The row in which e_dot is farthest from J v - rate; empty where they agree."""
        rows = self.at(place.here, t)
        moved = self.at(place.ahead, t).e - self.at(place.behind, t).e
        passed = self.at(place.here, t + STEP).e - self.at(place.here, t - STEP).e
        return _disagreement(
            self.names, "J v", rows.J @ place.v, "e", moved / (2.0 * STEP)
        ) or _disagreement(self.names, "rate", rows.rate, "e", -passed / (2.0 * STEP))

    def too_far(self, place: _Nearby, t: float) -> InvalidValueError | None:
        """What to say where errors are so large that differences of them are lost in rounding."""
        e = np.abs(self.at(place.here, t).e)
        if not e.max() > FAR:
            return None
        words = "farther than arms reach; look at the size of the goal"
        row = self.names[int(e.argmax())]
        return InvalidValueError(f"row {row}: is {e.max():.3g} off, {words}")


def _disagreement(
    names: Sequence[str], what: str, promised: Array, of: str, measured: Array
) -> str:
    """The row in which a rate is farthest from what finite differences say; empty where none is."""
    allowed = RELATIVE * (np.abs(promised) + np.abs(measured)) + ABSOLUTE
    deviation = np.abs(promised - measured) - allowed
    if (deviation <= 0.0).all():
        return ""
    row = int(np.argmax(deviation))
    return (
        f"row {names[row]}: {what} is {promised[row]:.4g}, finite differences of {of} say "
        f"{measured[row]:.4g}"
    )


def _check_declared(task: Task, names: Sequence[str], rows: TaskRows) -> None:
    J, e = rows.J, rows.e
    if not task.joint_space:
        for row in np.flatnonzero(e)[:1].tolist():
            words = "but a task that asks_velocity has e = 0"
            raise _PromiseError(f"row {names[row]}: e is {e[row]:.4g}, {words}")
        return
    if len(J) != J.shape[1]:
        raise _PromiseError(f"joint_space needs a row a joint, {J.shape[1]}; found {len(J)}")
    wrong = (np.diag(np.diag(J) != 0.0) != J).any(axis=1)
    if wrong.any():
        words = "joint_space needs J to be the identity, or zero where nothing is asked"
        raise _PromiseError(f"row {names[int(np.argmax(wrong))]}: {words}")


def try_limit(limit: Limit, places: Places, dt: float) -> None:
    """CoopqpError: the limit cannot be bound, raises, or does not write what it must."""
    with blamed(limit):
        start, chain = places.start, places.start.chain
        _check_list("rows", limit.rows(chain), Row, "Rows, (Row(...),)")
        names = names_of(limit.rows(chain))
        _check_names("rows", names)
        tighten = _function(limit.bind(chain, dt))
        _check_marks(limit.marks(0.0))
        for state in (start, *(place.here for place in places.nearby)):
            # Rows that it leaves as they were show as NaN in h; zeros of G need not be written.
            n, p = chain.n, len(names)
            open_, shut = (
                LimitRows(np.full(n, -w), np.full(n, w), np.zeros((p, n)), np.full(p, np.nan))
                for w in (np.inf, 0.0)
            )
            evaluate_all([(tighten, open_), (tighten, shut)], state)
            _check_finite("G", names, open_.G, chain)
            for name, h in zip(names, open_.h, strict=True):
                if not h > -np.inf:
                    raise _PromiseError(f"row {name}: h is {h} or not written, needs a number")
            _check_bounds(chain, open_, shut, inside=state is start and chain.starts_inside)
        if left := limit.clearance(chain):
            for i, place in enumerate(places.nearby):
                if _not_damped(tighten, left, names, place) and (
                    wrong := _not_damped(tighten, left, names, places.farther[i])
                ):
                    raise _PromiseError(wrong)


def _not_damped(tighten: Tighten, left: Clearance, names: Sequence[str], place: _Nearby) -> str:
    """The row whose G v is not how fast its clearance shrinks; of what is far both may be still."""
    n, p = len(place.v), len(names)
    rows = LimitRows(np.full(n, -np.inf), np.full(n, np.inf), np.zeros((p, n)), np.full(p, np.inf))
    evaluate_all([(tighten, rows)], place.here)
    ahead, behind = (np.asarray(left(state), float) for state in (place.ahead, place.behind))
    if ahead.ndim != 1 or len(ahead) > p:
        needs = f"needs a list of at most {counted(p, 'number')}, one a row"
        raise _PromiseError(f"clearance() gives the shape {ahead.shape}, {needs}")
    G = rows.G[: len(ahead)]
    shrinks = (behind - ahead) / (2.0 * STEP)
    both = G.any(axis=1) & (shrinks != 0.0) & np.isfinite(shrinks)
    shrinks[~both] = 0.0
    return _disagreement(names, "G v", G @ place.v * both, "clearance()", shrinks)


def _check_finite(key: str, names: Sequence[str], values: Array, chain: ClosedChain) -> None:
    """Refuse a column, or a matrix with a column a joint, that is not finite."""
    finite = np.isfinite(values)
    if finite.all():
        return
    row, *column = first = np.argwhere(~finite)[0].tolist()
    what = f"{key} of {chain.joint_names[column[0]]}" if column else key
    found = values[tuple(first)]
    raise _PromiseError(f"row {names[row]}: {what} is {found}, needs a finite number")


def _check_marks(marks: object) -> None:
    if wrong := markers_fault(marks):
        raise _PromiseError(f"marks() gives {wrong}")


def _check_bounds(chain: ClosedChain, open_: LimitRows, shut: LimitRows, *, inside: bool) -> None:
    lb, ub = open_.lb, open_.ub
    checks = {
        "needs a number or -inf below, a number or inf above": (lb < np.inf) & (ub > -np.inf),
        WIDENED: (shut.lb >= 0.0) & (shut.ub <= 0.0),
        "leaves no velocity at a start inside the limits": (lb <= ub) | (not inside),
    }
    for wrong, holds in checks.items():
        if not holds.all():
            i = int(np.argmin(holds))
            raise _PromiseError(
                f"joint {chain.joint_names[i]}: {lb[i]:.4g} <= v <= {ub[i]:.4g}: {wrong}"
            )


class _PromiseError(Exception):
    """A promise that a plug-in does not keep."""


@contextmanager
def blamed(plugin: Task | Limit | Plant, method: str = "bind") -> Iterator[None]:
    """Raise what goes wrong in a plug-in with its file and line; its own CoopqpError as it is."""
    file = written_in(plugin, method)
    try:
        with np.errstate(all="ignore"):  # what is not finite is reported anyway
            yield
    except KeyboardInterrupt:
        raise
    except CoopqpError as error:
        if error.keys:
            error.at(type_name(type(plugin)))
        raise
    except _PromiseError as error:
        raise InvalidValueError(f"{file}: {error}") from None
    except FrozenInstanceError as error:
        words = "rows are written in place: rows.e[:] = ..."
        raise InvalidValueError(f"{raised(error, file)}; {words}") from error
    except BaseException as error:
        raise InvalidValueError(raised(error, file)) from error
