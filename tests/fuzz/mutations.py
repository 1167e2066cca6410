"""Mutations of text, of values and of structure, by a seeded random number generator."""

from __future__ import annotations

import copy
import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from random import Random
from typing import Any

#: Pieces of text that parsers stumble over.
PIECES = (
    "!!float ", "!!set ", "!!binary ", "!x ", "&a ", "*a", "<<: *a", "<<: ", "- ", "? ", ": ",
    "%YAML 9.9\n", "---\n", "...\n", "\t", "\x00", "\x07", "[", "{", "]", "}", '"', "'", "|", ">",
    "#", "\ufeff", "\u2028", "\N{PILE OF POO}", "\N{ARABIC-INDIC DIGIT THREE}", "[" * 60,
    "{a: " * 60, "1e999", "0x", "-.inf", "~", "\\ud800", "<!DOCTYPE r [<!ENTITY a 'b'>]>", "&a;",
    "&#0;", "<![CDATA[", "<!--", "-->", "</", "/>", '="', "<include file='dual.xml'/>", ",",
    ",,,", "\r", "\n\n", "1_0", "0o8", "=", "nan", "inf",
)  # fmt: skip
#: Values that no key, or few, can have.
VALUES: tuple[Any, ...] = (
    None, True, False, "", "x", "qp", "rigid", "nao_t14", "solve", 0, -0.0, 1, -1, 2, 9, 1e308,
    -1e308, 5e-324, 1e-300, 1e-12, 1e6, 1e9, 1e12, 1e19, 10**25, -(10**30), 0.5, math.inf,
    -math.inf, math.nan, [], {}, [[]], [{}], {"": {}}, [0, 0, 0], [1, 2, 3, 4, 5], [0.0] * 40,
    "\ud800", "\N{PILE OF POO}", "a" * 5000, "\n", "../..", "/dev/zero", "/", ".", "dual.urdf",
    "a\0b", "1e5", "0.1", "right", "left",
)  # fmt: skip
#: Words in the attribute of an XML file.
WORDS = (
    "", " ", "a b c", "nan", "inf -inf 0", "1", "1 2", "1 2 3", "0 0 0", "1 2 3 4", "-1", "1e308",
    "1e-320", "1e9 0 0", "0x10", "1,2,3", "1_0", "true", "false", "zz", "fixed", "floating",
    "continuous", "prismatic", "planar", "ball", "free", "slide", "hinge", "r1", "l2", "base",
    "rl3", "world", "auto", "degree", "../x", "/dev/zero", "\N{PILE OF POO}", "a" * 3000,
    "1 " * 500,
)  # fmt: skip


def text(rng: Random, content: str, other: str) -> str:
    """A text with some of its lines and characters changed, or crossed with another."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        content = rng.choice(_TEXT)(rng, content, other)
    return content


def _at(rng: Random, content: str) -> int:
    return rng.randrange(len(content) + 1)


def _insert(rng: Random, content: str, other: str) -> str:
    at = _at(rng, content)
    return content[:at] + rng.choice(PIECES) + content[at:]


def _cut(rng: Random, content: str, other: str) -> str:
    at = _at(rng, content)
    return content[:at] + content[at + rng.choice((1, 2, 5, 40, 100_000)) :]


def _flip(rng: Random, content: str, other: str) -> str:
    at = _at(rng, content)
    return (
        content[:at]
        + chr(rng.choice((0, 9, 10, 32, 45, 46, 58, 91, 123, 160, 255)))
        + content[at + 1 :]
    )


def _lines(rng: Random, content: str, other: str) -> str:
    lines = content.splitlines(keepends=True) or [""]
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    kind = rng.randrange(5)
    if kind == 0:
        del lines[i]
    elif kind == 1:
        lines.insert(j, lines[i])
    elif kind == 2:
        lines[i], lines[j] = lines[j], lines[i]
    elif kind == 3:
        lines[i] = " " * rng.randrange(6) + lines[i].lstrip()
    else:
        lines[i] = lines[i].replace(" ", "", 1)
    return "".join(lines)


def _cross(rng: Random, content: str, other: str) -> str:
    a, b = _at(rng, content), _at(rng, other)
    return content[:a] + other[b : b + rng.choice((20, 200, 5000))]


_TEXT: tuple[Callable[[Random, str, str], str], ...] = (
    _insert, _insert, _cut, _flip, _lines, _lines, _cross,
)  # fmt: skip


def data(rng: Random, tree: Any, other: Any) -> Any:
    """A copy of plain data with some values, keys or parts changed, or crossed with another's."""
    tree = copy.deepcopy(tree)
    for _ in range(rng.choice((1, 1, 1, 1, 2, 3))):
        holder, key = rng.choice(_places(tree))
        _change(rng, holder, key, _places(tree), _places(other))
    return tree


