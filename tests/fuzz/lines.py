"""Whether a refusal names the right line: one at what has changed in the file, or that it broke.

The file is compared with what it was before it was mutated (:mod:`fuzz.trees`). Every line that a
refusal names must be

- **own**: a line of what has changed, its key's line included;
- **holder**: the first line of the mapping or list that what has changed is in, or that what is
  gone was in, and of what that is in; for a number of a vector that of the vector's mapping too;
  for anything in a task, a limit, a controller, a phase or a secondary task the first line of that;
  for anything in the grasp of all arms or in the object the line of that key;
- **namesake**: a line where a name stands that has changed elsewhere, or where the mapping or list
  begins that it is in: it points nowhere now, or two have it; a row of a table with the same
  controller and tick;
- **judged by it**: of a value under a key whose values are checked against the changed one, as
  AGREE has it; in a table the row behind what has changed, which does not follow it any more, and
  where its header has changed the first row of a run;
- **noticed**: where another reader makes no tree of the text either, the lines from the first that
  has changed to that at which this reader gives up; of a mesh to the last, and of one in COLLADA
  the first, if a part is missing.

A refusal that names no line of the file must name one of another file: one that says a word that
has changed in this one; of a robot's file a line of the scenario that is judged by the robot, as
its arms are; of a mesh the line that names it, or where the robot's file does so, that file's name.
Those of WHOLE need no line: they speak of a file as a whole.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from . import trees
from .trees import Change, Tree

#: By a scenario's key the keys whose values are checked against it.
AGREE: dict[str, tuple[str, ...]] = {
    "robot": (
        "start", "start_deg", "start_near", "grasp", "grasps", "weights", "phases", "tasks",
        "secondary", "limits", "plant", "disturbance",
    ),
    "start": ("grasp", "grasps", "limits"),
    "start_deg": ("grasp", "grasps", "limits"),
    "grasp": ("start", "start_deg"),
    "grasps": ("grasps", "start", "start_deg"),
    "object": ("grasp", "grasps", "start", "limits"),
    "dt": ("tasks", "secondary", "phases", "limits", "kappa", "duration", "plant"),
    "duration": ("tasks", "secondary", "dt"),
    "phases": ("secondary", "dt"),
    "plant": ("disturbance",),
    "limits": ("limits",),
    # Of a recorded tick: lists that have as many of something, and the two halves of P.
    "variables": (
        "P", "C", "J", "q_cost", "lower", "upper", "lb_rows", "ub_rows", "answer", "first_answer",
    ),
    "inequality_rows": ("inequalities", "C", "lower", "upper"),
    "equality_rows": ("C", "lower", "upper"),
    "task_rows": ("J", "wanted"),
    "P": ("P",),
}  # fmt: skip
#: Lists of a scenario whose items are told of as a whole.
PARTS = ("tasks", "limits", "controllers", "phases", "secondary")
SLOTS = ("grasp", "object")
MESHES = (".stl", ".obj", ".dae")
#: What is said of a file as a whole.
WHOLE = (
    "cannot be read", "the file is empty", "is larger", "no sensors say where the joints are",
    "has no tick", "unknown controller",  # that was asked for
)  # fmt: skip


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

    @cached_property
    def tree(self) -> Tree | None:
        """What it says now; None where no reader makes a tree of it."""
        return self._read[0]

    @cached_property
    def _read(self) -> tuple[Tree | None, int]:
        """The tree, or None and the line at which its reader gives up."""
        try:
            return self.read(self.new), 0
        except Exception as error:  # noqa: BLE001 - libraries stumble in many ways
            return None, trees.end_of_sense(self.new, error)

    @cached_property
    def changes(self) -> list[Change]:
        """What has changed in the tree."""
        return trees.changes(self.read(self.old), self.tree) if self.tree else []

    @cached_property
    def words(self) -> frozenset[str]:
        """Names that have changed, or whose element has."""
        return frozenset(filter(_is_name, frozenset().union(*map(self._words, self.changes))))

    def _words(self, change: Change) -> frozenset[str]:
        found, part = set(change.words), self.tree
        for key in change.path:
            part = part.inside[key] if part else None
            attributes = part.inside.get(0) if part else None
            names = [attributes.inside.get(key) for key in ("name", "joint1")] if attributes else []
            found |= {name.word for name in names if name}
        return frozenset(found)

    def is_right(self, line: int) -> bool:
        """Whether a refusal may name a line."""
        if self.tree is None:
            first, last = trees.first_difference(self.old, self.new), self._read[1]
            whole = line == 1 and self.path.suffix == ".dae"
            end = len(self.new.rstrip().splitlines())  # where what comes after it is gone
            return whole or min(first, last, end) <= line <= last
        if any(line in _own(change) for change in self.changes):
            return True
        at = [(path, part) for path, part in self.tree.walk() if part.first == line]
        if self.tree.kind == "table":
            starts = any(path[1:] == (1,) and part.word == "0" for path, part in at)
            head = starts and any(c.path[:1] == (0,) for c in self.changes)
            same = any(self._cells(line) == self._cells(k) for c in self.changes for k in c.lines)
            return head or same or any(line - 1 in c.lines for c in self.changes)
        said = {str(word) for path, part in at for word in (*path[-1:], *_direct(part))}
        if self.words & said:
            return True
        if any(self._agree(c.path, path, 2) for c in self.changes for path, _ in at):
            return True  # in a phase
        keys = {path[0] for path, _ in at if path}
        changed = {str(key) for c in self.changes for key in c.path[:1] or c.words}
        return any(keys & set(AGREE.get(key, ())) for key in changed)

    @staticmethod
    def _agree(changed: trees.Path, told: trees.Path, depth: int) -> bool:
        """Whether both are in the same part, where one is checked against the other."""
        if changed[:depth] != told[:depth] or min(len(changed), len(told)) <= depth:
            return False
        return told[depth] in AGREE.get(str(changed[depth]), ())

    def _cells(self, line: int) -> list[str]:
        """The first two words of a row of a table, which no other row has."""
        row = self.tree.inside.get(line - 1) if self.tree else None
        return [part.word for part in row.inside.values()][:2] if row else []

    def is_other(self, words: str) -> bool:
        """Whether a refusal that names another file may do so."""
        if any(re.search(rf"(?<!\w){re.escape(word)}(?!\w)", words) for word in self.words):
            return True
        if self.path.suffix in MESHES and "start in each other" in words:  # it names the bodies
            return True
        line = re.search(r"(\w+\.yaml):(\d+): ", words)
        if line and self.path.suffix in MESHES:
            scenario = (self.path.parent / line[1]).read_text(encoding="utf-8").splitlines()
            at = [i for i, said in enumerate(scenario, 1) if self.path.name in said]
            return int(line[2]) in at if at else self.path.name in words
        key = re.search(r"\.yaml:\d+: (robot: arm|\w+)\b", words)
        judged = (*AGREE["robot"], "robot: arm")
        return key is not None and key[1] in judged and self.path.suffix != ".yaml"


def _direct(part: Tree) -> Iterator[str]:
    """What is said in a value itself, and in its own values."""
    yield part.word
    yield from (inner.word for inner in part.inside.values())


def _is_name(word: str) -> bool:
    return bool(re.search(r"[^\W\d]", word)) and word.lower() not in ("true", "false", "null")


def _own(change: Change) -> Iterator[int]:
    """Its lines, and those of what holds it."""
    yield from change.lines
    yield from change.above[-1:] or (1,)
    if len(change.path) > 1 and isinstance(change.path[-1], int):
        yield from change.above[-2:]
    if len(change.path) > 2 and change.path[0] in PARTS:
        yield change.above[2]
    if len(change.path) > 4 and (change.path[0], change.path[2]) == ("phases", "tasks"):
        yield change.above[4]
    if len(change.path) > 1 and change.path[0] in SLOTS:
        yield change.above[1]


def wrong_line(said: Sequence[str], mutated: Mutated) -> str:
    """What is wrong with the first of the lines said that names no line, or not the right one."""
    for words in said:
        named = re.findall(rf"{re.escape(mutated.path.name)}:(\d+)", words)
        if any(not mutated.is_right(int(line)) for line in named):
            return "wrong line"
        if named or any(whole in words for whole in WHOLE):
            continue
        if not re.search(r"\.\w+:\d+: ", words):
            return "no line"
        if not mutated.is_other(words):
            return "other line"
    return ""
