"""What inputs of each kind make of messages."""

from __future__ import annotations

import numpy as np
import pytest
from ros_messages import joint_state, pose, twist
from scipy.spatial.transform import Rotation

from coopqp.base.errors import InvalidValueError
from coopqp.ros.bridge import JOINT_STATE, POSE, TWIST, message_of, value_of
from coopqp.signal import DIRECTION, POINT, ROTATION, matrix, of_joints, of_twist
from coopqp.signal import POSE as POSE_KIND

P, Q = [0.1, -0.2, 0.3], Rotation.from_euler("xyz", [0.3, -0.5, 1.1]).as_quat().tolist()
R = Rotation.from_quat(Q).as_matrix()


def test_poses() -> None:
    message = pose(1, P, Q, "world")
    assert {message_of(kind) for kind in (POINT, ROTATION, DIRECTION, POSE_KIND)} == {POSE}
    assert value_of(POINT, message, "world") == P
    assert value_of(ROTATION, message, "world") == Q
    assert value_of(POSE_KIND, message, "world") == P + Q
    along = DIRECTION.read(value_of(DIRECTION, message, "world"))
    np.testing.assert_allclose(matrix(along)[:, 2], R[:, 2], atol=1e-15)


def test_twists_give_the_components_that_are_asked_for() -> None:
    message, kind = twist(1, [1, 2, 3], [4, 5, 6]), of_twist(("rot_z", "x"))
    assert message_of(kind) == TWIST
    assert value_of(kind, message, "world") == [6.0, 1.0]


def test_joints_are_found_by_name() -> None:
    kind = of_joints(("left/a", "left/b"))
    assert message_of(kind) == JOINT_STATE
    message = joint_state(1, ["left_b", "other", "left_a"], [2.0, 9.0, 1.0])
    assert value_of(kind, message, "world") == [1.0, 2.0]
    with pytest.raises(InvalidValueError, match="has no position of left_a; has left_b"):
        value_of(kind, joint_state(1, ["left_b"], [2.0]), "world")
