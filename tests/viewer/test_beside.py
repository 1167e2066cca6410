"""Processes beside the loop: the newest counts, nobody waits, an end is seen."""

from __future__ import annotations

import time

import pytest

from coopqp.viewer.worker import Peer, Worker


def waits(line: Peer) -> None:
    """Send back what comes; after a pause of 50 ms, as a slow one does."""
    for thing in line.messages():
        time.sleep(0.05)
        line.send(thing)


def never(line: Peer) -> None:
    """Take one message, and no other."""
    next(line.messages())
    time.sleep(60.0)


def broken(line: Peer) -> None:
    """End at once."""


def test_a_slow_process_gets_the_newest() -> None:
    beside, sent, back, number = Worker(waits), list[int](), list[int](), 0
    list(beside.received(20.0))  # it is there
    while len(sent) < 4:
        if beside.send((number, bytes(20_000))):
            sent.append(number)
        back += [thing[0] for thing in beside.received()]
        number += 1
        time.sleep(0.001)
    beside.end()
    assert number > 2 * len(sent)  # most were outdated before it was ready
    assert back == sent[: len(back)]
    assert len(back) >= len(sent) - 1


@pytest.mark.full
def test_a_process_that_takes_nothing_holds_nothing_up() -> None:
    beside = Worker(never)
    list(beside.received(20.0))
    assert beside.send(bytes(20_000))
    assert not any(beside.send(bytes(10**7)) for _ in range(100))  # a pipe would be full by then
    assert not list(beside.received())
    beside.end()


def test_an_end_is_seen() -> None:
    beside = Worker(broken)
    with pytest.raises(EOFError):
        list(beside.received(20.0))
    beside.end()
