"""Links and joints that are no tree, each refused with its line."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

from coopqp.base.errors import InvalidValueError
from coopqp.robot_files.urdf import read_urdf


def links(*names: str) -> str:
    return "".join(f'<link name="{name}"/>\n' for name in names)


def joint(name: str, parent: str, child: str, *, kind: str = "fixed", inside: str = "") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>\n'


@pytest.mark.parametrize(
    ("parts", "line", "words"),
    [
        (links("a", "b") + joint("j", "a", "x"), 4, "<child> of joint j: unknown link 'x'"),
        (links("a", "b") + joint("j", "x", "b"), 4, "<parent> of joint j: unknown link 'x'"),
        (links("a", "b"), 3, '<link name="b">: is the child of no joint, as is link a;'),
        (
            links("a", "b", "c") + joint("j", "a", "c") + joint("k", "b", "c"),
            6,
            "<child> of joint k: link c is the child of joint j already",
        ),
        (
            links("r", "a", "b") + joint("j", "a", "b") + joint("k", "b", "a"),
            5,
            "<joint name=\"j\">: link 'b' moves itself: the joints from it on go round",
        ),
        (
            links("a") + joint("j", "a", "a"),
            2,
            '<link name="a">: every link is the child of a joint',
        ),
        (links("a", ""), 3, "<link>: needs name"),
        (links("a", "b") + joint("", "a", "b"), 4, "<joint>: needs name"),
        (
            links("a", "b") + joint("j", "a", "b", kind="x"),
            4,
            "<joint name=\"j\"> type: unknown type 'x'",
        ),
        (
            links("a", "b") + joint("j", "a", "b", inside='<safety_controller soft="1"/>'),
            4,
            '<joint name="j">: is not a robot that can be read: joint safety: no k_velocity',
        ),
    ],
)
def test_what_is_no_tree_is_refused_with_its_line(
    tmp_path: Path, parts: str, line: int, words: str
) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="r">\n{parts}</robot>\n')
    with pytest.raises(InvalidValueError) as caught:
        read_urdf(path)
    assert str(caught.value).startswith(f"{path}:{line}: {words}")


def test_a_long_chain_is_looked_at_in_no_time(tmp_path: Path) -> None:
    """Pinocchio dies of it, and a look at every link from every link would take minutes."""
    names = [f"l{i}" for i in range(12_000)]
    for count in (12_000, 501):
        text = links(*names[:count])
        text += "".join(joint(f"to {b}", a, b) for a, b in pairwise(names[:count]))
        path = tmp_path / "robot.urdf"
        path.write_text(f'<robot name="r">\n{text}</robot>\n')
        if count > 501:
            with pytest.raises(InvalidValueError, match="more than 500 joints are between link"):
                read_urdf(path)
    assert read_urdf(path).model.njoints == 1
