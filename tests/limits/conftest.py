"""NAO with a box that has edges."""

from __future__ import annotations

import pytest
from chains import HANDS

from coopqp.grasps import Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.robot import RobotModel


@pytest.fixture(scope="session")
def held_box(nao: RobotModel) -> ClosedChain:
    q = nao.configuration(HANDS)
    return ClosedChain.attach(nao, q, Rigid(), HeldObject(size=(0.08, 0.19, 0.08)))
