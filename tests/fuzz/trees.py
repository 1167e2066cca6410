"""What a file says, as a tree in which every value knows its lines, and how two of them differ.

Read by ruamel's own composer, by expat and by counting commas: nothing here is coopqp's.
"""

from __future__ import annotations

import json
import re
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any
from xml.parsers import expat

from ruamel.yaml import YAML
from ruamel.yaml.nodes import MappingNode, Node, SequenceNode

Key = str | int
Path = tuple[Key, ...]


@dataclass
class Tree:
    """A value and where it is.

    Attributes:
        kind: of value.
        word: what it is by itself; empty for what only holds others.
        first, last: its lines, from that of its key on.
        inside: by key, or by index where the kind is a list.
        ordered: whether it is a list.
    """

    kind: str
    word: str
    first: int
    last: int
    inside: dict[Key, Tree] = field(default_factory=dict)
    ordered: bool = False

    def walk(self, path: Path = ()) -> Iterator[tuple[Path, Tree]]:
        """It and all that is in it, with their ways."""
        yield path, self
        for key, child in self.inside.items():
            yield from child.walk((*path, key))

    @property
    def lines(self) -> range:
        """From first to last."""
        return range(self.first, self.last + 1)

    @property
    def words(self) -> frozenset[str]:
        """The values in it, without keys."""
        return frozenset(part.word for _, part in self.walk())

    @property
    def keys(self) -> frozenset[str]:
        """The keys in it."""
        return frozenset(str(path[-1]) for path, _ in self.walk() if path)

    @property
    def said(self) -> object:
        """What is compared: all but the lines."""
        return self.kind, self.word, [(key, part.said) for key, part in self.inside.items()]


@dataclass(frozen=True)
class Change:
    """Where a tree is not what it was.

    Attributes:
        path: to what has changed, or to what held what is gone.
        lines: of what has changed; the first of what held what is gone, or of a table the ones
            before and behind it.
        above: first lines of all that holds it, the outermost first.
        words: that were said there and are said there now, with keys that have come or gone.
    """

    path: Path
    lines: range
    above: tuple[int, ...]
    words: frozenset[str]


def changes(old: Tree, new: Tree, path: Path = (), above: tuple[int, ...] = ()) -> list[Change]:
    """Every difference, as deep in the tree as it can be said."""
    if (old.kind, old.word) != (new.kind, new.word):
        return [Change(path, new.lines, above, old.words | new.words)]
    pairs, added, gone = _aligned(old, new)
    inner, found = (*above, new.first), list[Change]()
    for a, b in pairs:
        found += changes(old.inside[a], new.inside[b], (*path, b), inner)
    for key in added:
        part = new.inside[key]
        found.append(Change((*path, key), part.lines, inner, part.words | part.keys | {str(key)}))
    if gone:
        parts = [old.inside[key] for key in gone]
        words = frozenset(map(str, gone)).union(*(part.words | part.keys for part in parts))
        first, last = new.first, new.first
        if new.kind == "table":
            first, last = int(gone[0]), int(gone[0]) + 1
        found.append(Change(path, range(first, last + 1), above, words))
    return found


def _aligned(old: Tree, new: Tree) -> tuple[list[tuple[Key, Key]], list[Key], list[Key]]:
    """Pairs of keys that belong together, those that have come and those that are gone."""
    if not old.ordered:
        both = [(key, key) for key in new.inside if key in old.inside]
        added = [key for key in new.inside if key not in old.inside]
        return both, added, [key for key in old.inside if key not in new.inside]
    a = [part.said for part in old.inside.values()]
    b = [part.said for part in new.inside.values()]
    start = _alike(a, b)
    end = _alike(a[start:][::-1], b[start:][::-1])
    if len(a) == len(b):
        return [(i, i) for i in range(start, len(a) - end)], [], []
    return [], list(range(start, len(b) - end)), list(range(start, len(a) - end))


