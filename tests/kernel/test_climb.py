"""The kernel climbs the manipulability as the plain law does, which tests/tasks differentiates."""

from __future__ import annotations

import numpy as np
import pytest
from laws import problem
from side_by_side import laws, needs_kernel
from stress import arrangements
from walks import walk

from coopqp.tasks import Manipulability

pytestmark = needs_kernel


@pytest.mark.parametrize("name", arrangements.names())
@pytest.mark.parametrize("axes", [("x", "y"), ("z", "x", "y")])
def test_joints_climb_alike(name: str, axes: tuple[str, ...]) -> None:
    """Two arms and more, open loops, slides, a shared torso; as the only task of all joints."""
    if name == arrangements.PLANAR and "z" in axes:
        pytest.skip("nothing moves out of the plane")
    chain = arrangements.chain(name, arrangements.grasps_of(name)[-1])
    climb = Manipulability(axes=axes, gain=0.5)  # type: ignore[arg-type]
    plain, kernel = laws(problem(chain, secondary=[climb]))
    for seed in range(3):
        q = walk(np.random.default_rng(seed), chain, outside=False)
        v = plain.tick(plain.start(q)).v
        found = kernel.tick(kernel.start(q)).v
        assert kernel.compiled
        assert kernel.whole.alone
        assert np.abs(v).max() > 1e-3
        np.testing.assert_allclose(found, v, atol=1e-11)
