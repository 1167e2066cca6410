"""Joints go to the middle of their range: the criterion Z of the paper's eq. (33).

    phi(q) = sum_j ((q_j - mid_j) / range_j)^2,   e = grad phi = 2 (q - mid) / range^2,   J = I

so that the desired joint velocity is Z = -gain grad phi. Joints without limits have no middle and
ask for nothing.
"""

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from coopqp.base.spec import Array, spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.program import Kind, Primitive
from coopqp.task import Task


@spec
class JointCentering(Task):
    """Joints go to mid-range with what the tasks leave free (one row a joint)."""

    unit: ClassVar[str] = "1/rad"
    joint_space: ClassVar[bool] = True
    all_joints: ClassVar[bool] = True

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return chain.joint_names

    def program(self, start: State) -> tuple[Primitive, ...]:
        """Middle and slope of each joint; zero for joints without limits."""
        limited, middle, width = ranges(start.chain)
        slope = np.divide(2.0, width**2, out=np.zeros(len(width)), where=limited)
        return (Primitive(kind=Kind.CENTERING, rows=(), numbers=(middle, slope)),)


def ranges(chain: ClosedChain) -> tuple[NDArray[np.bool_], Array, Array]:
    """Which joints have limits, and middle and width of their ranges; zero for the others."""
    limited = np.isfinite(chain.lower) & np.isfinite(chain.upper)
    lower, upper = np.where(limited, (chain.lower, chain.upper), 0.0)
    return limited, 0.5 * (lower + upper), upper - lower
