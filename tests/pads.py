"""Chains of the shipped scenarios whose hands hold the same object by pressing with pads."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

import coopqp
from coopqp.base.spec import Array
from coopqp.closed_loop.hands import hands, points
from coopqp.grasp import BEYOND, Contact
from coopqp.grasps import SurfaceContact
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State


def pressing(chain: ClosedChain, mass: float, half: float, **settings: Any) -> ClosedChain:
    """Pads at the tips of two hands that press towards each other, their x axis up.

    Args:
        chain: two hands that hold an object firmly.
        mass: of the object instead [kg].
        half: half-lengths of the pads [m].
        settings: of the contacts.
    """
    data = chain.model.createData()
    pin.framesForwardKinematics(chain.model, data, chain.q_start)
    tips = [data.oMf[chain.model.getFrameId(arm.tip)] for arm in chain.arms]
    e = tips[1].translation - tips[0].translation
    grasps = {
        arm.name: SurfaceContact(
            normal=_in(tip.rotation, sign * e), along=_in(tip.rotation, np.array([0.0, 0.0, 1.0])),
            half_lengths=(half, half), **settings,
        )
        for arm, tip, sign in zip(chain.arms, tips, (1.0, -1.0), strict=True)
    }  # fmt: skip
    held = replace(chain.held, mass=mass, pose=None)
    return ClosedChain.attach(chain.robot, chain.q_start, grasps, held)


def scenario_pads(name: str, mass: float, half: float, **settings: Any) -> ClosedChain:
    """The same from a shipped scenario."""
    return pressing(coopqp.load(name).chain, mass, half, **settings)


def line(state: State) -> Array:
    """From the first hand to the second."""
    p = points(hands(state.chain), state.p_WO, state.R_WO)
    return np.asarray((p[1] - p[0]) / np.linalg.norm(p[1] - p[0]), float)


def squeezed(chain: ClosedChain, newtons: float) -> Array:
    """What force sensors say where the hands press so hard against each other."""
    e = line(State(chain))
    told = np.zeros((len(chain.robot.arms), 6))
    robot = [arm.name for arm in chain.robot.arms]
    for hand, sign in zip(hands(chain), (1.0, -1.0), strict=True):
        told[robot.index(hand.arm), :3] = sign * newtons * e
    return told.ravel()


def _in(R: Array, direction: Array) -> tuple[float, float, float]:
    x, y, z = R.T @ direction
    return float(x), float(y), float(z)


def friction_for(contact: Contact, wrench: ArrayLike) -> float:
    """The friction coefficient that a wrench (contact frame) needs; inf where none bears it."""
    tips = contact.edge_use(wrench) > 1.0 + BEYOND
    return math.inf if tips else contact.friction_needed(wrench)
