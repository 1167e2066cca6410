"""YAML files with the line of every value, so that an error can name its place.

ruamel.yaml splits the text into events; what they mean is decided here, by YAML 1.2's core schema
and nothing beyond it. A file is then mappings, lists, texts, numbers, booleans and null, however
it is written, and its size is known before it is built: an alias counts as all that it stands for.
"""

from __future__ import annotations

import io
import json
import math
import re
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from ruamel.yaml import YAML, events
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from coopqp.base.errors import Fault, ScenarioError, UnreadableFileError
from coopqp.base.reading import read_text
from coopqp.base.wording import Location, dotted

MAX_BYTES = 1 << 20  # of a file; reading this much takes seconds
MAX_VALUES = 20_000  # in a file, aliases written out
DEEPEST = 40  # values inside values
LONGEST = 60  # characters of a number
#: Sizes between which numbers lie, or 0: beyond them squares leave what floats can hold.
SMALLEST, LARGEST = 1e-30, 1e20

_INT = re.compile(r"[-+]?(0b[01_]+|0o[0-7_]+|0x[0-9a-fA-F_]+|[0-9][0-9_]*)")
_FLOAT = re.compile(
    r"[-+]?([0-9][0-9_]*\.?[0-9_]*|\.[0-9][0-9_]*)([eE][-+]?[0-9]+)?"
    r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
)
_NULLS = ("", "~", "null", "Null", "NULL")
_BOOLEANS = {"true": True, "True": True, "TRUE": True,
             "false": False, "False": False, "FALSE": False}  # fmt: skip
_TAGS = {bool: "bool", int: "int", float: "float", type(None): "null"}
_STANDARD = "tag:yaml.org,2002:"
MERGE = "<<"


@dataclass(frozen=True)
class _Node:
    """A value, and by key or index the line and node of what is inside."""

    value: Any
    inside: dict[str | int, tuple[int, _Node]] = field(default_factory=dict)

    @cached_property
    def size(self) -> int:
        return 1 + sum(node.size for _, node in self.inside.values())


class Wrong(NamedTuple):
    """Something that is wrong with a file: the place it names, and from there whose line counts."""

    place: Location
    message: str
    inside: Location = ()


class MisplacedError(Exception):
    """All that a check has found wrong, for who knows the file (:meth:`YamlFile.lines`)."""

    def __init__(self, found: Sequence[Wrong]) -> None:
        super().__init__(found)
        self.found = found


@dataclass(frozen=True)
class YamlFile:
    """A mapping read from a file, of plain dicts, lists, strings, numbers, booleans and None."""

    path: Path
    text: str
    data: dict[str, Any]
    _root: _Node

    @property
    def folder(self) -> Path:
        """Where relative paths begin: its own folder, or another that it names."""
        own = self.data.get("folder")
        return self.path.parent / own if isinstance(own, str) else self.path.parent

    def place(self, location: Location, inside: Location = ()) -> str:
        """``file:line: key.path`` of a value, or of the nearest mapping that holds it."""
        node, line = self._root, 1
        for key in (*location, *inside):
            if key not in node.inside:
                break
            line, node = node.inside[key]
        where = f"{self.path}:{line}"
        return f"{where}: {dotted(location)}" if location else where

    def refused(self, found: Iterable[Wrong]) -> ScenarioError:
        """All that checks have found, each of it once and with its line."""
        faults = (Fault(self.place(one.place, one.inside), one.message) for one in found)
        return ScenarioError(list(dict.fromkeys(faults)))

    @contextmanager
    def lines(self) -> Iterator[None]:
        """Give all that checks below find its line: they yield places, and do not know the file."""
        try:
            yield
        except MisplacedError as error:
            raise self.refused(error.found) from None

    def changed(self, data: dict[str, Any]) -> YamlFile:
        """What the file would be with other data; places are those of this file."""
        return replace(self, data=data, text=json.dumps(data) + "\n")


def as_yaml(data: dict[str, Any]) -> str:
    """A mapping as YAML for people: its own order, short values in a line."""
    stream, writer = io.StringIO(), YAML(typ="safe", pure=True)
    writer.default_flow_style, writer.width = None, 100
    writer.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    writer.dump(data, stream)
    return stream.getvalue()