def _places(tree: Any) -> list[tuple[Any, Any]]:
    """Every value as the mapping or list that holds it and its key."""
    found, waiting = [], [tree]
    while waiting:
        holder = waiting.pop()
        if isinstance(holder, dict | list):
            keys = list(holder) if isinstance(holder, dict) else range(len(holder))
            found += [(holder, key) for key in keys]
            waiting += [holder[key] for key in keys]
    return found or [({"": None}, "")]


def _change(rng: Random, holder: Any, key: Any, own: list[Any], others: list[Any]) -> None:
    value, kind = holder[key], rng.randrange(10)
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if number and kind < 5:
        factor = rng.choice((-1.0, 0.0, 0.1, 10.0, 1e3, 1e6, 1e-6, rng.uniform(-3.0, 3.0)))
        holder[key] = value * factor if kind else value + factor
    elif kind < 6:
        holder[key] = copy.deepcopy(rng.choice(VALUES))
    elif kind == 6:
        del holder[key]
    elif kind == 7:
        where, which = rng.choice(rng.choice((own, others)))
        holder[key] = copy.deepcopy(where[which])
    elif isinstance(holder, list):
        holder[key:key] = [copy.deepcopy(value)] * rng.choice((1, 2, 60))
    else:
        name = rng.choice((f"{key}_", str(key)[:-1], "x", *(str(k) for _, k in own[:20])))
        holder[name] = holder.pop(key) if kind == 8 else copy.deepcopy(value)


def yaml(tree: Any, deep: int) -> str:
    """Plain data as YAML: mappings and lists a line a value down to a depth, then in JSON."""
    return "\n".join(_block(tree, deep)) + "\n"


def _block(value: Any, deep: int) -> list[str]:
    """The lines of a value."""
    if not deep or not isinstance(value, dict | list) or not value:
        return [_flow(value)]
    found = []
    for key in value if isinstance(value, dict) else range(len(value)):
        first, *others = _block(value[key], deep - 1)
        if isinstance(value, list):
            found += [f"- {first}", *(f"  {line}" for line in others)]
        elif others or (deep > 1 and value[key] and isinstance(value[key], dict | list)):
            found += [f"{_flow(str(key))}:", *(f"  {line}" for line in (first, *others))]
        else:
            found.append(f"{_flow(str(key))}: {first}")
    return found


def _flow(value: Any) -> str:
    words = json.dumps(value)
    return words.replace("-Infinity", "-.inf").replace("Infinity", ".inf").replace("NaN", ".nan")


def xml(rng: Random, content: str, other: str) -> str:
    """An XML file with some attributes or elements changed."""
    root = ET.fromstring(content)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        elements = list(root.iter())
        element, parent = rng.choice(elements), rng.choice(elements)
        kind = rng.randrange(8)
        if kind < 4 and element.attrib:
            key = rng.choice(list(element.attrib))
            words = (*WORDS, *(e.get("name", "") for e in elements[:30]))
            element.set(key, rng.choice(words))
            if kind == 3:
                del element.attrib[key]
        elif kind == 4 and len(parent):
            del parent[rng.randrange(len(parent))]
        elif kind == 5 and element is not root:
            parent.insert(rng.randrange(len(parent) + 1), copy.deepcopy(element))
        elif kind == 6:
            element.tag = rng.choice(("x", *(e.tag for e in elements)))
        elif len(parent):
            child = parent[rng.randrange(len(parent))]
            parent[:] = [child] * rng.choice((2, 3, 40))
    return ET.tostring(root, encoding="unicode")
