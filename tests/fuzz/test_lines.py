"""The judge of the fuzzer: which lines a refusal may name, and which not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from fuzz import trees
from fuzz.lines import Mutated, wrong_line
from fuzz.trees import Tree

OLD = """\
robot:
  urdf:
    path: r.urdf
    arms:
      right: r3
      left: l3
start:
  right:
    - 0.1
    - 0.2
tasks:
  - pose:
      goal:
        position:
          - 0
          - 0
          - 1
  - twist: {}
dt: 0.01
"""
XML = """\
<robot name="r">
<link name="a"/>
<link name="b"/>
<joint name="j">
<parent link="a"/>
<child link="b"/>
</joint>
</robot>
"""
TABLE = "controller,tick,q\nqp,0,1\nqp,1,2\nqp,2,3\n"


def right(old: str, new: str, read: Callable[[str], Tree], name: str = "s.yaml") -> set[int]:
    """The lines that may be named."""
    mutated = Mutated(Path(name), old, new, read)
    return {line for line in range(1, new.count("\n") + 2) if mutated.is_right(line)}


@pytest.mark.parametrize(
    ("old", "new", "lines"),
    [
        ("    - 0.2", "    - x", {7, 8, 10}),  # the number, its list and that's mapping
        ("    - 0.1\n", "", {7, 8}),  # what is gone: what held it
        ("path: r.urdf", "path: /", {2, 3, 7, 8, 9, 10, *range(11, 19)}),  # all that has joints
        ("          - 1\n", "          - x\n", {12, 13, 14, 17}),  # and the task
        ("  - twist: {}", "  - twist: {x: r3}", {4, 5, 18}),  # and who is called so
        ("dt: 0.01", "dt: 1", {1, 19, *range(11, 19)}),  # what is checked against dt
        ("  - twist: {}\n", "  - twist: [}\n", {18}),  # where the reader gives up
        ("    arms:\n", "    arms: [\n", {4, 5, 6}),
    ],
)
def test_lines_of_a_scenario(old: str, new: str, lines: set[int]) -> None:
    assert old in OLD
    assert right(OLD, OLD.replace(old, new, 1), trees.of_yaml) == lines


@pytest.mark.parametrize(
    ("old", "new", "lines"),
    [
        ('link="a"', 'link="x"', {2, 4, 5}),  # and the link that nobody moves now
        ('<link name="b"/>\n', "", {1, 5}),  # what held it, and who needs it
        ('<child link="b"/>', '<child link="b">', {6, 7}),
    ],
)
def test_lines_of_a_robot(old: str, new: str, lines: set[int]) -> None:
    found = right(XML, XML.replace(old, new), trees.of_xml)
    assert lines <= found
    assert len(found) <= 4


def test_lines_of_a_table() -> None:
    assert right(TABLE, TABLE.replace("qp,1,2", "qp,1,x"), trees.of_csv) == {1, 3, 4}
    assert right(TABLE, TABLE.replace("qp,1,2\n", ""), trees.of_csv) == {1, 2, 3, 4}


def test_what_is_said_is_judged() -> None:
    mutated = Mutated(Path("s.yaml"), OLD, OLD.replace("- 0.2", "- x"), trees.of_yaml)
    assert not wrong_line(["s.yaml:10: start.right[1]: found x"], mutated)
    assert not wrong_line(["s.yaml:10: one", "s.yaml:8: two"], mutated)
    assert wrong_line(["s.yaml:10: one", "s.yaml:9: two"], mutated) == "wrong line"
    assert wrong_line(["s.yaml: found x"], mutated) == "no line"
    assert wrong_line(["r.urdf:3: found y"], mutated) == "other line"
    assert not wrong_line(["s.yaml: cannot be read: is a folder"], mutated)
