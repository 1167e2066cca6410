"""The example of teleoperation: a leader in another process, which is killed."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from importlib import util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import coopqp
from coopqp.solver import Status

FOLDER = Path(__file__).parents[2] / "examples" / "teleoperation"


def _example(name: str) -> Any:
    spec = util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec
    assert spec.loader
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_killing_the_leader_brings_the_arms_to_rest_and_says_why(tmp_path: Path) -> None:
    follower = _example("follower")
    started: list[subprocess.Popen[bytes]] = []

    def lead(port: int) -> None:
        leader = subprocess.Popen([sys.executable, str(FOLDER / "leader.py"), str(port)])
        started.append(leader)
        until = time.monotonic() + 30.0
        while not any("follow" in words for words in said) and time.monotonic() < until:
            time.sleep(0.02)  # as long as Python takes to start
        time.sleep(1.2)
        leader.kill()

    said: list[str] = []
    threads: list[threading.Thread] = []

    def ready(port: int) -> None:
        threads.append(threading.Thread(target=lead, args=(port,)))
        threads[0].start()

    loop = follower.follow(0, out=tmp_path / "out", say=said.append, ready=ready)
    threads[0].join()
    started[0].wait()
    assert said[-1].startswith("the leader has sent nothing for 1 s")
    assert any(Status.INPUT_STALE.value in words for words in said[2:-1])
    assert loop.at_rest
    kept = loop.history.last()
    assert np.ptp(kept.position, axis=0).max() > 1e-3
    fed = coopqp.load(tmp_path / "out" / "scenario.yaml").inputs["target"].feed_file
    assert fed
    assert len(Path(fed).read_text().splitlines()) > 5


def test_a_port_that_is_taken_is_said_in_a_line() -> None:
    follower = _example("follower")
    with pytest.raises(OSError, match="in use"):
        follower.follow(0, ready=lambda port: follower.follow(port))
