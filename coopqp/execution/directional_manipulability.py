"""How much the joints can still do about what is missed, where a run has ended.

With N a basis of the joint motions that keep the loops closed, J the rows of a task and u the
direction of what is missed of it, a unit of joint motion brings about at most |N' J' u| of it.
Where that has all but vanished, compared with the start, the pose is singular in that direction:
the arms are stretched, and no limit is to blame.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from coopqp.base.rank import null_space
from coopqp.base.spec import Array
from coopqp.model.state import State
from coopqp.task import TaskStack

NOTHING = 1e-12  # missed, or possible [m, rad; m/rad]


def leverage(
    tasks: TaskStack, parts: Sequence[slice], velocities: Collection[int], start: State, end: State
) -> Array:
    """Of what is missed of each part, what can be brought about at the end over that at the start.

    Args:
        tasks: evaluated here; as of the end when it returns.
        parts: rows of each part.
        velocities: which of the parts ask for a velocity, so that its error is what is missed.
        start: of the run, but with the time of its end.
        end: of the run.

    Returns:
        Shape (len(parts),); 1 where nothing is missed or nothing could be done at the start.
    """
    ratios = np.ones(len(parts))
    if not (np.isfinite(start.q).all() and np.isfinite(end.q).all()):
        return ratios
    tasks.update(start)
    before = tasks.J @ null_space(start.J_loop)
    tasks.update(end)
    now = tasks.J @ null_space(end.J_loop)
    for i, part in enumerate(parts):
        slow = i in velocities
        missed = tasks.rate[part] - tasks.J[part] @ end.v if slow else tasks.e[part]
        could = float(np.linalg.norm(missed @ before[part]))
        if could > NOTHING:
            ratios[i] = float(np.linalg.norm(missed @ now[part])) / could
    return ratios
