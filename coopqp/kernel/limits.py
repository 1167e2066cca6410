"""The limits of a problem: those that the kernel knows as numbers, and those that Python fills."""

from __future__ import annotations

import numpy as np

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.kernel.flat import Flat, flat_joint_limit, flat_twist_limit
from coopqp.limit import Bounded, JointBounds, TwistBounds
from coopqp.model.state import State
from coopqp.qp_law.bounds import Bounds


class Limits:
    """The limits of a problem.

    A limit that Python fills may have rows, which mix with the kernel's. One that has none may heed
    what bounds the others left, so that Python fills them all then.

    Args:
        problem: whose limits.
        start: a state, for those that are constant.

    Attributes:
        joints: bounds on joints as numbers, in the order in which they tighten.
        twist: rows that see the object's twist, as numbers; they come first.
        filled: the others, if there are any; their rows come after these.
        rows: how many there are.
        q_measured: what the kernel reads, shape (n,); NaN where nothing is measured. None where no
            limit supports it.
    """

    def __init__(self, problem: ControlProblem, start: State) -> None:
        chain, dt, limits = problem.chain, problem.dt, problem.limits
        programs = [limit.program(chain, dt) for limit in limits]
        known = list(zip(limits, programs, strict=True))
        if any(program is None and not limit.rows(chain) for limit, program in known):
            known = [(limit, None) for limit in limits]
        self.joints: list[Flat] = []
        self.twist: list[Flat] = []
        self.filled: Bounds | None = None
        self.q_measured: Array | None = None
        self.rows = 0
        for _, program in known:
            if isinstance(program, JointBounds):
                self.joints.append(flat_joint_limit(program))
                if program.of is Bounded.LEAD:
                    self.q_measured = np.full(chain.n, np.nan)
            elif isinstance(program, TwistBounds):
                self.twist.append(flat_twist_limit(program, self.rows))
                self.rows += program.rows
        if filled := [limit for limit, program in known if program is None]:
            self.filled = Bounds(chain, filled, start, dt)
            self.rows += len(self.filled.rows)

    @property
    def in_python(self) -> tuple[str, ...]:
        """What limits are called whose rows are Python's."""
        rows = self.filled.rows if self.filled else ()
        return tuple(dict.fromkeys(row.owner for row in rows))

    @property
    def compiled(self) -> bool:
        """Whether nothing is Python's."""
        return self.filled is None and self.q_measured is None

    def update(self, state: State) -> None:
        """Fill what Python fills, at a state."""
        if self.filled is not None:
            self.filled.update(state)
        if self.q_measured is not None:
            measured = state.q_measured
            known = measured is not None and np.shape(measured) == self.q_measured.shape
            self.q_measured[:] = measured if known else np.nan
