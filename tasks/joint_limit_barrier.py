"""Joints keep off their limits: a criterion Z of eq. (33) that grows without bound towards them.

    phi(q) = -1/4 sum_j log(1 - x_j^2),   x_j = (q_j - mid_j) / (range_j / 2)
    e = grad phi = x / ((1 - x^2) range),   J = I

The paper does not say which criterion it takes. The quadratic one of :mod:`joint_centering` has the
same slope near mid-range, but its least sum can lie beyond a limit. Within ``width`` of a limit,
and beyond it, the slope is constant, so that joints do not chatter. Joints without limits ask for
nothing.
"""

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from coopqp.base.spec import spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.program import Kind, Primitive
from coopqp.task import Task
from coopqp.tasks.joint_centering import ranges


@spec
class JointLimitBarrier(Task):
    """Joints keep off their limits, the harder the nearer (one row a joint)."""

    unit: ClassVar[str] = "1/rad"
    joint_space: ClassVar[bool] = True
    all_joints: ClassVar[bool] = True

    width: Annotated[float, Field(ge=1e-3, lt=1.0)] = 0.05
    """Where the slope stops growing, as a share of half the joint's range."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return chain.joint_names

    def program(self, start: State) -> tuple[Primitive, ...]:
        """Middle, 2 / range and 1 / range of each joint; zero for joints without limits."""
        limited, middle, width = ranges(start.chain)
        per_half, per_range = (
            np.divide(share, width, out=np.zeros(len(width)), where=limited) for share in (2.0, 1.0)
        )
        numbers = middle, per_half, per_range
        return (Primitive(kind=Kind.BARRIER, rows=(), length=1.0 - self.width, numbers=numbers),)
