"""Who may use the page: its own address, and what was allowed."""

from __future__ import annotations

import re

import pytest

from coopqp.base.errors import InvalidValueError
from coopqp.viewer.gate import checked_origins, may_enter, own_names

OWN = own_names("127.0.0.1")


@pytest.mark.parametrize(
    ("host", "origin", "enters"),
    [
        ("127.0.0.1:8080", None, True),
        ("localhost:8080", "http://localhost:8080", True),
        ("[::1]:8080", "http://[::1]:8080", True),
        ("192.168.1.7:8080", "http://192.168.1.7:8080", True),  # with --host 0.0.0.0
        ("localhost:9000", "http://localhost:9000", True),  # a port that is forwarded
        ("localhost:8080", "http://localhost:3000", False),
        ("localhost:8080", "http://127.0.0.1:8080", False),
        ("localhost:8080", "http://evil.example", False),
        ("localhost:8080", "null", False),
        ("localhost:8080", "", False),
        ("localhost:8080", "http://[", False),
        ("evil.example:8080", "http://evil.example:8080", False),  # DNS rebinding
        ("evil.example:8080", None, False),
        ("localhost.evil.example", "http://localhost.evil.example", False),
        ("127.0.0.1.evil.example:8080", None, False),
        ("", None, False),
        ("[", None, False),
        ("lab.example", "https://lab.example", True),
        ("127.0.0.1:8080", "https://lab.example", True),
        ("lab.example", "https://evil.example", False),
    ],
)
def test_who_enters(host: str, origin: str | None, enters: bool) -> None:
    origins = [] if origin is None else [origin]
    assert may_enter([host], origins, OWN, checked_origins(["https://lab.example/"])) is enters


def test_a_header_that_is_there_twice_is_refused() -> None:
    assert not may_enter(["localhost"] * 2, [], OWN, ())
    assert not may_enter([], [], OWN, ())
    assert not may_enter(["localhost"], ["http://localhost"] * 2, OWN, ())


@pytest.mark.parametrize(
    "given",
    ["", "*", "lab.example", "ftp://a", "https://", "http://a/b", "http://a b", "http://a:99999"],
)
def test_what_is_no_origin_is_refused(given: str) -> None:
    with pytest.raises(InvalidValueError, match=re.escape(f"--allow-origin: found '{given}', ")):
        checked_origins([given])
