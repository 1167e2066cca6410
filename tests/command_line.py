"""The command line, without a process of its own."""

from __future__ import annotations

from click.testing import CliRunner, Result

from coopqp.cli import main


def typed(*words: object) -> Result:
    """What ``coopqp WORDS`` prints, and its exit code."""
    return CliRunner().invoke(main, [str(word) for word in words], catch_exceptions=False)


def refused(*words: object) -> str:
    """What ``coopqp WORDS`` says where it ends with exit code 2, and without a traceback."""
    result = typed(*words)
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output
    return result.stderr


def refused_in_one_line(*words: object) -> str:
    """The same where that is one line."""
    (line,) = refused(*words).splitlines()
    return line