def with_keys(text: str, keys: dict[str, Any]) -> str:
    """A file's text with other values of some keys at its end, None for none; or else JSON."""
    data = {**parsed(Path(), text).data, **keys}
    data = {key: value for key, value in data.items() if value is not None or key not in keys}
    kept, gone = "", False
    for line in text.splitlines(True):
        if line[:1].strip() and line[0] != "#":
            gone = line.partition(":")[0] in keys
        kept += "" if gone else line
    added = (f"{key}: {json.dumps(data[key])}\n" for key in keys if key in data)
    return as_read("".join([kept.rstrip("\n"), "\n", *added]), data)


def as_read(text: str, data: dict[str, Any]) -> str:
    """The text if it is read as this mapping, else the mapping as JSON."""
    with suppress(ScenarioError):
        if parsed(Path(), text).data == data:
            return text
    return json.dumps(data, indent=2) + "\n"


#: Keys whose values are paths, of robots, obstacles, way-points, plans and what was sent.
FILE_KEYS = {"path", "mesh", "file", "feed_file", "plan"}


def files_in(value: Any) -> Iterator[Any]:
    """What names another file, such as that of the robot, or asks for one."""
    if isinstance(value, dict):
        yield from (value[key] for key in FILE_KEYS & value.keys())
        value = list(value.values())
    for inside in value if isinstance(value, list) else ():
        yield from files_in(inside)


def has_files(value: Any) -> bool:
    """Whether something in a file, such as its robot or an obstacle, is given by another file."""
    return any(True for _ in files_in(value))


def read_yaml(path: Path) -> YamlFile:
    """Read a YAML mapping; ScenarioError with the line of what is wrong."""
    try:
        text = read_text(path, MAX_BYTES)
    except UnreadableFileError as error:
        raise _refused(error.place, error.why) from None
    return parsed(path, text)


def parsed(path: Path, text: str) -> YamlFile:
    """The same from what a file holds."""
    builder = _Builder(path, text)
    try:
        root = builder.document()
    except MarkedYAMLError as error:
        what = " ".join(str(error.problem or error.context).split())
        mark = error.problem_mark or error.context_mark
        line = builder.line_at(mark.index) if mark else builder.line
        raise _refused(f"{path}:{line}", f"not YAML: {what}") from None
    except YAMLError as error:
        line = builder.line_at(getattr(error, "position", 0))
        what = getattr(error, "reason", " ".join(str(error).split()))
        raise _refused(f"{path}:{line}", f"not YAML: {what}") from None
    except (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError):
        # ruamel.yaml stumbles over some texts without a word of its own.
        raise _refused(f"{path}:{builder.line}", "not YAML from here on") from None
    if root is None or root.value is None:
        raise _refused(path, "the file is empty")
    if not isinstance(root.value, dict):
        raise _refused(
            f"{path}:1", "needs a mapping of keys such as 'robot:', found something else"
        )
    return YamlFile(path, text, root.value, root)


def _refused(place: object, message: str) -> ScenarioError:
    return ScenarioError([Fault(str(place), message)])


