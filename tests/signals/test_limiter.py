"""What follows an input: within its bounds, whatever arrives."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.model.trajectory_filter import MotionLimits, TrajectoryFilter
from coopqp.signal import DIRECTION, POINT, POSE, ROTATION, Kind, matrix, of_joints, of_twist

DT = 0.002
PACE = MotionLimits(velocity=0.3, acceleration=1.5, jerk=20.0)


def follow(limiter: TrajectoryFilter, target: Array | None, ticks: int) -> dict[str, Array]:
    found: dict[str, list[Array]] = {"value": [], "rate": [], "acceleration": []}
    for _ in range(ticks):
        assert limiter.step(target)
        for key, kept in found.items():
            kept.append(getattr(limiter, key).copy())
    return {key: np.array(kept) for key, kept in found.items()}


def lengths(values: Array) -> Array:
    return np.linalg.norm(values, axis=1)


@pytest.mark.parametrize("way", [(0.1, 0.0, 0.0), (0.06, -0.07, 0.04)])
def test_a_step_of_ten_centimetres_is_a_bounded_motion(way: tuple[float, ...]) -> None:
    limiter = TrajectoryFilter(POINT, PACE, DT, np.zeros(3))
    seen = follow(limiter, np.array(way), 1500)
    speed = np.diff(seen["value"], axis=0) / DT
    jerk = np.diff(seen["acceleration"], axis=0) / DT
    assert lengths(seen["rate"]).max() <= 0.3 + 1e-9
    assert lengths(speed).max() <= 0.3 + 1e-9
    assert lengths(seen["acceleration"]).max() <= 1.5 + 1e-9
    assert lengths(np.diff(seen["rate"], axis=0) / DT).max() <= 1.5 + 1e-9
    assert lengths(jerk).max() <= 20.0 + 1e-9
    np.testing.assert_allclose(seen["value"][-1], way, atol=1e-9)
    assert np.abs(seen["rate"][-1]).max() < 1e-9


def test_a_target_that_jumps_about_is_followed_within_the_bounds(rng: np.random.Generator) -> None:
    limiter, seen = TrajectoryFilter(POINT, PACE, DT, np.zeros(3)), []
    for _ in range(60):
        seen.append(follow(limiter, rng.uniform(-0.2, 0.2, 3), int(rng.integers(1, 120))))
    value, rate, acceleration = (
        np.concatenate([part[key] for part in seen]) for key in ("value", "rate", "acceleration")
    )
    assert lengths(rate).max() <= 0.3 + 1e-9
    assert lengths(acceleration).max() <= 1.5 + 1e-9
    assert lengths(np.diff(acceleration, axis=0) / DT).max() <= 20.0 + 1e-9
    assert np.abs(value).max() <= 0.2 + 1e-9, "never beyond the targets"
    middle = (value[2:] - value[:-2]) / (2.0 * DT)
    np.testing.assert_allclose(rate[1:-1], middle, atol=20.0 * DT * DT)


def test_it_brakes_to_rest_and_stays() -> None:
    limiter = TrajectoryFilter(POINT, PACE, DT, np.zeros(3))
    follow(limiter, np.array([1.0, 0.0, 0.0]), 300)
    braking = follow(limiter, None, 400)
    assert lengths(braking["acceleration"]).max() <= 1.5 + 1e-9
    assert not np.abs(braking["rate"][-1]).max() > 1e-9
    np.testing.assert_allclose(braking["value"][-1], braking["value"][-50], atol=1e-9)


def angle_to(limiter: TrajectoryFilter, R: Array) -> float:
    return float(np.linalg.norm(pin.log3(limiter.R @ R.T)))


def test_a_rotation_is_followed_within_its_bounds(rng: np.random.Generator) -> None:
    limiter = TrajectoryFilter(ROTATION, PACE, DT, ROTATION.zero)
    before, speeds = limiter.R, []
    for _ in range(12):
        axis = rng.standard_normal(3)
        target = ROTATION.read(pin.exp3(1.2 * axis / np.linalg.norm(axis)))
        for _ in range(int(rng.integers(50, 600))):
            assert limiter.step(target)
            speeds.append(pin.log3(limiter.R @ before.T) / DT)
            np.testing.assert_allclose(limiter.rate, speeds[-1], atol=40.0 * DT)
            before = limiter.R
    assert lengths(np.array(speeds)).max() <= 1.0 + 1e-9
    follow(limiter, target, 3000)
    assert angle_to(limiter, matrix(target)) < 1e-9


def test_a_direction_goes_the_shortest_way(rng: np.random.Generator) -> None:
    limiter = TrajectoryFilter(DIRECTION, PACE, DT, DIRECTION.read((0, 0, 1)))
    target = DIRECTION.read((1, 0, 0))
    for _ in range(2500):
        assert limiter.step(target)
        assert abs(limiter.R[1, 2]) < 1e-9, "in the plane of both"
    np.testing.assert_allclose(limiter.R[:, 2], (1, 0, 0), atol=1e-9)
    for _ in range(4000):  # and to the opposite some way or other
        assert limiter.step(DIRECTION.read((-1, 0, 0)))
    np.testing.assert_allclose(limiter.R[:, 2], (-1, 0, 0), atol=1e-9)


def test_each_joint_has_the_bounds_for_itself() -> None:
    kind = of_joints(("a", "b"))
    seen = follow(TrajectoryFilter(kind, PACE, DT, np.zeros(2)), np.array([1.0, -1.0]), 800)
    assert np.abs(seen["rate"]).max() == pytest.approx(0.3, abs=1e-9)


def test_velocities_change_within_their_bounds() -> None:
    kind = of_twist(("x", "y", "rot_z"))
    limiter = TrajectoryFilter(kind, PACE, DT, np.zeros(3))
    seen = follow(limiter, np.array([9.0, 0.0, 0.1]), 2000)
    assert lengths(seen["value"][:, :2]).max() <= 0.3 + 1e-9
    assert lengths(seen["rate"][:, :2]).max() <= 1.5 + 1e-9
    ratio = seen["value"][-1, 2] / seen["value"][-1, 0]
    assert ratio == pytest.approx(0.1 / 9.0, rel=1e-6), "in its direction"
    braking = follow(limiter, None, 2000)
    assert np.abs(braking["value"][-1]).max() < 1e-9


@pytest.mark.parametrize("kind", [POINT, POSE, ROTATION, DIRECTION, of_joints(("a",))])
def test_it_does_not_raise_whatever_it_is_told(kind: Kind, rng: np.random.Generator) -> None:
    limiter: Any = TrajectoryFilter(
        kind, MotionLimits(velocity=1e-3, acceleration=1.0, jerk=1e3), DT, kind.zero
    )
    for size in (0.0, 1e-300, 1e-3, 1e6):
        target = kind.zero
        target[: kind.numbers] += size
        limiter.step(target)
        assert np.isfinite(limiter.value).all()
        assert math.isfinite(float(np.linalg.norm(limiter.rate)))


@pytest.mark.parametrize(
    ("bounds", "said"),
    [
        ({"velocity": 1e19}, "velocity: found 1e+19, needs 0.001 to 100 m/s"),
        ({"velocity": 1e-6}, "velocity: found 1e-06, needs 0.001 to 100 m/s"),
        ({"acceleration": 1e-9}, "acceleration: found 1e-09, needs 0.001 to 10000 m/s2"),
        ({"acceleration": 1e3, "jerk": 1e12}, "jerk: found 1e+12, needs 0.001 to 1e+06 m/s3"),
        ({"acceleration": 1e3}, "acceleration: found 1000, needs 0.00025 to 250 m/s2, beside velo"),
        ({"angular_jerk": 1e5}, "angular_jerk: found 100000, needs 0.004 to 4000 rad/s3, beside"),
    ],
)
def test_bounds_with_which_there_may_be_no_way_are_refused(
    bounds: dict[str, float], said: str
) -> None:
    with pytest.raises(InvalidValueError) as refused:
        MotionLimits(**bounds)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_with_all_other_bounds_there_is_a_way(rng: np.random.Generator) -> None:
    """Bounds at random, and those at the very edges, with targets that jump."""
    edges = [(1e-3, 1.0, 1e3), (100.0, 1e4, 1e6), (100.0, 0.1, 1e-3), (1e-3, 1e-3, 1e-3)]
    drawn = 10.0 ** rng.uniform((-3, -3, -3), (2, 4, 6), (150, 3))
    tried = 0
    for k, (v, a, j) in enumerate([*edges, *drawn.tolist()]):
        if not (1e-3 <= v / a <= 1e3 and 1e-3 <= a / j <= 1e3):
            continue
        tried += 1
        pace = MotionLimits(
            velocity=v, acceleration=a, jerk=j,
            angular_velocity=v, angular_acceleration=a, angular_jerk=j,
        )  # fmt: skip
        limiter = TrajectoryFilter(
            POSE if k % 2 else POINT, pace, DT, (POSE if k % 2 else POINT).zero
        )
        for at in range(60):
            if at % 9 == 0:
                turn = rng.normal(size=4)
                place = np.concatenate([rng.uniform(-1.0, 1.0, 3), turn / np.linalg.norm(turn)])
            assert limiter.step(None if at % 31 == 30 else place[: limiter.kind.values]), pace
    assert tried > 40
