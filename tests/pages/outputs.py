"""What pages say that a block prints, against what it prints."""

from __future__ import annotations

import re

from .blocks import Block

NUMBER = re.compile(r"[-+]?\b\d+(?:\.\d+)?(?:e[-+]?\d+)?")


#: A line across a table, as long as it may be.
RULE = re.compile("[─━]{3,}")


def check_output(block: Block, printed: str) -> None:
    """See whether a page shows what was printed: the same words, however far apart.

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
    words = r"\s+".join(_pattern(word, named) for word in RULE.sub("───", block.code).split())
    found = re.search(rf"(?<!\S){words}(?!\S)", RULE.sub("───", printed))
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
