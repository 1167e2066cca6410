"""A version is said in one place, and told of in the changelog."""

from __future__ import annotations

import re
from pathlib import Path

import coopqp

ROOT = Path(__file__).resolve().parents[2]


def test_changelog_and_citation_are_of_this_version() -> None:
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    told = re.findall(r"^## (\S+)", changelog, re.MULTILINE)
    assert coopqp.__version__ in [name for name in told if name != "Unreleased"][:1]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^version: (.*)$", citation, re.MULTILINE) == [coopqp.__version__]
