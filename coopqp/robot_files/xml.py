"""Bounded reading of XML files.

What pinocchio reads is written anew from what was checked here, so no parser behind it meets
entities, odd encodings or words where numbers belong.
"""

import os
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.parsers import expat

from coopqp.base.errors import InvalidValueError, UnreadableFileError
from coopqp.base.reading import read_bytes

MAX_BYTES = 32 << 20  # of a file
MAX_ELEMENTS = 100_000  # in a file
MAX_DEPTH = 150  # elements inside elements
ALIKE = 0.75  # similarity from which one name is another misspelt: "axes" and "axis" have 0.75


class Element(ET.Element):
    """An element that knows its place."""

    place: str = ""


def place_of(element: ET.Element) -> str:
    """``FILE:LINE: <joint name="elbow">``, without a place where it is not from a file."""
    name = element.get("name")
    tag = f'<{element.tag} name="{name}">' if name else f"<{element.tag}>"
    place = getattr(element, "place", "")
    return f"{place}: {tag}" if place else tag


def fault(element: ET.Element, message: str, where: str = "") -> InvalidValueError:
    """What is wrong with an element, ``where`` in it, such as an attribute."""
    return InvalidValueError(f"{place_of(element)}{where and f' {where}'}: {message}")


def read_xml(path: Path, roots: Sequence[str], kind: str, *, texts: bool = False) -> ET.Element:
    """Read an XML file of a robot; ``roots`` are names that its outermost element may have.

    Messages call the file of this ``kind``; ``texts`` between elements are read if wanted.

    InvalidValueError: no such file, or no such kind of file.
    """
    try:
        content = read_bytes(path, MAX_BYTES)
    except UnreadableFileError as error:
        raise InvalidValueError(str(error)) from None
    element = _Tree(path, kind, texts=texts).parsed(content)
    if element.tag not in roots:
        words = f"starts with <{element.tag}>, needs <{roots[0]}>"
        raise InvalidValueError(f"{path}:1: is not a {kind} file: {words}")
    return element


class _Tree:
    def __init__(self, path: Path, kind: str, *, texts: bool) -> None:
        self._path, self._kind = path, kind
        self._open: list[Element] = []
        self._texts: list[list[str]] = []
        self._root: Element | None = None
        self._count = 0
        self._parser: Any = expat.ParserCreate()
        self._parser.StartElementHandler = self._begin
        self._parser.EndElementHandler = self._end
        self._parser.StartDoctypeDeclHandler = self._doctype
        self._parser.buffer_text = True
        if texts:
            self._parser.CharacterDataHandler = lambda text: self._texts[-1].append(text)

    def parsed(self, content: bytes) -> Element:
        try:
            self._parser.Parse(content, True)
        except expat.ExpatError as error:
            words = expat.ErrorString(error.code)
            raise self._fault(f"is not a {self._kind} file: {words}", error.lineno) from None
        except (LookupError, ValueError) as error:  # of an encoding
            if isinstance(error, InvalidValueError):
                raise
            raise self._fault(f"{error}; save the file in UTF-8") from None
        assert self._root is not None  # XML has an outermost element
        return self._root

    def _fault(self, message: str, line: int | None = None) -> InvalidValueError:
        line = line or self._parser.CurrentLineNumber
        return InvalidValueError(f"{self._path}:{line}: {message}")

    def _begin(self, tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, attributes)
        element.place = f"{self._path}:{self._parser.CurrentLineNumber}"
        self._count += 1
        if self._count > MAX_ELEMENTS:
            raise self._fault(f"has more than {MAX_ELEMENTS} elements")
        if len(self._open) == MAX_DEPTH:
            raise self._fault(f"elements inside elements are more than {MAX_DEPTH} deep")
        if self._open:
            self._open[-1].append(element)
        else:
            self._root = element
        self._open.append(element)
        self._texts.append([])

    def _end(self, tag: str) -> None:
        self._open.pop().text = "".join(self._texts.pop())

    def _doctype(self, *_: Any) -> None:
        raise self._fault("has a DOCTYPE, which is not read; take it out")


def numbers_of(text: str | None, default: str) -> tuple[float, ...]:
    """The numbers of an attribute."""
    return tuple(float(word) for word in (text or default).split())


def missing_meshes(name: str, missing: Sequence[str], count: int) -> tuple[str, ...]:
    """The warning about meshes that were not found, if there are any."""
    if not missing:
        return ()
    shown = ", ".join(missing[:2]) + (", ..." if len(missing) > 2 else "")
    gone = f"{len(missing)} of {count} meshes cannot be found ({shown})"
    return (f"{name}: {gone}; links left without geometry are drawn as capsules",)


def pinocchio_says(error: Exception) -> str:
    """What went wrong, without pinocchio's line numbers."""
    lines = filter(None, map(str.strip, str(error).splitlines()))
    where = ("From file:", "in function:", "at line:")
    words = " ".join(line for line in lines if not line.startswith(where))
    return words.removeprefix("message: ") or type(error).__name__


@contextmanager
def stderr_lines(printed: list[str]) -> Iterator[None]:
    """Collect errors and warnings that parsers in C and C++ would print."""
    with tempfile.TemporaryFile() as file:
        kept = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            for line in file.read().decode("utf-8", "replace").splitlines():
                word, _, text = line.partition(":")
                if word in ("Error", "Warning"):
                    printed.append(text.strip())
