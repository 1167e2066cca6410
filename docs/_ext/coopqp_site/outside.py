"""Links of pages that leave ``docs/``, such as to a scenario: each file gets a page that shows it.

The pages are written for readers of the repository, so that their links are relative to the files.
While the site is built a link to a file outside of ``docs/`` goes to a page under ``source/``, and
one to a folder to a list of what is in it. Nothing is changed in the pages themselves; a link to
what does not exist is left as it is, and the build refuses it.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from coopqp_site.writing import ROOT, Made, prose

DOCS = "docs"
#: Folder of the pages that are made, in docs/.
FILES = "source"

LINK = re.compile(r"(?<=\]\()([^)\s#:]+)(#[^)\s]*)?(?=\))")
LANGUAGES = {".py": "python", ".yaml": "yaml", ".hpp": "cpp", ".sh": "bash", ".toml": "toml"}


def targets(text: str, here: str) -> Iterator[str]:
    """Paths in the repository that a page's links name.

    Args:
        text: of the page.
        here: its path in the repository.
    """
    for part, is_prose in prose(text):
        for link in LINK.finditer(part) if is_prose else ():
            yield _resolved(link[1], here)


def relinked(text: str, here: str, page: str) -> str:
    """The text of a page with links that hold on the site.

    Args:
        text: of the page.
        here: path in the repository that its links are relative to.
        page: its own path on the site.
    """
    folder = posixpath.dirname(page) or "."

    def moved(link: re.Match[str]) -> str:
        shown = _page_of(_resolved(link[1], here))
        return link[0] if shown is None else posixpath.relpath(shown, folder) + (link[2] or "")

    return "".join(LINK.sub(moved, p) if is_prose else p for p, is_prose in prose(text))


def _resolved(link: str, here: str) -> str:
    return posixpath.normpath(posixpath.join(posixpath.dirname(here), link))


def _page_of(target: str) -> str | None:
    """Path, in docs/, of the page that shows a path of the repository; None if there is none."""
    if target.startswith(f"{DOCS}/") and not (ROOT / target).is_dir():
        return target.removeprefix(f"{DOCS}/")
    if target.startswith("..") or not (ROOT / target).exists():
        return None
    return f"{FILES}/{target.removesuffix('.md')}.md"


def _shown(target: str) -> str:
    """Text of the page of a file or folder outside of docs/, with links as the repository's."""
    path = ROOT / target
    orphan = "---\norphan: true\n---\n\n"
    if path.is_dir():
        inside = sorted(p.relative_to(ROOT).as_posix() for p in path.rglob("*") if _listed(p))
        parent = posixpath.dirname(target) or "."
        links = "\n".join(f"* [{p}]({posixpath.relpath(p, parent)})" for p in inside)
        return f"{orphan}# `{target}`\n\n{links}\n"
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return orphan + text
    fence = "`" * 6
    return f"{orphan}# `{target}`\n\n{fence}{LANGUAGES.get(path.suffix, 'text')}\n{text}\n{fence}\n"


def _listed(path: Path) -> bool:
    """Whether a list of files shows it."""
    return path.suffix in (".py", ".yaml", ".md") and not path.name.startswith("_")


def write(app: Any) -> None:
    """Write the pages of everything outside of docs/ that pages link to, and these, and so on."""
    docs, made = Path(app.srcdir), Made(Path(app.srcdir) / FILES)
    pages = (page for page in docs.rglob("*.md") if made.folder not in page.parents)
    looked_at = [(f"{DOCS}/{p.relative_to(docs).as_posix()}", p.read_text("utf-8")) for p in pages]
    known: set[str] = set()
    while looked_at:
        here, text = looked_at.pop()
        for target in set(targets(text, here)) - known:
            page = _page_of(target)
            if page and page.startswith(f"{FILES}/"):
                known.add(target)
                found = _shown(target)
                made.keep(page.removeprefix(f"{FILES}/"), found)
                looked_at.append((target, found))
    made.finish()


def read(app: Any, name: str, source: list[str]) -> None:
    """Let a page's links hold on the site."""
    if Path(app.env.doc2path(name)).suffix == ".md":
        inside = name.startswith(f"{FILES}/")
        here = name.removeprefix(f"{FILES}/") if inside else f"{DOCS}/{name}"
        source[0] = relinked(source[0], here, name)
