"""Formulas as MathML, which browsers draw themselves: no script, no fonts, nothing to load."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging

LOGGER = logging.getLogger(__name__)


def _drawn(visitor: Any, node: nodes.Element, *, block: bool) -> None:
    try:
        visitor.body.append(tex2mathml(node.astext(), as_block=block))
    except MathError as error:
        LOGGER.warning("formula: %s", error, location=node)
    raise nodes.SkipNode


def inline(visitor: Any, node: nodes.Element) -> None:
    """A formula in a line."""
    _drawn(visitor, node, block=False)


def block(visitor: Any, node: nodes.Element) -> None:
    """A formula of its own."""
    _drawn(visitor, node, block=True)


def setup(app: Sphinx) -> None:
    """Offer the renderer as ``mathml``."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
