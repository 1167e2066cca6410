"""A tick of a written trace is repeated from what it had decided from, whatever the plant."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from explained import traced
from scenario_files import HEAD, PHASES, TAIL, phased

import coopqp
from coopqp.execution.comparison import summarize
from coopqp.limits import FollowingError, JointPosition, JointVelocity
from coopqp.plant import Disturbance, Plant, Slip
from coopqp.plants import Kinematic, Mujoco, RigidBody
from coopqp.study.trace_file import recorded_tick

WRONG = Disturbance(
    grasp_offset=2e-3, encoder_offset=5e-3, noise_position=1e-4, delay=2, slip=Slip(at=0.5, by=5e-3)
)
SCALED = (HEAD + PHASES + TAIL).replace("{name: up,", "{name: up, mode: scaled,")


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "plant",
    [Kinematic(), RigidBody(time_step=0.002), Mujoco(time_step=0.001)],
    ids=lambda plant: type(plant).__name__,
)
def test_every_tick_can_be_repeated(plant: Plant, tmp_path: Path) -> None:
    if isinstance(plant, Mujoco):
        pytest.importorskip("mujoco")
    wrong = WRONG.kinematic if isinstance(plant, Kinematic) else WRONG
    scenario = replace(phased(tmp_path, SCALED), plant=plant, disturbance=wrong)
    trace = coopqp.run(scenario, controller="qp")
    written = traced(summarize(scenario, {"qp": trace}), tmp_path)
    assert np.abs(trace.v).max() > 0.05
    for tick in (0, 1, 30, 55, 59, 60, 61, 119, 120, 121, 140, 169):
        record = recorded_tick(written, scenario, "qp", tick)
        np.testing.assert_allclose(record.answer[: trace.v.shape[1]], trace.v[tick], atol=1e-12)
        np.testing.assert_array_equal(record.q, trace.commanded[tick])


def test_ticks_on_a_leash_can_be_repeated(tmp_path: Path) -> None:
    scenario = replace(
        coopqp.load("two_pandas"),
        plant=RigidBody(time_step=0.002),
        disturbance=WRONG,
        limits=(JointPosition(), JointVelocity(), FollowingError(max=0.001)),
        duration=0.5,
    )
    free = coopqp.run(replace(scenario, limits=scenario.limits[:2]), controller="qp")
    trace = coopqp.run(scenario, controller="qp")
    assert np.abs(trace.commanded - trace.measured).max() < 1.6e-3  # with noise
    assert np.abs(free.v - trace.v).max() > 1e-3
    written = traced(summarize(scenario, {"qp": trace}), tmp_path)
    for tick in (0, 1, 20, 35, 49):
        record = recorded_tick(written, scenario, "qp", tick)
        np.testing.assert_allclose(record.answer[: trace.v.shape[1]], trace.v[tick], atol=1e-12)


def test_columns_are_empty_where_there_is_nothing_to_say(tmp_path: Path) -> None:
    comparison = coopqp.compare(coopqp.load("point_on_point"), controllers=["qp", "pseudoinverse"])
    with traced(comparison, tmp_path).open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    joints = comparison.traces["qp"].joints
    for row in rows:
        assert not any(row[f"commanded[{joint}]"] for joint in joints)
        assert not any(row[f"loop_offset[1].{axis}"] for axis in ("x", "y", "z", "rot_x"))