class _Builder:
    """From a file's events to its values."""

    def __init__(self, path: Path, text: str) -> None:
        self._path, self.line = path, 1
        # Lines as editors number them; YAML breaks lines at more characters than they do.
        self._starts = [found.end() for found in re.finditer(r"\r\n?|\n", text)]
        self._events = self._numbered(YAML(typ="safe", pure=True).parse(text))
        self._anchors: dict[str, _Node] = {}
        self._values = 0

    def line_at(self, index: int) -> int:
        return bisect_right(self._starts, index) + 1

    def document(self) -> _Node | None:
        root = None
        for event in self._events:
            if isinstance(
                event, events.StreamStartEvent | events.StreamEndEvent | events.DocumentEndEvent
            ):
                continue
            if root is not None:
                raise self._fault(event, "not YAML: a second document begins; needs one alone")
            if not isinstance(event, events.DocumentStartEvent):
                root = self._node(event, DEEPEST)
        return root

    def _numbered(self, found: Iterator[Any]) -> Iterator[Any]:
        for event in found:
            self.line = self.line_at(event.start_mark.index)
            yield event

    def _fault(self, event: Any, message: str) -> ScenarioError:
        return _refused(f"{self._path}:{self.line_at(event.start_mark.index)}", message)

    def _node(self, event: Any, deeper: int) -> _Node:
        if isinstance(event, events.AliasEvent):
            if event.anchor not in self._anchors:
                raise self._fault(event, f"alias '*{event.anchor}' has no anchor before it")
            known = self._anchors[event.anchor]
            self._count(event, known.size)
            return known
        if deeper == 0:
            raise self._fault(event, f"values inside values are more than {DEEPEST} deep")
        self._count(event, 1)
        if isinstance(event, events.ScalarEvent):
            node = _Node(self._scalar(event))
        else:
            is_map = isinstance(event, events.MappingStartEvent)
            # What has another tag is not to be read as the mapping or list that it looks like.
            if event.tag not in (None, "!", _STANDARD + ("map" if is_map else "seq")):
                words = f"tag '{_short(event.tag)}' is not read here; leave it out"
                raise self._fault(event, words)
            node = (self._mapping if is_map else self._list)(deeper - 1)
        if event.anchor is not None:
            self._anchors[event.anchor] = node
        return node

    def _count(self, event: Any, values: int) -> None:
        self._values += values
        if self._values > MAX_VALUES:
            words = f"the file has more than {MAX_VALUES} values, aliases written out"
            raise self._fault(event, words)

    def _list(self, deeper: int) -> _Node:
        inside: dict[str | int, tuple[int, _Node]] = {}
        for event in self._events:
            if isinstance(event, events.SequenceEndEvent):
                break
            inside[len(inside)] = (self.line_at(event.start_mark.index), self._node(event, deeper))
        return _Node([node.value for _, node in inside.values()], inside)

    def _mapping(self, deeper: int) -> _Node:
        inside: dict[str | int, tuple[int, _Node]] = {}
        merged: dict[str | int, tuple[int, _Node]] = {}
        for event in self._events:
            if isinstance(event, events.MappingEndEvent):
                break
            if not isinstance(event, events.ScalarEvent):
                raise self._fault(event, "needs a plain word as a key, found something else")
            key, line = self._text(event), self.line_at(event.start_mark.index)
            if key in inside:
                raise self._fault(event, f"key '{key}' is given twice")
            after = next(self._events)
            node = self._node(after, deeper)
            if key == MERGE and not event.style:
                merged = {**self._merged(after, node), **merged}
            else:
                inside[key] = (line, node)
        inside |= {key: found for key, found in merged.items() if key not in inside}
        return _Node({key: node.value for key, (_, node) in inside.items()}, inside)

    def _merged(self, event: Any, node: _Node) -> dict[str | int, tuple[int, _Node]]:
        """What ``<<: *alias`` brings in: of several mappings the first counts."""
        parts = [node]
        if isinstance(node.value, list):
            parts = [part for _, part in node.inside.values()]
        found: dict[str | int, tuple[int, _Node]] = {}
        for part in parts:
            if not isinstance(part.value, dict):
                raise self._fault(event, "'<<' needs a mapping, or a list of them")
            found = {**part.inside, **found}
        return found

    def _text(self, event: Any) -> str:
        text: str = event.value
        if any("\ud800" <= letter <= "\udfff" for letter in text):
            raise self._fault(event, "the text has half a character (a lone surrogate)")
        return text

    def _scalar(self, event: Any) -> Any:
        text, tag = self._text(event), event.tag
        if tag in ("!", _STANDARD + "str") or (tag is None and event.style):
            return text
        value = self._plain(event, text)
        if tag is None:
            return value
        found = _TAGS.get(type(value), "str")
        if (found, tag) == ("int", _STANDARD + "float"):
            return float(value)
        if _STANDARD + found != tag:
            words = f"tag '{_short(tag)}' does not fit '{text[:40]}'; leave it out"
            raise self._fault(event, words)
        return value

    def _plain(self, event: Any, text: str) -> Any:
        if text in _NULLS:
            return None
        if text in _BOOLEANS:
            return _BOOLEANS[text]
        if not (_INT.fullmatch(text) or _FLOAT.fullmatch(text)):
            return text
        if len(text) > LONGEST:
            raise self._fault(event, f"found {text[:20]}..., a number of {len(text)} characters")
        value = _number(text)
        if value and math.isfinite(value) and not SMALLEST <= abs(value) <= LARGEST:
            words = f"found {text}; needs 0, or a number of {SMALLEST:g} to {LARGEST:g} in size"
            raise self._fault(event, words)
        return value


def _number(text: str) -> int | float:
    digits = text.replace("_", "").lower()
    if not _INT.fullmatch(text):
        return float(digits.replace(".inf", "inf").replace(".nan", "nan"))
    return int(digits, 0 if digits.lstrip("+-")[:2] in ("0b", "0o", "0x") else 10)


def _short(tag: str) -> str:
    return tag.replace(_STANDARD, "!!")[:40]
