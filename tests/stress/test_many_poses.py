"""Many configurations at once are as pinocchio has them one by one."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from coopqp.model.state import State
from coopqp.scenario.loader import load
from stress import arrangements, driving
from stress.many_poses import angles, carried, loop_errors

COUNT = 20


#: Firm hands, hinges and balls in them, slides; and arms that share joints or have let go.
HELD = [(n, g) for n in arrangements.names() for g in dict.fromkeys(arrangements.grasps_of(n))]


@pytest.mark.parametrize(("name", "grasp"), HELD)
def test_poses_and_loop_errors_are_pinocchios(name: str, grasp: str) -> None:
    chain = arrangements.chain(name, grasp)
    rng = np.random.default_rng(0)
    q = np.vstack([chain.q_start, chain.sample(rng, COUNT)])
    data = chain.model.createData()
    found, (apart, turned) = carried(chain, q), loop_errors(chain, q)
    compiled_apart, compiled_turned = driving.loop_errors(chain, q)
    np.testing.assert_allclose(compiled_apart, apart, atol=1e-13)
    np.testing.assert_allclose(compiled_turned, turned, atol=1e-9)
    for k, row in enumerate(q):
        pin.framesForwardKinematics(chain.model, data, row)
        for frame, (R, p) in zip(chain.frames, found, strict=True):
            np.testing.assert_allclose(R[k], data.oMf[frame].rotation, atol=1e-13)
            np.testing.assert_allclose(p[k], data.oMf[frame].translation, atol=1e-13)
        state = State(chain, row)
        assert apart[k] == pytest.approx(state.loop_position_error, abs=1e-13)
        assert turned[k] == pytest.approx(state.loop_orientation_error, abs=1e-9)


def test_small_and_large_angles_keep_their_digits() -> None:
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    sizes = np.array([0.0, 1e-12, 1e-6, 1.0, np.pi - 1e-6, np.pi])
    R = np.array([pin.exp3(size * axis) for size in sizes])
    np.testing.assert_allclose(angles(R), sizes, rtol=1e-3, atol=1e-15)


def test_an_arm_that_has_let_go_opens_no_loop() -> None:
    chain = load("point_on_point").chain
    alone = chain.handed_over(chain.q_start, ("left",))
    q = alone.sample(np.random.default_rng(0), COUNT)
    np.testing.assert_array_equal(loop_errors(alone, q), np.zeros((2, COUNT)))
