"""The extension: what is done when."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from coopqp_site import mathml, outside
from coopqp_site.docstrings import EARLY, LATE, Attributes, short, short_types
from coopqp_site.pages import written
from coopqp_site.writing import Made


def _write(app: Sphinx) -> None:
    made = Made(Path(app.srcdir) / "reference")
    for name, text in written().items():
        made.keep(name, text)
    made.finish()
    outside.write(app)


def _patterns_that_match(app: Sphinx, name: str, source: list[str]) -> None:
    """Drop patterns of the front page for which there is no page yet."""
    if name == "index":
        lines, folder = source[0].splitlines(), Path(app.srcdir)
        kept = (x for x in lines if not x.endswith("*") or any(folder.glob(f"{x}.md")))
        source[0] = "\n".join(kept)


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the pages before Sphinx looks for them."""
    mathml.setup(app)
    app.connect("builder-inited", _write)
    app.connect("source-read", outside.read)
    app.connect("source-read", _patterns_that_match)
    attributes = Attributes()
    app.connect("autodoc-process-docstring", attributes.keep, priority=EARLY)
    app.connect("autodoc-process-docstring", attributes.restore, priority=LATE)
    app.connect("autodoc-process-signature", short)
    app.connect("object-description-transform", short_types)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
