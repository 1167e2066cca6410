"""Links of README, CONTRIBUTING and docs/: what they lead to in the repository is there."""

from __future__ import annotations

import posixpath
import re
from functools import cache
from pathlib import Path

import pytest
from coopqp_site.pages import written
from coopqp_site.writing import prose

from pages.blocks import ROOT, pages

PAGES = pages()
LINK = re.compile(r"\]\(<?([^)\s>]+)>?\)")
OUTSIDE = re.compile(r"[a-z]+:")
#: Pages of the reference, which are made while the site is built.
MADE = cache(lambda: {f"docs/reference/{name}": text for name, text in written().items()})


def anchors(text: str) -> set[str]:
    """What headings can be linked by, as GitHub and the site make it of their words."""
    found: set[str] = set()
    for part, is_prose in prose(text):
        for title in re.findall(r"^#+ +(.*?) *$", part, re.MULTILINE) if is_prose else ():
            words = re.sub(r"\[(.*?)\]\(.*?\)", r"\1", title).replace("`", "")
            anchor = re.sub(r"[^\w\- ]", "", words.lower()).replace(" ", "-")
            again = (f"{anchor}-{i}" for i in range(1, 99))
            found.add(anchor if anchor not in found else next(x for x in again if x not in found))
    return found


def broken(name: str, text: str) -> list[str]:
    """Links of a page, within the repository, that lead nowhere."""
    parts = (part for part, is_prose in prose(text) if is_prose)
    links = [link for part in parts for link in LINK.findall(part) if not OUTSIDE.match(link)]
    found = {link: link.partition("#")[::2] for link in links}
    here = anchors(text)
    return [
        link
        for link, (path, anchor) in found.items()
        if not (leads_somewhere(name, path, anchor) if path else anchor in here)
    ]


def leads_somewhere(name: str, path: str, anchor: str) -> bool:
    """Whether a file is there, and the heading in it."""
    target = posixpath.normpath(posixpath.join(posixpath.dirname(name), path))
    if target.startswith("docs/reference/"):
        return target in MADE() and (not anchor or anchor in anchors(MADE()[target]))
    file = ROOT / target
    if not file.exists() or not anchor:
        return file.exists()
    return target.endswith(".md") and anchor in anchors(file.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", [*PAGES, "CHANGELOG.md"])
def test_links_lead_somewhere(name: str) -> None:
    path: Path = ROOT / name
    assert not broken(name, path.read_text(encoding="utf-8"))


def test_links_that_lead_nowhere_are_found() -> None:
    text = "# On `x`, again\n[a](#on-x-again) [b](limits.md#bodies) [c](../README.md) [d](no.md)\n"
    text += "[e](#on) [f](limits.md#no) [g](https://example.org/no) ![h](no.png)\n"
    text += "```text\n[i](none.md)\n```\n"
    assert broken("docs/page.md", text) == ["no.md", "#on", "limits.md#no", "no.png"]


def test_headings_of_the_same_words_are_numbered() -> None:
    assert anchors("# A\n## A\n### a: b?\n") == {"a", "a-1", "a-b"}
