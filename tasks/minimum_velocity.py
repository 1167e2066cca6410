"""Joints move as little as they can: Z = 0.

    e = 0,   J = I,   rate = 0

so that the least sum of squared joint velocities does what the tasks ask for; without a gain.
"""

from typing import ClassVar

import numpy as np

from coopqp.base.spec import spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.program import Kind, Primitive
from coopqp.task import Task


@spec
class MinimumVelocity(Task):
    """Joints move as little as the tasks allow (one row a joint)."""

    unit: ClassVar[str] = "rad"
    joint_space: ClassVar[bool] = True
    all_joints: ClassVar[bool] = True

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return chain.joint_names

    def program(self, start: State) -> tuple[Primitive, ...]:
        zero = np.zeros(start.chain.n)
        return (Primitive(kind=Kind.CENTERING, rows=(), numbers=(zero, zero)),)
