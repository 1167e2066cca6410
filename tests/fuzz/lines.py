"""Whether a refusal names the right line: one at what has changed in the file, or that it broke.

The file is compared with what it was before it was mutated (:mod:`fuzz.trees`). A refusal may name

- a line of what has changed, its key's line included; where something is gone, those of what held
  it;
- the first line of what holds it: of the mapping whose key it is, or of the list, and of the task,
  limit, controller, phase or row of a table that it is a part of;
- where a name stands twice, the other one;
- another value that no longer agrees with it, but only under the keys that depend on it (AGREE);
- where the text as a whole cannot be read any more, the first line that has changed, or a later
  one, since parsers only notice there.

Of another file than the one that has changed a refusal may only speak where it says a word that
has changed.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from . import trees
from .trees import Change, Tree

#: Top-level keys of a scenario, and those whose values may no longer agree with it.
AGREE: dict[str, tuple[str, ...]] = {}
#: Lists of a scenario whose items are told of as a whole.
PARTS = ("tasks", "limits", "controllers", "phases", "secondary")


@dataclass(frozen=True)
class Mutated:
    """A file before and after.

    Attributes:
        path: of it.
        old, new: what it held, and holds.
        read: a text as a tree.
    """

    path: Path
    old: str
    new: str
    read: Callable[[str], Tree]

    def changes(self) -> list[Change] | None:
        """What has changed; None where the text cannot be read any more."""
        try:
            return trees.changes(self.read(self.old), self.read(self.new))
        except Exception:  # noqa: BLE001 - libraries stumble in many ways
            return None


def wrong_lines(said: Sequence[str], mutated: Mutated) -> str:
    """The first of the lines said that names no line, or not the right one; empty if all do."""
    found = mutated.changes()
    for line in said:
        named = [int(n) for n in re.findall(rf"{re.escape(mutated.path.name)}:(\d+)", line)]
        if not named:
            others = re.findall(r"[\w.]+:\d+: ", line)
            if not others: return f"no line: {line}"
            words = frozenset().union(*(c.words for c in found or ()))
            if not any(w in line for w in words if len(w)>1 or w.isdigit()):
                return f"other file: {line}"
            continue
        if found is None:
            if any(n < trees.first_difference(mutated.old, mutated.new) for n in named):
                return f"before: {line}"
        elif not all(any(_is_at(n, c) for c in found) for n in named):
            return f"wrong line {[ (c.path,c.first,c.last,c.above) for c in found]}: {line}"
    return ""


def _is_at(line: int, change: Change) -> bool:
    at = change.first <= line <= change.last or line in change.above[-1:]
    if at: return True
    if len(change.path) > 2 and change.path[0] in PARTS and line == change.above[2]:
        return True
    return bool(change.above == () and line == 1)
