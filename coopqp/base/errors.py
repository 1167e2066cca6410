"""Every error that reading and building can raise.

    CoopqpError                    catch this one to catch them all
    ├── InvalidValueError          a value has the wrong shape, sign or size (also a ValueError)
    ├── UnknownNameError           no such task, joint, frame ...; names the nearest ones
    ├── GraspError                 the arms cannot hold the object as asked
    ├── ScenarioError              all faults of one scenario file, each with its line
    ├── UnreadableFileError        a file is missing, too large, a pipe, or not text
    ├── MissingDependencyError     an optional package is not installed (also an ImportError)
    └── InternalError              a fault of coopqp itself, to be reported

Errors belong to the border, where things are read and built. Inside a tick nothing is raised:
what goes wrong there is a :class:`coopqp.solver.Status`.
"""

from __future__ import annotations

import copyreg
import difflib
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from typing_extensions import Self

LONGEST = 60  # characters of what was found
MAX_NAMES = 100  # that are listed where none is near


class CoopqpError(Exception):
    """Base of all errors raised by coopqp; ``keys`` lead to the wrong value, as far as known."""

    keys: tuple[str | int, ...] = ()

    def at(self, *keys: str | int) -> Self:
        """The same error, with its keys continued from farther outside."""
        self.keys = (*keys, *self.keys)
        return self

    def __reduce__(self) -> tuple[object, ...]:
        """Past ``__init__``, which takes other things than the message, from process to process."""
        return copyreg.__newobj__, (type(self), *self.args), vars(self)  # type: ignore[attr-defined]


@contextmanager
def under(*keys: str | int) -> Iterator[None]:
    """Prepend these keys to those of an error."""
    try:
        yield
    except CoopqpError as error:
        error.at(*keys)
        raise


class InvalidValueError(CoopqpError, ValueError):
    """A value has the wrong shape, sign or size."""


class UnknownNameError(CoopqpError):
    """A name that nothing answers to."""

    def __init__(self, kind: str, name: str, known: Iterable[str], where: str = "") -> None:
        self.kind, self.name = kind, name
        super().__init__(f"{where}{unknown_name(kind, name, known)}")


def require_known(
    kind: str, names: Iterable[str], known: Collection[str], where: str = "",
    at: tuple[str | int, ...] | None = None,
) -> None:  # fmt: skip
    """UnknownNameError for the first of the names that is none of the known ones.

    With the keys that lead to the names, ``at``, and its own: the name, or in a list its index.
    """
    keyed = enumerate(names) if isinstance(names, Sequence) else ((name, name) for name in names)
    for key, name in keyed:
        if name not in known:
            error = UnknownNameError(kind, name, known, where)
            raise error if at is None else error.at(*at, key)


class GraspError(CoopqpError):
    """The arms cannot hold the object as asked."""


class MissingDependencyError(CoopqpError, ImportError):
    """An optional package is not installed."""

    def __init__(self, what: str, extra: str = "", *, instructions: str = "") -> None:
        super().__init__(f"{what} needs: " + (instructions or f"pip install 'coopqp[{extra}]'"))


@contextmanager
def needs(what: str, extra: str) -> Iterator[None]:
    """Name the extra where a package is missing that is imported meanwhile."""
    try:
        yield
    except ImportError:
        raise MissingDependencyError(what, extra) from None


class UnreadableFileError(CoopqpError):
    """A file, or a line in it (``place``), that cannot be read, and why."""

    def __init__(self, place: object, why: str) -> None:
        self.place, self.why = str(place), why
        super().__init__(one_line(f"{place}: {why}"))


class InternalError(CoopqpError):
    """Something that nobody foresaw; what was done until then is kept."""


@dataclass(frozen=True)
class Fault:
    """One thing wrong with a file: where it is and what to do about it."""

    place: str
    message: str

    def __str__(self) -> str:
        return one_line(f"{self.place}: {self.message}")


class ScenarioError(CoopqpError):
    """All faults of one scenario file at once."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        self.faults = tuple(faults)
        super().__init__("\n".join(str(fault) for fault in self.faults))


def one_line(text: str) -> str:
    """The text without line breaks or control characters, which names in files may have."""
    joined = "; ".join(text.splitlines())
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in joined)


def short(text: str) -> str:
    """A text of a file, of which no more than the beginning is shown."""
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def unknown_name(kind: str, name: str, known: Iterable[str]) -> str:
    """Sentence for a name that does not exist, with the nearest ones that do."""
    names, shown = sorted(known), short(name)
    near = difflib.get_close_matches(shown, names, n=3, cutoff=0.5)
    if near:
        return f"unknown {kind} '{shown}'; did you mean {' or '.join(repr(n) for n in near)}?"
    listed = ", ".join(names[:MAX_NAMES]) if names else "none"
    more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    return f"unknown {kind} '{shown}'; known: {listed}{more}"
