"""Random ways along the loops of a chain."""

from __future__ import annotations

import numpy as np

from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain
from coopqp.planning.closed_path import Loops, relative, through


def random_way(chain: ClosedChain, seed: int, count: int = 4, step: float = 0.6) -> Array:
    """Closed configurations away from the limits, each about a step from the one before."""
    rng, loops = np.random.default_rng(seed), Loops(chain)
    found = [chain.q_start.copy()]
    for _ in range(300):
        if len(found) == count:
            return np.array(found)
        q = found[-1][None]
        d = rng.normal(size=chain.n)
        J = relative(loops.at(q).J)
        d -= through(J, (J @ d[:, None])[..., 0])[0]
        for _ in range(6):
            q = loops.project(q + step / 6 * d / np.linalg.norm(d))
        inside = (np.minimum(q - chain.lower, chain.upper - q) > 0.2).all()
        if inside and loops.errors(q).max() < 1e-9:
            found.append(q[0])
    raise AssertionError("no way inside the limits")
