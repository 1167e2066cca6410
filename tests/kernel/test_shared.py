"""What Python and the kernel share is said once, in Python."""

from __future__ import annotations

from .shared import HEADER, header


def test_the_header_is_made_from_python() -> None:
    """If not: ``python -m tests.kernel.shared``, then compile the kernel again."""
    assert HEADER.read_text(encoding="utf-8") == header()
