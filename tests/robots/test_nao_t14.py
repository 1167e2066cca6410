"""NAO T14 against a chain written by hand in NAO's own joint axes, and its mirror image."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from coopqp.base.spec import Array
from coopqp.robot import RobotModel

RIGHT, LEFT = slice(0, 5), slice(5, 10)
SIDES = [pytest.param("R", id="right"), pytest.param("L", id="left")]
NAMES = ("ShoulderPitch", "ShoulderRoll", "ElbowYaw", "ElbowRoll", "WristYaw")
AXES = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0], [0, 0, 1], [1, 0, 0]], float)
MIRROR = np.array([1, -1, -1, -1, -1])  # of joint values, right to left
HAND = np.array([0.05775, 0, -0.01231])  # from the wrist [m]

# lower, upper [rad], velocity [rad/s], torque [N m] of the right arm.
LIMITS = np.array([
    [-2.08567, 2.08567, 8.26797, 1.329],
    [-1.32645, 0.314159, 7.19407, 1.783],
    [-2.08567, 2.08567, 8.26797, 1.547],
    [0.0349066, 1.54462, 7.19407, 1.532],
    [-1.82387, 1.82387, 24.6229, 0.4075],
])  # fmt: skip

# Right arm, in joint frames with the base's axes at the zero pose [kg], [m], [kg m2].
MASS = np.array([0.09304, 0.15777, 0.06483, 0.07761, 0.18533])
COM = np.array([
    [-0.00165, 0.02663, 0.00014],
    [0.02455, -0.00563, 0.0033],
    [-0.02744, 0, -0.00014],
    [0.02556, -0.00281, 0.00076],
    [0.03434, 0.00088, 0.00308],
])  # fmt: skip
INERTIA = np.array([  # ixx ixy ixz iyy iyz izz
    [1.83025e-05, -2.06011e-06, 1.88776e-09, 1.39005e-05, 3.66592e-07, 2.01862e-05],
    [1.03401e-04, 5.48849e-05, -1.32643e-05, 2.70770e-04, 9.16707e-06, 2.54529e-04],
    [5.59588e-06, 4.21e-09, 2.92241e-07, 2.66179e-05, -1.84e-09, 2.76294e-05],
    [2.47331e-05, -3.24180e-06, 9.06451e-07, 3.84719e-05, -1.38804e-07, 3.59319e-05],
    [6.86477e-05, 1.13165e-05, -2.87254e-06, 1.35756e-04, 3.68003e-06, 1.33228e-04],
])  # fmt: skip


def part(side: str) -> slice:
    return RIGHT if side == "R" else LEFT


def rotation(axis: Array, angle: float) -> Array:
    """Rodrigues' formula."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K


def arm_by_hand(side: str, q: Array) -> tuple[Array, Array, Array]:
    """Joint rotations (5, 3, 3), joint origins (5, 3) and the hand (3,) of NAO's own chain."""
    y = -1.0 if side == "R" else 1.0
    offsets = np.array([
        [0, y * 0.098, 0.100],
        [0, 0, 0],
        [0.105, y * 0.015, 0],
        [0, 0, 0],
        [0.05595, 0, 0],
    ])  # fmt: skip
    R, p = np.eye(3), np.zeros(3)
    turns, origins = [], []
    for offset, axis, angle in zip(offsets, AXES, q, strict=True):
        p = p + R @ offset
        R = R @ rotation(axis, angle)
        turns.append(R)
        origins.append(p)
    return np.array(turns), np.array(origins), p + R @ HAND


def placed(nao: RobotModel, q: Array) -> pin.Data:
    data = nao.model.createData()
    pin.framesForwardKinematics(nao.model, data, q)
    return data


def hand(nao: RobotModel, data: pin.Data, side: str) -> pin.SE3:
    return data.oMf[nao.model.getFrameId(f"{side}Hand")]


def random_pose(rng: np.random.Generator) -> Array:
    return rng.uniform(-1.5, 1.5, 10)


def mirrored(q: Array) -> Array:
    """The same motion in a mirror at the plane y = 0."""
    return np.concatenate([MIRROR * q[LEFT], MIRROR * q[RIGHT]])


def test_joints_are_named_as_naos_right_arm_first(nao: RobotModel) -> None:
    assert nao.joint_names == tuple(side + name for side in "RL" for name in NAMES)
    assert [(arm.name, arm.tip) for arm in nao.arms] == [("right", "RHand"), ("left", "LHand")]
    for arm, side in zip(nao.arms, "RL", strict=True):
        assert nao.arm_joints(arm) == tuple(side + name for name in NAMES)


@pytest.mark.parametrize("side", SIDES)
def test_zero_pose_stretches_the_arms_forward(nao: RobotModel, side: str) -> None:
    y = -1.0 if side == "R" else 1.0
    X = hand(nao, placed(nao, np.zeros(10)), side)
    reach = [0.105 + 0.05595 + 0.05775, y * (0.098 + 0.015), 0.100 - 0.01231]
    np.testing.assert_allclose(X.translation, reach, atol=1e-15)
    np.testing.assert_allclose(X.rotation, np.eye(3), atol=1e-15)


