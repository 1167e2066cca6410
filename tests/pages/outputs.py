"""What pages say that a block prints, against what it prints."""

from __future__ import annotations

import re

from .blocks import Block

NUMBER = re.compile(r"[-+]?\b\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def check_output(block: Block, printed: str) -> None:
    """See whether a page shows what was printed: the same words, wherever lines are broken.

    A page may leave out what stands before and after, and where it has a word ``...``. Numbers that
    its mark ``differs`` names may be any.

    Args:
        block: of text.
        printed: by the block before it.

    Raises:
        AssertionError: it does not.
    """
    named = set(NUMBER.findall(block.marks.get("differs", "")))
    missing = named - set(NUMBER.findall(block.code))
    assert not missing, f"{block.place}: the mark names {missing}, which are not in the block"
    words = r"\s+".join(_pattern(word, named) for word in block.code.split())
    found = re.search(rf"(?<!\S){words}(?!\S)", printed)
    assert found, f"{block.place}: the page has\n{block.code}\nbut this was printed\n{printed}"


def _pattern(word: str, named: set[str]) -> str:
    if word == "...":
        return r"[\s\S]*?"
    parts, at = [], 0
    for number in NUMBER.finditer(word):
        parts.append(re.escape(word[at : number.start()]))
        parts.append(NUMBER.pattern if number[0] in named else re.escape(number[0]))
        at = number.end()
    return "".join(parts) + re.escape(word[at:])
