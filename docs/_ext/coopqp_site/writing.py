"""Pages that are made while the site is built, and the text in them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]

FENCED = re.compile(r"^( *)(`{3,}).*?^\1\2`*$", re.MULTILINE | re.DOTALL)
ROLE = re.compile(r":\w+:`~?([^`]*)`")


class Made:
    """A folder of pages that nobody writes.

    Args:
        folder: of the pages.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._kept: set[Path] = set()

    def keep(self, name: str, text: str) -> None:
        """Write a page, if it is another than before: what is old is not built again."""
        page = self.folder / name
        self._kept.add(page)
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.parent.mkdir(parents=True, exist_ok=True)
            page.write_text(text, encoding="utf-8")

    def finish(self) -> None:
        """Remove what has not been written this time."""
        for page in set(self.folder.rglob("*.*")) - self._kept:
            if page.is_file():
                page.unlink()


def prose(text: str) -> Iterator[tuple[str, bool]]:
    """Parts of a page in order, and whether they are prose: not blocks of code."""
    end = 0
    for fence in FENCED.finditer(text):
        yield text[end : fence.start()], True
        yield fence[0], False
        end = fence.end()
    yield text[end:], True


def plain(docstring: str | None) -> str:
    """A docstring as Markdown: roles such as :func: become code; indented formulas are that."""
    return ROLE.sub(r"`\1`", (docstring or "").strip())


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; empty if it has no rows."""
    lines = [_row(row) for row in rows]
    if not lines:
        return ""
    return "\n".join([_row(head), _row(["---"] * len(head)), *lines]) + "\n"


def _row(cells: Sequence[str]) -> str:
    joined = (" ".join(cell.split()).replace("|", "\\|") for cell in cells)
    return "| " + " | ".join(joined) + " |"
