"""The words for what pydantic finds wrong with values: the same in a file and in Python."""

import json
import re
import traceback
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ValidationError
from pydantic_core import ArgsKwargs, ErrorDetails

from coopqp.base.errors import one_line, short, unknown_name

Location = Sequence[str | int]
"""Keys and indices from the outermost mapping to a value."""

#: Pydantic's words and their replacements, applied one after the other.
REPLACEMENTS = {
    r"^Input should (be )?": "needs ",
    r"^needs a valid (array|list|tuple)": "needs a list",
    r"^needs (an object|a valid dictionary)": "needs a mapping, such as {key: value}",
    r"^needs a valid (number|integer|boolean|string), unable to .*": r"needs a valid \1",
    r"^needs a valid string": "needs a text",
    r"^needs a valid integer": "needs a whole number",
    r"^needs a valid boolean": "needs true or false",
    r"^needs a valid number": "needs a number",
    r"^needs True$": "needs true",
    r"^(Dictionary|List|Tuple) should have (at (?:least|most) \d+) items? after validation, not.*":
        r"needs \2 in it",
    r"^String should have (at (?:least|most) \d+) characters?": r"needs \1 character(s)",
}  # fmt: skip
UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")  # what pydantic calls such keys
MAX_MESSAGE = 300  # characters of what an error says of itself
USERS = "coopqp.scenario.catalog.at_"  # how names of modules begin that lie in users' folders


def dotted(location: Location) -> str:
    """``tasks[0].point_on_plane.normal`` from its parts."""
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{short(part)}"
    return text.removeprefix(".")


def counted(count: int, noun: str) -> str:
    """``1 row``, ``2 rows``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def faults(
    error: ValidationError, data: Any, model: type, instead: Mapping[type, Any] | None = None
) -> list[tuple[Location, str]]:
    """All that pydantic finds wrong, as places in the data and what to do about them.

    ``model`` is the model or dataclass that the data was checked against; ``instead`` gives, of a
    class met on the way, the type whose keys count.
    """
    details = error.errors(include_url=False, include_context=False)
    found = [(detail["type"], *_fault(detail, data, model, instead or {})) for detail in details]
    places = [place for _, place, _ in found]
    meant = _meant(found)
    kept = [
        (place, meant.get(place, words))
        for kind, place, words in found
        if not _follows(kind, place, places) and meant.get(place) != ""
    ]
    return list(_either(dict.fromkeys(kept)))


def message_of(error: BaseException) -> str:
    """What an error says of itself, in one line; empty where it cannot even do that."""
    words = ""
    with suppressed():  # an error may be of a user's class
        words = " ".join(str(error.msg if isinstance(error, SyntaxError) else error).split())
    return one_line(words if len(words) <= MAX_MESSAGE else f"{words[:MAX_MESSAGE]}...")


def raised(error: BaseException, file: str | None = None) -> str:
    """``FILE:LINE: raises ZeroDivisionError: division by zero``, of a file or outside libraries."""
    if file is None:  # who called a library tells more than where in it that ended
        place = place_of(error, lambda name: "site-packages" not in name) or place_of(error)
    else:
        place = place_of(error, lambda name: name == file) or file
    words = message_of(error)
    return f"{place}: raises {type(error).__name__}{f': {words}' if words else ''}"


def place_of(error: BaseException, is_own: Callable[[str], bool] = lambda name: True) -> str:
    """``FILE:LINE`` of what cannot be run, or of the last call in files that count; or empty."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}:{error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    return next((f"{f.filename}:{f.lineno}" for f in reversed(frames) if is_own(f.filename)), "")


@contextmanager
def suppressed() -> Iterator[None]:
    """Go on after whatever a user's code raises, but for Ctrl-C."""
    try:
        yield
    except KeyboardInterrupt:
        raise
    except BaseException:  # noqa: BLE001 - it may raise anything
        return


def by_user(error: BaseException) -> bool:
    """Whether code in a user's folder has raised it, or has called what did."""
    frames = traceback.walk_tb(error.__traceback__)
    return any(str(frame.f_globals.get("__name__")).startswith(USERS) for frame, _ in frames)


def culprit(error: BaseException, plugins: Sequence[tuple[str, object]]) -> str:
    """``task 'lift': FILE:LINE: raises ...``, of the outermost plug-in whose code has raised it.

    Where none has, of one in whose file it was raised: a signal's code lies beside its class.
    """
    called = [frame.f_code for frame, _ in traceback.walk_tb(error.__traceback__)]
    codes = [(words, _codes(type(plugin))) for words, plugin in plugins]
    files = [(words, {code.co_filename for code in own}) for words, own in codes]
    tries = [(code, [words for words, own in codes if code in own]) for code in called]
    tries += [(code, [words for words, own in files if code.co_filename in own]) for code in called]
    for code, named in tries:
        if named:
            return f"{' or '.join(dict.fromkeys(named))}: {raised(error, code.co_filename)}"
    return raised(error)