def _alike(a: list[object], b: list[object]) -> int:
    """How many of the first ones are the same."""
    pairs = enumerate(zip(a, b, strict=False))
    return next((i for i, (x, y) in pairs if x != y), min(len(a), len(b)))


def of_yaml(text: str) -> Tree:
    """The tree of a YAML text.

    Raises:
        YAMLError, and whatever else ruamel stumbles over.
    """
    root = YAML(typ="safe", pure=True).compose(text)
    return Tree("", "", 1, 1) if root is None else _of_node(root, text, 1)


def _line(mark: Any, text: str) -> int:
    """As editors number them; YAML has more line breaks than they."""
    return bisect_left(_breaks(text), mark.index) + 1


@lru_cache(maxsize=4)
def _breaks(text: str) -> list[int]:
    """Where lines end."""
    return [found.start() for found in re.finditer(r"\r\n?|\n", text)]


def _of_node(node: Node, text: str, first: int) -> Tree:
    end = node.end_mark
    last = max(first, _line(end, text) - (end.column == 0))
    if isinstance(node, MappingNode):
        inside: dict[Key, Tree] = {}
        for key, value in node.value:  # of a key given twice both count, the second by its line
            name, line = str(key.value), _line(key.start_mark, text)
            name = f"{name} {line}" if name in inside else name
            inside[name] = _of_node(value, text, line)
        return Tree(str(node.tag), "", first, last, inside)
    if isinstance(node, SequenceNode):
        parts = (_of_node(part, text, _line(part.start_mark, text)) for part in node.value)
        return Tree(str(node.tag), "", first, last, dict(enumerate(parts)), ordered=True)
    return Tree(str(node.tag), str(node.value), first, last)


def of_json(text: str) -> Tree:
    """The tree of a JSON text.

    Raises:
        ValueError: it is none.
    """
    json.loads(text)
    return of_yaml(text)


def of_xml(text: str) -> Tree:
    """The tree of an XML text: of each element its attributes, then its elements.

    Raises:
        expat.ExpatError: it is none.
    """
    parser = expat.ParserCreate()
    root = Tree("file", "", 1, 1, ordered=True)
    open_ = [root]

    def begin(tag: str, attributes: dict[str, str]) -> None:
        line = parser.CurrentLineNumber
        words: dict[Key, Tree] = {k: Tree("word", v, line, line) for k, v in attributes.items()}
        own = Tree("attributes", "", line, line, words)
        element = Tree(tag, "", line, line, {0: own}, ordered=True)
        open_[-1].inside[len(open_[-1].inside)] = element
        open_.append(element)

    def end(_: str) -> None:
        open_.pop().last = parser.CurrentLineNumber

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.Parse(text.encode("utf-8", "surrogatepass"), True)
    return root


def of_lines(text: str) -> Tree:
    """No tree: what is wrong with a mesh may show only where another line needs what has changed.

    Raises:
        ValueError: always.
    """
    raise ValueError(text[:0])


def of_csv(text: str) -> Tree:
    """The tree of a table: its rows, and the cells of each.

    Raises:
        ValueError: it ends inside quotes.
    """
    if text.count('"') % 2:
        raise ValueError("ends inside quotes")
    root = Tree("table", "", 1, 1, ordered=True)
    for number, line in enumerate(text.split("\n"), 1):
        cells = {i: Tree("cell", cell, number, number) for i, cell in enumerate(line.split(","))}
        root.inside[number - 1] = Tree("row", "", number, number, dict(cells), ordered=True)
        root.last = number
    return root


def end_of_sense(text: str, error: Exception) -> int:
    """The last line that a reader looked at before it gave up."""
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    if mark is not None:
        return _line(mark, text)
    return getattr(error, "lineno", None) or len(re.split(r"\r\n?|\n", text))


def first_difference(old: str, new: str) -> int:
    """The first line that is not as it was."""
    a, b = (re.split(r"\r\n?|\n", text) for text in (old, new))
    pairs = enumerate(zip(a, b, strict=False))
    return next((i for i, (x, y) in pairs if x != y), min(len(a), len(b))) + 1