@pytest.mark.parametrize("side", SIDES)
def test_start_pose_puts_the_hands_beside_a_box(nao: RobotModel, side: str) -> None:
    y = -1.0 if side == "R" else 1.0
    right = np.array([0.7, -0.2, 1.2, 0.9, 0.1])
    data = placed(nao, np.concatenate([right, MIRROR * right]))
    wanted = [0.186, y * 0.104, 0.047]
    np.testing.assert_allclose(hand(nao, data, side).translation, wanted, atol=5e-4)


@pytest.mark.parametrize("side", SIDES)
def test_frames_follow_naos_own_joint_axes(
    nao: RobotModel, side: str, rng: np.random.Generator
) -> None:
    """Origins agree; orientations agree up to how the table's axes lie at the zero pose."""
    zero = placed(nao, np.zeros(10))
    for _ in range(50):
        q = random_pose(rng)
        data = placed(nao, q)
        turns, origins, tip = arm_by_hand(side, q[part(side)])
        for name, turn, origin in zip(NAMES, turns, origins, strict=True):
            joint = nao.model.getJointId(side + name)
            np.testing.assert_allclose(data.oMi[joint].translation, origin, atol=1e-14)
            table = data.oMi[joint].rotation @ zero.oMi[joint].rotation.T
            np.testing.assert_allclose(table, turn, atol=1e-14)
        np.testing.assert_allclose(hand(nao, data, side).translation, tip, atol=1e-14)
        np.testing.assert_allclose(hand(nao, data, side).rotation, turns[-1], atol=1e-14)


def test_right_arm_has_naos_limits(nao: RobotModel) -> None:
    model = nao.model
    found = [model.lowerPositionLimit, model.upperPositionLimit, model.velocityLimit]
    found.append(model.effortLimit)
    np.testing.assert_array_equal(np.array(found)[:, RIGHT].T, LIMITS)


def test_left_arm_has_the_mirrored_limits(nao: RobotModel) -> None:
    model = nao.model
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    ends = np.sort([MIRROR * lower[RIGHT], MIRROR * upper[RIGHT]], axis=0)
    np.testing.assert_array_equal([lower[LEFT], upper[LEFT]], ends)
    np.testing.assert_array_equal(model.velocityLimit[LEFT], model.velocityLimit[RIGHT])
    np.testing.assert_array_equal(model.effortLimit[LEFT], model.effortLimit[RIGHT])
    assert (lower[6], upper[6]) == (-0.314159, 1.32645)
    assert (lower[8], upper[8]) == (-1.54462, -0.0349066)


def test_mirrored_joints_move_the_hands_as_in_a_mirror(
    nao: RobotModel, rng: np.random.Generator
) -> None:
    M = np.diag([1.0, -1.0, 1.0])
    for _ in range(20):
        q = random_pose(rng)
        data, image = placed(nao, q), placed(nao, mirrored(q))
        for side, other in ("RL", "LR"):
            X, Y = hand(nao, data, side), hand(nao, image, other)
            np.testing.assert_allclose(Y.translation, M @ X.translation, atol=1e-14)
            np.testing.assert_allclose(Y.rotation, M @ X.rotation @ M, atol=1e-14)


def test_both_arms_weigh_the_same(nao: RobotModel) -> None:
    mass = np.array([body.mass for body in nao.model.inertias])[1:]
    np.testing.assert_allclose(mass[RIGHT], MASS)
    np.testing.assert_allclose(mass[LEFT], MASS)
    assert pin.computeTotalMass(nao.model) == pytest.approx(2 * 0.57858)


def test_mirrored_motion_has_the_same_energy(nao: RobotModel, rng: np.random.Generator) -> None:
    data = nao.model.createData()
    for _ in range(20):
        q, v = random_pose(rng), rng.normal(size=10)
        energy = [
            (
                pin.computeKineticEnergy(nao.model, data, a, b),
                pin.computePotentialEnergy(nao.model, data, a),
            )
            for a, b in ((q, v), (mirrored(q), mirrored(v)))
        ]
        np.testing.assert_allclose(energy[0], energy[1], rtol=1e-12, atol=1e-15)


def kinetic_energy_by_hand(q: Array, v: Array, h: float = 1e-5) -> float:
    """Of the right arm, from central differences of where its links are."""
    R = arm_by_hand("R", q)[0]
    R_1, p_1, _ = arm_by_hand("R", q - h * v)
    R_2, p_2, _ = arm_by_hand("R", q + h * v)
    energy = 0.0
    for j, (xx, xy, xz, yy, yz, zz) in enumerate(INERTIA):
        speed = (p_2[j] + R_2[j] @ COM[j] - p_1[j] - R_1[j] @ COM[j]) / (2 * h)
        S = R[j].T @ (R_2[j] - R_1[j]) / (2 * h)  # skew matrix of omega in the link
        omega = 0.5 * np.array([S[2, 1] - S[1, 2], S[0, 2] - S[2, 0], S[1, 0] - S[0, 1]])
        moment = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        energy += 0.5 * (MASS[j] * speed @ speed + omega @ moment @ omega)
    return energy


def test_kinetic_energy_is_that_of_naos_links(nao: RobotModel, rng: np.random.Generator) -> None:
    data = nao.model.createData()
    for _ in range(20):
        q, v = random_pose(rng), np.concatenate([rng.normal(size=5), np.zeros(5)])
        wanted = kinetic_energy_by_hand(q[RIGHT], v[RIGHT])
        found = pin.computeKineticEnergy(nao.model, data, q, v)
        assert found == pytest.approx(wanted, rel=1e-7)
