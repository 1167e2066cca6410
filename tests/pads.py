"""Chains of the shipped scenarios whose hands hold the same object by pressing with pads."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

import coopqp
from coopqp.base.spec import Array
from coopqp.grasps import SurfaceContact
from coopqp.model.closed_chain import ClosedChain


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


def _in(R: Array, direction: Array) -> tuple[float, float, float]:
    x, y, z = R.T @ direction
    return float(x), float(y), float(z)