def written_in(plugin: object, method: str) -> str:
    """The file of a plug-in's method; a class that was typed in has none."""
    return str(getattr(type(plugin), method).__code__.co_filename)


def _codes(cls: type) -> set[types.CodeType]:
    """All code that is written inside a class."""
    found = set[types.CodeType]()
    waiting = [value.__code__ for value in vars(cls).values() if hasattr(value, "__code__")]
    while waiting:
        code = waiting.pop()
        found.add(code)
        waiting += [const for const in code.co_consts if isinstance(const, types.CodeType)]
    return found


def _meant(found: Iterable[tuple[str, tuple[str | int, ...], str]]) -> dict[Location, str]:
    """Words on unknown keys that are missing ones mistyped; on those, which these say, none."""
    meant = dict[Location, str]()
    missing = {place for kind, place, _ in found if kind.startswith("missing")}
    for place in (place for kind, place, _ in found if kind in UNKNOWN):
        keys = [str(key) for *parents, key in missing if (*parents,) == place[:-1]]
        if near := get_close_matches(str(place[-1]), keys, n=1, cutoff=0.5):
            meant |= {place: unknown_name("key", str(place[-1]), near), (*place[:-1], *near): ""}
    return meant


def _follows(kind: str, place: Location, places: Sequence[Location]) -> bool:
    """Whether a list counts as too short, or as no number, only because a value in it is wrong."""
    return kind in ("too_short", "float_type") and any(
        other[: len(place)] == place and len(other) > len(place) for other in places
    )


def _either(kept: Iterable[tuple[Location, str]]) -> Iterator[tuple[Location, str]]:
    """What would do at one place, where that is one or the other."""
    needs: dict[tuple[Location, str], list[str]] = {}
    for place, words in kept:
        found, _, needed = words.partition("; needs ")
        needs.setdefault((place, found), []).append(needed)
    for (place, found), ways in needs.items():
        yield place, "; needs ".join(filter(None, (found, " or ".join(ways))))


def _fault(
    detail: ErrorDetails, data: Any, model: type, instead: Mapping[type, Any]
) -> tuple[tuple[str | int, ...], str]:
    kind, found = detail["type"], shown(detail["input"])
    location = _inside(data, detail["loc"], missing=kind.startswith("missing"))
    if kind in UNKNOWN:
        known = _keys(model, location[:-1], instead)
        return location, unknown_name("key", str(location[-1]), known)
    if kind == "unexpected_positional_argument":
        return (), f"found {found} without a key; needs every value as KEY=VALUE"
    if kind.startswith("missing"):
        needed = detail["loc"][-1]
        if isinstance(needed, int):
            return location, f"found {found}; needs at least {needed + 1} in it"
        there = location and location[-1] == needed
        return location, "is missing" if there else f"needs the key '{needed}'"
    needs = detail["msg"].removeprefix("Value error, ")
    for theirs, ours in REPLACEMENTS.items():
        needs = re.sub(theirs, ours, needs)
    if needs.startswith(("unknown ", "found ", "is empty")):
        return location, needs
    return location, f"found {found}; {needs[0].lower()}{needs[1:]}"


def shown(found: Any) -> str:
    """What was found, short, as a file would say it where it can."""
    if isinstance(found, ArgsKwargs):
        found = found.kwargs or {}
    try:
        text = json.dumps(found, default=plain)
    except (TypeError, ValueError):
        text = repr(found)
    return short(text)


def plain(value: Any) -> Any:
    """Numbers of numpy as JSON has them; TypeError for what is none."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is no number, text, list or dict")


def _inside(data: Any, location: tuple[str | int, ...], *, missing: bool) -> tuple[str | int, ...]:
    """The location without pydantic's own steps, such as which branch of a union failed."""
    kept: list[str | int] = []
    for i, part in enumerate(location):
        last = i == len(location) - 1
        inside = (isinstance(data, dict) and part in data) or (
            isinstance(data, list | tuple) and isinstance(part, int) and part < len(data)
        )
        if inside:
            data = data[part]
        elif not (missing and last and isinstance(data, dict)):
            continue
        kept.append(part)
    return tuple(kept)


def _keys(model: Any, location: Location, instead: Mapping[type, Any]) -> list[str]:
    for part in location:
        has_keys = isinstance(model, type) and (issubclass(model, BaseModel) or is_dataclass(model))
        hints = typing.get_type_hints(model, include_extras=False) if has_keys else {}
        model = _bare(hints.get(str(part), model))
        model = _bare(instead.get(model, model))
    if isinstance(model, type) and issubclass(model, BaseModel):
        return list(model.model_fields)
    return [field.name for field in fields(model)] if is_dataclass(model) else []


def _bare(hint: Any) -> Any:
    """The class inside Optional, Annotated, list and dict."""
    origin = typing.get_origin(hint)
    if origin is Annotated:
        return _bare(typing.get_args(hint)[0])
    if origin in (typing.Union, types.UnionType, list, dict, tuple):
        inside = [_bare(a) for a in typing.get_args(hint) if a not in (type(None), str)]
        return inside[0] if inside else hint
    return hint
