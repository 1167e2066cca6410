"""Processes beside the loop: the newest counts, nobody waits, an end is seen."""

from __future__ import annotations

import time

import pytest

from coopqp.viewer.worker import Peer, Worker


def slow(line: Peer, pause: float) -> None:
    """Send back what comes, slowly."""
    for thing in line.messages():
        time.sleep(pause)
        line.send(thing)


def broken(line: Peer) -> None:
    """End at once."""


def test_a_slow_process_gets_the_newest_and_holds_nothing_up() -> None:
    beside = Worker(slow, 0.05)
    list(beside.received(20.0))  # it is there
    longest, sent, back = 0.0, [], []
    end = time.perf_counter() + 0.5
    number = 0
    while time.perf_counter() < end:
        before = time.perf_counter()
        if beside.send((number, bytes(20_000))):
            sent.append(number)
        longest = max(longest, time.perf_counter() - before)
        back += [thing[0] for thing in beside.received()]
        number += 1
        time.sleep(0.001)
    beside.end()
    assert 2 <= len(sent) <= 11  # of hundreds
    assert back == sent[: len(back)]
    assert len(back) >= len(sent) - 1
    assert longest < 0.05  # it has never waited for the other to be done


def test_an_end_is_seen() -> None:
    beside = Worker(broken)
    with pytest.raises(EOFError):
        list(beside.received(20.0))
    beside.end()
