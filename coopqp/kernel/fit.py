"""What the kernel can do, and why it cannot do the rest."""

from __future__ import annotations

import numpy as np

from coopqp.base.errors import InvalidValueError
from coopqp.controller import ControlProblem
from coopqp.kernel import native
from coopqp.kernel.flat import flat_model, kept_rows
from coopqp.limit import movers
from coopqp.model.closed_chain import ClosedChain

#: What the compiled arrays hold: joints of two arms, joints that move several arms, loops.
MOST_LANES, MOST_SHARED, MOST_LOOPS = 64, 6, 16


def why_not(problem: ControlProblem) -> str:
    """Why the kernel cannot do a problem; empty where it can."""
    chain = problem.chain
    if native.module() is None:
        return native.MISSING
    if not problem.solver.kernel_instead:
        return "the scenario asks for another solver"
    return unfit(chain)


def unfit(chain: ClosedChain) -> str:
    """What of a chain the kernel cannot do; empty where it can do all."""
    if chain.loops.varying:
        return "which loop rows depend on others changes with the pose"
    return chain.once(_unfit)


def _unfit(chain: ClosedChain) -> str:
    """What of it the compiled arrays do not hold, loop by loop, wherever it starts."""
    if flat_model(chain) is None:
        return "a joint is neither a hinge nor a slide"
    if chain.n <= len(chain.loops.kept):
        return "the loops leave no motion"
    moved = movers(chain, [chain.model.frames[frame].parentJoint for frame in chain.frames])
    shared = moved.sum(axis=0) > 1.0
    first = np.count_nonzero(shared | (moved[0] > 0.0))
    others = (moved[1 : chain.holding] * ~shared).sum(axis=1)
    widest = max(first, 6 + np.count_nonzero(shared)) + others.max(initial=0.0)
    if widest > MOST_LANES and chain.holding > 1:
        return f"two arms have more than {MOST_LANES} joints together"
    if np.count_nonzero(shared) > MOST_SHARED:
        return f"more than {MOST_SHARED} joints move several arms"
    carry, kept = int(first), kept_rows(chain).reshape(-1, 6).sum(axis=1)
    for own, rows in zip(others, kept, strict=True):
        left = int(carry + own - rows)
        if left < 0:
            return "a loop has fewer joints than rows"
        carry = min(left, 6 + int(np.count_nonzero(shared)))
    if chain.holding - 1 > MOST_LOOPS:
        return f"there are more than {MOST_LOOPS} loops"
    return ""


def required(problem: ControlProblem) -> None:
    """Refuse what the kernel cannot do.

    Raises:
        InvalidValueError: with the reason.
    """
    if reason := why_not(problem):
        raise InvalidValueError(f"engine: kernel cannot do this: {reason}; use engine: auto")
