"""What every grasp keeps: its joints come after the hand, move the object, and have no motor."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from chains import BOX
from example_grasps import EXAMPLES

from coopqp.base.rank import matrix_rank
from coopqp.controller import Command, ControlProblem
from coopqp.grasp import Grasp
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.plant import Disturbance
from coopqp.plants import RigidBody
from coopqp.robot import RobotModel
from coopqp.solvers import Daqp

each_grasp = pytest.mark.parametrize("grasp", EXAMPLES.values(), ids=EXAMPLES.keys())


def held(nao: RobotModel, chain: ClosedChain, grasp: Grasp) -> ClosedChain:
    return ClosedChain.attach(nao, chain.q_start, grasp, BOX)


@each_grasp
def test_passive_joints_are_added_to_every_arm(
    grasp: Grasp, nao: RobotModel, chain: ClosedChain
) -> None:
    own = [joint.name for joint in grasp.passive_joints(np.eye(3))]
    assert len(set(own)) == len(own)
    made = held(nao, chain, grasp)
    names = [made.joint_names[i] for i in made.passive]
    assert sorted(names) == sorted(f"{arm.name}.{name}" for arm in nao.arms for name in own)
    assert made.n == chain.n + 2 * len(own)
    assert (made.model.effortLimit[made.passive] == 0.0).all()
    assert (made.lower < made.upper).all()
    assert np.abs(State(made).loop_error).max() < 1e-12


@each_grasp
def test_passive_joints_move_the_object_in_the_hand_and_nothing_else(
    grasp: Grasp, nao: RobotModel, chain: ClosedChain
) -> None:
    made = held(nao, chain, grasp)
    data = made.model.createData()

    def places(q: np.ndarray) -> tuple[list[pin.SE3], list[pin.SE3]]:
        pin.framesForwardKinematics(made.model, data, q)
        tips = [data.oMf[made.model.getFrameId(arm.tip)].copy() for arm in made.arms]
        return tips, [data.oMf[frame].copy() for frame in made.frames]

    tips, objects = places(made.q_start)
    for joint in made.passive:
        q = made.q_start.copy()
        q[joint] += 0.1
        moved_tips, moved = places(q)
        for tip, moved_tip in zip(tips, moved_tips, strict=True):
            assert moved_tip.isApprox(tip, 1e-12)
        changed = [not a.isApprox(b, 1e-3) for a, b in zip(objects, moved, strict=True)]
        own = made.joint_names[joint].split(".")[0]
        assert changed == [arm.name == own for arm in made.arms]


@each_grasp
def test_passive_joints_are_free_motions_of_the_closed_loop(
    grasp: Grasp, nao: RobotModel, chain: ClosedChain
) -> None:
    """Each of them adds a degree of freedom to the four that firm hands leave."""
    made = held(nao, chain, grasp)
    q = made.q_start + np.random.default_rng(1).uniform(-0.2, 0.2, made.n)
    assert made.n - matrix_rank(State(made, q).J_rel) == 4 + len(made.passive)


@each_grasp
def test_passive_joints_have_no_motor(grasp: Grasp, nao: RobotModel, chain: ClosedChain) -> None:
    made = held(nao, chain, grasp)
    plant = RigidBody().build(
        ControlProblem(chain=made, tasks=(), solver=Daqp(), dt=0.01), 0, Disturbance()
    )
    state, command = State(made), Command(made.n)
    command.v[:] = 0.2
    for _ in range(5):
        plant.step(state, command)
        assert not plant.signals["tau"][made.passive].any()
