"""What the loop hands to a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from online_loops import follows, go, simulated

from coopqp.base.errors import CoopqpError

TARGET = {"target": [0.15, 0.01, 0.05]}


class Listens:
    """Keeps what it is told.

    Args:
        fails: the tick at which it raises.
    """

    def __init__(self, fails: int = -1) -> None:
        self.q: list[Any] = []
        self.begun: list[float] = []
        self.closed, self._fails = 0, fails

    def tick(self, state: Any, command: Any, us: float, also: Any = ()) -> None:
        if len(self.q) == self._fails:
            raise RuntimeError("the disk is gone")
        assert us > 0.0
        self.q.append(state.q.copy())

    def begin(self, state: Any, since: float = 0.0) -> None:
        self.begun.append(since)

    def close(self) -> None:
        self.closed += 1


def test_every_tick_from_the_first_on_until_it_is_closed() -> None:
    heard = Listens()
    loop, robot = simulated(follows(), record=lambda loop: heard)
    loop.tick(None)  # not begun
    q, _ = go(loop, robot, 20, TARGET)
    loop.stop()
    more, _ = go(loop, robot, 30)
    loop.resume()
    rest, _ = go(loop, robot, 5)
    loop.close()
    np.testing.assert_array_equal(heard.q, [*q, *more, *rest])
    assert heard.begun == [0.0]
    assert heard.closed == 1


def test_one_that_fails_is_let_go_and_said_at_the_end() -> None:
    heard = Listens(fails=5)
    loop, robot = simulated(follows(), record=lambda loop: heard)
    _, v = go(loop, robot, 40, TARGET)
    assert v[-1].any()
    assert len(heard.q) == 5
    with pytest.raises(CoopqpError, match="the record is not whole: the disk is gone"):
        loop.close()


def test_the_recording_of_arrow_pieces_takes_it(tmp_path: Path) -> None:
    recording = pytest.importorskip("coopqp.online.recording")
    pytest.importorskip("pyarrow")
    path = tmp_path / "run.arrows"

    def record(loop: Any) -> Any:
        return recording.LiveRecording(
            path,
            loop.scenario,
            loop.law,
            loop.state,
            controller=loop.controller,
            source=loop.source,
        )

    loop, robot = simulated(follows(), record=record)
    go(loop, robot, 30, TARGET)
    loop.close()
    assert path.stat().st_size > 1000
