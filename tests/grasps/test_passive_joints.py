"""Grasps: what each leaves free, and what the motors can decide of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import coopqp
from coopqp.base.errors import GraspError
from coopqp.closed_loop.mobility import Mobility, mobility
from coopqp.execution.controller_run import run
from coopqp.grasp import Grasp
from coopqp.grasps import Prismatic, Revolute, Rigid, Spherical
from coopqp.plants import RigidBody
from coopqp.scenario.scenario import Scenario

BELOW = (0.0, 0.0, -0.05)


def held(grasp: Grasp) -> Scenario:
    return replace(coopqp.load("passive_grasp_pose"), grasps=grasp)


def mobility_of(grasp: Grasp) -> Mobility:
    return mobility(held(grasp).chain, samples=4)


@pytest.mark.parametrize(
    ("grasp", "freedom", "object_freedom"),
    [
        (Rigid(), 4, 4),
        (Revolute(), 6, 6),
        (Revolute(point=BELOW), 6, 6),
        (Revolute(axis=(0, 0, 1)), 6, 6),
        (Prismatic(), 6, 6),
        (Prismatic(axis=(0, 1, 0)), 6, 6),
        (Spherical(), 10, 6),
    ],
)
def test_each_passive_joint_adds_a_degree_of_freedom(
    grasp: Grasp, freedom: int, object_freedom: int
) -> None:
    found = mobility_of(grasp)
    assert (found.freedom, found.object_freedom) == (freedom, object_freedom)


def test_motors_decide_all_six_motions_with_the_papers_table_2() -> None:
    found = mobility_of(Revolute(point=BELOW))
    assert found.motor_freedom_start == 6
    assert not found.impossible
    assert not found.uncontrolled


def test_hinges_on_one_line_leave_the_object_spinning() -> None:
    found = mobility_of(Revolute(axis=(0, 1, 0), axis_in="world"))
    assert found.freedom_start == 6
    assert found.motor_freedom_start == 5
    (spin,) = found.uncontrolled
    assert np.allclose(np.abs(spin.axis), (0, 1, 0), atol=1e-9)
    assert spin.pitch == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("controller", ["passive_grasp_pid", "torque_qp"])
def test_a_pose_is_refused_when_the_motors_cannot_decide_it(controller: str) -> None:
    collinear = held(Revolute(axis=(0, 1, 0), axis_in="world"))
    with pytest.raises(GraspError, match="only 5 object motions; missing: rotation about y"):
        run(collinear, controller=controller)
    with pytest.raises(GraspError, match="only 4 object motions; missing: rotation about"):
        run(held(Rigid()), controller=controller)


def test_limits_of_a_passive_joint_hold() -> None:
    free = held(Revolute(point=BELOW))
    limited = held(Revolute(point=BELOW, lower=-0.2, upper=0.2))
    kinematic = coopqp.load("rigid_vs_passive").plant
    far = run(replace(free, plant=kinematic, dt=0.01), controller="qp")
    near = run(replace(limited, plant=kinematic, dt=0.01), controller="qp")
    hinge = near.joints.index("right.hinge")
    assert np.abs(far.q[:, hinge]).max() > 0.3
    assert np.abs(near.q[:, hinge]).max() <= 0.2 + 1e-9


def test_a_passive_joint_has_no_motor() -> None:
    scenario = replace(held(Revolute(point=BELOW)), plant=RigidBody(), duration=0.2)
    trace = run(scenario, controller="torque_qp")
    hinges = [i for i, name in enumerate(trace.joints) if "hinge" in name]
    assert len(hinges) == 2
    assert np.all(trace.signals["tau"][:, hinges] == 0.0)


def test_a_ball_needs_a_cone_below_a_quarter_turn() -> None:
    with pytest.raises(ValueError, match="quarter turn"):
        Spherical(cone=1.6)


def test_coordinates_that_slide_are_metres() -> None:
    chain = held(Prismatic()).chain
    units = dict(zip(chain.joint_names, chain.joint_units, strict=True))
    sliding = {chain.joint_names[i] for i in chain.passive}
    assert {name for name, unit in units.items() if unit == "m"} == sliding
    assert set(units.values()) == {"m", "rad"}
