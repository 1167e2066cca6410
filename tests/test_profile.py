"""Time laws: ends, rates, top speeds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coopqp.model.profile import Profile

KINDS = ("step", "constant_velocity", "trapezoid", "quintic")
SMOOTH_KINDS = KINDS[1:]


@pytest.mark.parametrize("kind", KINDS)
def test_profile_rests_at_its_start_and_at_its_end(kind: str) -> None:
    profile = Profile(kind=kind, duration=1.7, delay=0.4)  # type: ignore[arg-type]
    for t in (-1.0, 0.0, 0.39):
        assert profile.at(t) == (0.0, 0.0)
    for t in (profile.end, profile.end + 1e-9, 100.0):
        assert profile.at(t) == (1.0, 0.0)
    assert profile.end == (0.4 if kind == "step" else pytest.approx(2.1))


@pytest.mark.parametrize("kind", SMOOTH_KINDS)
def test_profile_goes_all_the_way_without_turning_back(kind: str) -> None:
    profile = Profile(kind=kind, duration=1.7, delay=0.4)  # type: ignore[arg-type]
    assert profile.at(0.4)[0] == 0.0
    times = np.linspace(0.4, 2.1, 2001)
    shares = np.array([profile.at(t)[0] for t in times])
    assert (np.diff(shares) >= 0).all()
    assert np.diff(shares).max() < 3 / 2000  # nor does it jump
    assert shares[1000] == pytest.approx(0.5)  # symmetric in time


@pytest.mark.parametrize("kind", SMOOTH_KINDS)
def test_profile_rate_is_the_derivative_of_the_share(kind: str) -> None:
    profile = Profile(kind=kind, duration=1.7, delay=0.4)  # type: ignore[arg-type]
    for t in 0.4 + 1.7 * (np.arange(400) + 0.5) / 400:  # not at the trapezoid's corners
        rate = (profile.at(t + 1e-6)[0] - profile.at(t - 1e-6)[0]) / 2e-6
        assert profile.at(t)[1] == pytest.approx(rate, abs=1e-8)


@pytest.mark.parametrize(
    ("kind", "top"), [("constant_velocity", 1), ("trapezoid", 4 / 3), ("quintic", 15 / 8)]
)
def test_profile_has_its_known_top_speed(kind: str, top: float) -> None:
    profile = Profile(kind=kind, duration=2.0)  # type: ignore[arg-type]
    rates = [profile.at(t)[1] for t in np.linspace(0, 2, 201)[1:-1]]
    assert max(rates) == pytest.approx(top / 2.0)


def test_constant_velocity_is_there_from_the_first_instant() -> None:
    """The first tick moves by rate dt; without it the point lags one tick's way behind."""
    profile = Profile(kind="constant_velocity", duration=2.0)
    assert profile.at(0.0) == (0.0, 0.5)


@pytest.mark.parametrize("keys", [{"duration": 0.0}, {"duration": math.inf}, {"delay": -1.0}])
def test_profile_out_of_time_is_refused(keys: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(keys))):
        Profile(**keys)
