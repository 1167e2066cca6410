"""What the kernel does in a tick beside the law is what Python does: readings, history, faults."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from online_loops import follows
from side_by_side import needs_kernel

import coopqp
from coopqp.base.spec import Array
from coopqp.online import arrivals, following, loop
from coopqp.online.loop import LoopTicks, OnlineLoop

pytestmark = needs_kernel


class Robot:
    """Joints with a lag and noise, one of the wrong sign from a tick on, and a bad cable."""

    def __init__(self, start: Array, own: Array, wrong_from: int, seed: int) -> None:
        self.rng, self._q, self._start, self._own = np.random.default_rng(seed), start, start, own
        self._wrong_from = wrong_from

    def read(self, k: int, setpoint: Array) -> Any:
        """An array, a list, the robot's own joints, NaN, a jump, or nothing."""
        self._q = self._q + 0.5 * (setpoint - self._q)
        q = self._q + 2e-4 * self.rng.standard_normal(len(setpoint))
        if k >= self._wrong_from:
            q[3] = 2.0 * self._start[3] - q[3]
        elif k > 20:
            self._start = q.copy()
        kind = self.rng.integers(60)
        q[2] += (np.nan if kind == 0 else 0.5) * (kind < 2)
        odd = {2: None, 3: q.tolist(), 4: q[self._own], 5: "no joints", 6: q.astype(np.float32)}
        return odd.get(kind, q)


@pytest.mark.few(5)
@pytest.mark.parametrize("name", ["point_on_point", "two_pandas", "rigid_vs_passive"])
@pytest.mark.parametrize("wrong_from", [60, 10_000], ids=["reversed", "sound"])
@pytest.mark.parametrize("reference", ["commanded", "measured"])
def test_a_session_is_the_same_without_the_kernel(
    name: str, wrong_from: int, reference: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario, loops = coopqp.load(name), []
    for python in (False, True):
        if python:
            nothing = SimpleNamespace(module=lambda: None)
            for module in (arrivals, following, loop):
                monkeypatch.setattr(module, "native", nothing)
        one = OnlineLoop(scenario, clock=None, reference=reference)
        assert bool(one.history._quick) is not python
        chain = scenario.chain
        own = np.setdiff1d(np.arange(chain.n), chain.passive)
        robot = Robot(chain.q_start, own, wrong_from, seed=7)
        for k in range(220):
            q = robot.read(k, one.setpoint) if k else chain.q_start
            one.tick(q)
            if k == 90:
                one.stop()
            if k == 120:
                one.resume()
        loops.append(one)
    quick, plain = (one.history.last() for one in loops)
    for column in LoopTicks.__dataclass_fields__:
        found, wanted = getattr(quick, column), getattr(plain, column)
        if column != "us":
            np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-12, err_msg=column)
    np.testing.assert_array_equal(loops[0].setpoint, loops[1].setpoint)
    assert loops[0].faults == loops[1].faults
    assert loops[0].note == loops[1].note


@pytest.mark.parametrize("odd", [np.zeros(3), np.zeros((10, 1)), np.float64(1.0), [[1.0]], {}, "q"])
def test_odd_readings_are_refused_as_ever(odd: Any) -> None:
    one = OnlineLoop(follows(), clock=None)
    one.tick(one.setpoint.copy())
    assert one.tick(odd).status is coopqp.Status.NOT_MEASURED
    assert one.tick(one.setpoint.copy()).status is not coopqp.Status.NOT_MEASURED
