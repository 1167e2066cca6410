"""Blocks of code on pages, and what their pages say of them.

A comment right above a block says what is special about it; readers of the source see it:

    <!-- not run: needs a cluster -->          it is parsed, but nobody runs it
    <!-- run by tests.pages: 20 s -->          not in the suite, but by python -m tests.pages
    <!-- needs: pandas -->                     the same, and only where that is installed
    <!-- file: out/my.yaml -->                 its text is that of a file, for the blocks after it
    <!-- run first: robot = ... -->            Python that the block needs and readers do not

A block of text is what the block before it prints. Here, too, a comment says what is special:

    <!-- not run: a list of files -->          nothing prints it
    <!-- printed by: coopqp list -->           this does, not the block before it
    <!-- differs: 2.5e-12, which is rounding -->   these numbers may be others
"""

from __future__ import annotations

import re
import shlex
import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).parents[2]

MARKS = ("not run", "run by tests.pages", "needs", "file", "run first")
MARKS_OF_TEXT = ("not run", "run by tests.pages", "printed by", "differs")
BLOCK = re.compile(
    r"(?P<marks>(?:^ *<!--(?:(?!-->).)*-->\n+)*)"
    r"^(?P<indent> *)(?P<fence>`{3,})(?P<language>[^\n`]*)\n(?P<code>.*?)^(?P=indent)(?P=fence)$",
    re.MULTILINE | re.DOTALL,
)
MARK = re.compile(r"<!-- *(.*?): *(.*?) *-->", re.DOTALL)
SPAN = re.compile(r"`((?:\.venv/bin/)?coopqp [^`\n]+)`")
#: Between commands on a line, and words before one.
ENDS, BEFORE = {";", "&&", "||", "|", "&", "(", ")"}, {"do", "then", "time", "srun", "!"}
#: What shells put in place of a word.
VARIABLE = re.compile(r"\$\{?\w+\}?|\$\(.*?\)")
#: The number of what is sent elsewhere, as in 2>&1.
STREAM = re.compile(r"(?<=\s)\d(?=>)")


@dataclass(frozen=True)
class Block:
    """A block of code.

    Attributes:
        place: page and line.
        language: as it says; empty if it does not.
        code: without its indent.
        marks: what is said of it, by kind of mark.
    """

    place: str
    language: str
    code: str
    marks: dict[str, str] = field(default_factory=dict)

    @property
    def runs(self) -> bool:
        """Whether it is run at all."""
        return "not run" not in self.marks

    @property
    def at_once(self) -> bool:
        """Whether it is run in the suite."""
        return self.runs and not {"run by tests.pages", "needs"} & set(self.marks)

    @property
    def lacks(self) -> str:
        """What it needs and is not installed."""
        needed = self.marks.get("needs", "")
        return needed if needed and find_spec(needed) is None else ""

    @property
    def is_output(self) -> bool:
        """Whether it is what the block before it prints."""
        return self.language == "text" and self.runs and "printed by" not in self.marks


def pages() -> dict[str, Path]:
    """Every page that people write, by its name."""
    docs = ROOT / "docs"
    found = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *docs.glob("*.md")]
    found += docs.glob("plugins/*.md")
    return {path.relative_to(ROOT).as_posix(): path for path in sorted(found)}


def blocks(name: str, text: str) -> Iterator[Block]:
    """The blocks of a page, but for directives of Sphinx.

    Args:
        name: of the page.
        text: of the page.
    """
    for found in BLOCK.finditer(text):
        if found["language"].startswith("{"):
            continue
        line = text.count("\n", 0, found.start("fence")) + 1
        marks = dict(MARK.findall(found["marks"]))
        code = textwrap.dedent(found["code"])
        yield Block(f"{name}:{line}", found["language"].strip(), code, marks)


def with_outputs(found: Iterable[Block]) -> Iterator[tuple[Block, Block | None]]:
    """Every block but outputs, each with the block that is its output.

    Raises:
        AssertionError: a block of text is not below one that prints something.
    """
    before: Block | None = None
    for block in [*found, None]:
        if block is None or not block.is_output:
            if before:
                yield before, None
            before = block
        else:
            prints = before and before.runs and before.language in ("python", "sh")
            assert prints, f"{block.place}: nothing prints this; mark it 'not run', or 'printed by'"
            yield before, block
            before = None


def spans(text: str) -> Iterator[str]:
    """Commands of coopqp in running text."""
    yield from SPAN.findall(BLOCK.sub("", text))


def commands(code: str) -> Iterator[list[str]]:
    """The words of each command in a shell's code, with 1 for what the shell would fill in."""
    for line in code.replace("\\\n", " ").splitlines():
        lexer = shlex.shlex(
            STREAM.sub("", VARIABLE.sub("1", line)), posix=True, punctuation_chars=True
        )
        lexer.commenters, lexer.whitespace_split = "#", True
        words: list[str] = []
        for word in [*lexer, ";"]:
            if word not in ENDS:
                words.append(word)
                continue
            if words := _without_settings(words):
                yield words
            words = []


def _without_settings(words: list[str]) -> list[str]:
    """A command without what sets variables before it, or only says when it runs."""
    while words and (words[0] in BEFORE or re.fullmatch(r"\w+=.*", words[0])):
        words = words[1:]
    return words[: next((i for i, w in enumerate(words) if set(w) <= set("<>&")), len(words))]
