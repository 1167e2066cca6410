"""Passive joints beside motors that have armatures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from coopqp.grasps import Revolute
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.robot import RobotModel


def test_passive_joints_keep_the_armatures_of_the_motors(nao: RobotModel) -> None:
    """What appendModel of pinocchio forgets."""
    model = nao.model.copy()
    model.armature = np.linspace(0.1, 1.0, model.nv)
    robot = replace(nao, model=model)
    chain = ClosedChain.attach(robot, np.zeros(model.nv), Revolute(), HeldObject())
    for name, armature in zip(robot.joint_names, model.armature, strict=True):
        at = chain.model.idx_vs[chain.model.getJointId(name)]
        assert chain.model.armature[at] == armature
    assert (chain.model.armature[chain.passive] == 0.0).all()
