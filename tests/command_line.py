"""The command line, without a process of its own."""

from __future__ import annotations

from click.testing import CliRunner, Result

from coopqp.cli import main


def typed(*words: object) -> Result:
    """What ``coopqp WORDS`` prints, and its exit code."""
    return CliRunner().invoke(main, [str(word) for word in words], catch_exceptions=False)
