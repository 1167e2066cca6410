"""Joints stay within their speed: -scale v_max <= v <= scale v_max."""

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from coopqp.base.qp import Row
from coopqp.base.spec import Array, spec
from coopqp.limit import Bounded, JointBounds, Limit, LimitRows, Tighten, joint_margins
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State


@spec
class JointVelocity(Limit):
    """Joint velocity limits of the robot, or a share of them."""

    constant: ClassVar[bool] = True

    scale: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    """Share of the robot's own velocity limits that may be used."""

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        upper = self.scale * chain.velocity
        lower = -upper

        def tighten(state: State, rows: LimitRows) -> None:
            np.maximum(rows.lb, lower, out=rows.lb)
            np.minimum(rows.ub, upper, out=rows.ub)

        return tighten

    def program(self, chain: ClosedChain, dt: float) -> JointBounds:
        upper = self.scale * chain.velocity
        return JointBounds(of=Bounded.VELOCITY, lower=-upper, upper=upper)

    def margins(self, chain: ClosedChain, q: Array, v: Array, dt: float) -> dict[Row, Array]:
        """Speed left in each tick [rad/s, m/s]."""
        limit = self.scale * chain.velocity
        return joint_margins("velocity", chain, limit + v, limit - v, per="/s")
