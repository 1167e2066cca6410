"""Several robots side by side."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.robots import NaoT14, PlanarPair, Several, Urdf


def test_several_robots_stand_where_they_are_put(rng: np.random.Generator) -> None:
    pair = PlanarPair()
    placed = {
        "a": {"robot": pair, "position": (0.0, 1.0, 0.2), "rpy_deg": (0.0, 30.0, 90.0)},
        "b": {"robot": Several(robots={"in": {"robot": pair}}), "position": (2.0, 0.0, 0.0)},
    }
    alone, both = pair.build(), Several(robots=placed).build()
    assert [arm.name for arm in both.arms] == ["a/right", "a/left", "b/in/right", "b/in/left"]
    assert both.joint_names[6] == "b/in/right_1"
    assert both.model.check(both.model.createData())
    q = rng.uniform(-1.0, 1.0, 12)
    for name, part in (("a/", slice(0, 6)), ("b/in/", slice(6, 12))):
        own, data = alone.model.createData(), both.model.createData()
        pin.framesForwardKinematics(alone.model, own, q[part])
        pin.framesForwardKinematics(both.model, data, q)
        place: Any = placed[name[0]]
        R = pin.rpy.rpyToMatrix(*np.radians(place.get("rpy_deg", (0, 0, 0))))
        X = pin.SE3(R, np.array(place["position"]))
        tip = own.oMf[alone.model.getFrameId("left_hand")]
        found = data.oMf[both.model.getFrameId(f"{name}left_hand")]
        np.testing.assert_allclose(found.homogeneous, (X * tip).homogeneous, atol=1e-14)
    np.testing.assert_allclose(both.model.velocityLimit, [*alone.model.velocityLimit] * 2)


def test_bodies_that_must_not_hit_others_come_along() -> None:
    placed = {"robot": NaoT14(), "position": (0.0, 1.0, 0.5), "rpy_deg": (0.0, 0.0, 90.0)}
    alone, one = NaoT14().build().capsules, Several(robots={"a": placed}).build().capsules
    assert [capsule.name for capsule in one] == [f"a/{capsule.name}" for capsule in alone]
    x, y, z = alone[0].start  # the torso, fixed to the base
    np.testing.assert_allclose(one[0].start, (-y, 1.0 + x, 0.5 + z), atol=1e-15)
    assert one[1].joint == f"a/{alone[1].joint}"
    assert one[1].start == alone[1].start


def test_several_robots_may_have_one_name() -> None:
    """Two of a kind were called "so101_new_calib + so101_new_calib"."""
    pair = {"robot": PlanarPair()}
    assert Several(robots={"a": pair, "b": pair}, name="two pairs").build().name == "two pairs"
    assert Several(robots={"a": pair}).build().name == PlanarPair().build().name


def test_a_robot_among_several_must_be_one() -> None:
    with pytest.raises(InvalidValueError, match="needs a robot"):
        Several(robots={"a": {"robot": "nao_t14"}})


TIPS = {"left": "l_hand", "right": "r_hand"}


def test_a_fault_of_one_of_several_names_the_robot() -> None:
    with pytest.raises(CoopqpError, match=r"robot a: no.urdf: cannot be read"):
        Several(robots={"a": {"robot": Urdf(path="no.urdf", arms=TIPS)}}).build()
