"""Every block of code in README, CONTRIBUTING and docs/: it can be read, and what is quick runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from pages.blocks import Block, blocks, commands, pages, spans, with_outputs
from pages.checks import check_block, check_command
from pages.stage import Page, stage

PAGES = pages()


@pytest.mark.parametrize("name", PAGES)
def test_every_block_is_what_it_says_and_runs(name: str, tmp_path: Path) -> None:
    text, page = PAGES[name].read_text(encoding="utf-8"), Page(name, whole=False)
    with stage(tmp_path):
        for block, shown in with_outputs(blocks(name, text)):
            for either in filter(None, (block, shown)):
                check_block(either)
            page.run(block, shown)
        for span in spans(text):
            for words in commands(span):
                check_command(words, name)


@pytest.mark.parametrize(
    ("language", "code", "said"),
    [
        ("sh", "coopqp compre point_on_point", "has no command 'compre'"),
        ("sh", "coopqp compare point_on_point --outt x", "--outt"),
        ("sh", "coopqp run point_on_point --solver daqp", "--controller"),
        ("sh", "make everything", "make has no"),
        ("sh", "pip install 'coopqp[robbots]'", "no extra robbots"),
        ("sh", "python -m tests.fuz", "no module tests.fuz"),
        ("sh", "python benchmarks/no.py", "no file benchmarks/no.py"),
        ("text", "coopqp list", "belong into a block of sh"),
        ("", "coopqp list", "is none of"),
    ],
)
def test_a_block_that_is_wrong_is_found_out(
    language: str, code: str, said: str, tmp_path: Path
) -> None:
    with stage(tmp_path), pytest.raises(AssertionError, match=said):
        check_block(Block("page.md:1", language, code))


def test_marks_stand_above_their_block() -> None:
    text = "<!-- not run: needs a cluster -->\n```sh\nsrun coopqp list\n```\n\n```text\nx\n```\n"
    first, second = blocks("page.md", text)
    assert first.marks == {"not run": "needs a cluster"}
    assert not first.runs
    assert (second.place, second.marks) == ("page.md:6", {})
    assert list(commands(first.code)) == [["coopqp", "list"]]
