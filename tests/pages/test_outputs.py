"""What a page says that a block prints is compared with what it prints."""

from __future__ import annotations

from pathlib import Path

import pytest

from pages.blocks import Block, blocks, with_outputs
from pages.outputs import check_output
from pages.stage import Page, stage

PRINTED = "before\nqp:  Ends 12.0 mm off,\n  at the limit; took 17 us\nafter\n"


def text(code: str, **marks: str) -> Block:
    return Block("page.md:1", "text", code, marks)


@pytest.mark.parametrize(
    ("code", "marks"),
    [
        ("qp: Ends 12.0 mm\noff, at the limit;\n", {}),
        ("before\n...\nafter\n", {}),
        ("at the limit; took 35 us", {"differs": "35, a time"}),
    ],
)
def test_the_same_words_are_the_same_output(code: str, marks: dict[str, str]) -> None:
    check_output(text(code, **marks), PRINTED)


@pytest.mark.parametrize(
    ("code", "marks"),
    [
        ("Ends 12.5 mm off", {}),
        ("Ends mm off", {}),
        ("nds 12.0 mm off", {}),
        ("after ... before", {}),
        ("at the limit; took 35 us", {}),
        ("Ends 12.5 mm off, at the limit; took 35 us", {"differs": "35, a time"}),
        ("Ends 12.0 mm off", {"differs": "35, a time"}),
    ],
)
def test_other_words_and_numbers_are_found_out(code: str, marks: dict[str, str]) -> None:
    with pytest.raises(AssertionError, match=r"page\.md:1"):
        check_output(text(code, **marks), PRINTED)


def test_a_page_is_held_to_what_python_and_commands_print(tmp_path: Path) -> None:
    page = Page("page", whole=False)
    python = Block("page.md:1", "python", "print(6 * 7)\n")
    command = Block("page.md:5", "sh", "coopqp list limits  # all of them\n")
    with stage(tmp_path):
        page.run(python, text("42"))
        page.run(command, text("joint_position"))
        page.run(text("joint_position", **{"printed by": "coopqp list limits"}), None)
        with pytest.raises(AssertionError, match="42"):
            page.run(python, text("43"))
        with pytest.raises(AssertionError, match="joint_position"):
            page.run(command, text("no_limit"))


@pytest.mark.parametrize(
    "above", ["", "```yaml\ndt: 0.01\n```\n", "<!-- not run: slow -->\n```sh\nls\n```\n"]
)
def test_a_text_that_nothing_prints_has_to_say_so(above: str) -> None:
    with pytest.raises(AssertionError, match="nothing prints this"):
        list(with_outputs(blocks("page.md", f"{above}\n```text\n42\n```\n")))
    said = f"{above}\n<!-- not run: a number -->\n```text\n42\n```\n"
    assert all(shown is None for _, shown in with_outputs(blocks("page.md", said)))


def test_what_needs_another_package_is_left_out_where_that_is_not() -> None:
    block = Block("page.md:1", "python", "import no_such_package\n", {"needs": "no_such_package"})
    assert block.lacks == "no_such_package"
    Page("page", whole=True).run(block, None)
    assert not Block("page.md:1", "python", "", {"needs": "numpy"}).lacks
