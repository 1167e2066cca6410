"""Docstrings and signatures as autodoc shows them."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from sphinx import addnodes

from coopqp_site.signatures import ANNOTATED, without_notes

#: Before and after napoleon, which takes what an attribute says before a colon for its type.
EARLY, LATE = 400, 600


class Attributes:
    """Keeps docstrings of attributes as they are."""

    def __init__(self) -> None:
        self._written: list[str] = []

    def keep(self, app: Any, what: str, name: str, value: Any, options: Any, lines: Any) -> None:
        """Before napoleon."""
        self._written = list(lines)

    def restore(self, app: Any, what: str, name: str, value: Any, options: Any, lines: Any) -> None:
        """After it; and let |v| be a norm, not a substitution."""
        if what == "attribute":
            lines[:] = self._written
        lines[:] = map(escaped, lines)


def escaped(line: str) -> str:
    """A line of reStructuredText in which bars are bars."""
    parts = line.split("``")  # code in every second
    parts[::2] = (part.replace("|", "\\|") for part in parts[::2])
    return "``".join(parts)


def short(
    app: Any, what: str, name: str, value: Any, options: Any, takes: Any, gives: Any
) -> tuple[Any, Any]:
    """A signature without what only the reader of files has to know of a type."""
    return takes and without_notes(takes), gives and without_notes(gives)


def short_types(app: Any, domain: str, kind: str, content: nodes.Element) -> None:
    """The same for the types of attributes."""
    for node in content.parent.findall(addnodes.desc_annotation):
        if ANNOTATED.search(words := node.astext()):
            node.clear()
            node += nodes.Text(without_notes(words))
