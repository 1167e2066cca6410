"""The two arms of Aldebaran's NAO T14, from the paper's Table 1.

Base frame: x forward, y left, z up, at the torso. Lengths, limits and masses are those of NAO's v4
arm, which the T14 uses. Joint values are NAO's encoder angles: Table 1's theta_2 and theta_7 are
the encoder angle plus pi/2, because NAO's zero pose points the arms forward and the table's
points them sideways.
"""

import math

import numpy as np
import pinocchio as pin

from coopqp.base.spec import spec
from coopqp.robot import Arm, Capsule, Robot, RobotModel
from coopqp.robot_files import mdh

B1, R1, D3, R3, R5 = 0.100, 0.098, 0.015, 0.105, 0.05595  # [m], Table 1
HAND = (0.05775, 0.0, -0.01231)  # from the wrist, base axes at the zero pose [m]
QUARTER = math.pi / 2

#: Right arm: name, lower, upper [rad], velocity [rad/s], torque [N m].
JOINTS = (
    ("ShoulderPitch", -2.08567, 2.08567, 8.26797, 1.329),
    ("ShoulderRoll", -1.32645, 0.314159, 7.19407, 1.783),
    ("ElbowYaw", -2.08567, 2.08567, 8.26797, 1.547),
    ("ElbowRoll", 0.0349066, 1.54462, 7.19407, 1.532),
    ("WristYaw", -1.82387, 1.82387, 24.6229, 0.4075),
)

#: Joints whose sign changes when the right arm is mirrored into the left one.
MIRRORED = frozenset({"ShoulderRoll", "ElbowYaw", "ElbowRoll", "WristYaw"})

#: Right arm, base axes at the zero pose: mass [kg], com [m], ixx ixy ixz iyy iyz izz [kg m2].
LINKS = (
    (0.09304, (-0.00165, 0.02663, 0.00014),
     (1.83025e-05, -2.06011e-06, 1.88776e-09, 1.39005e-05, 3.66592e-07, 2.01862e-05)),
    (0.15777, (0.02455, -0.00563, 0.0033),
     (1.03401e-04, 5.48849e-05, -1.32643e-05, 2.70770e-04, 9.16707e-06, 2.54529e-04)),
    (0.06483, (-0.02744, 0.0, -0.00014),
     (5.59588e-06, 4.21e-09, 2.92241e-07, 2.66179e-05, -1.84e-09, 2.76294e-05)),
    (0.07761, (0.02556, -0.00281, 0.00076),
     (2.47331e-05, -3.24180e-06, 9.06451e-07, 3.84719e-05, -1.38804e-07, 3.59319e-05)),
    (0.18533, (0.03434, 0.00088, 0.00308),
     (6.86477e-05, 1.13165e-05, -2.87254e-06, 1.35756e-04, 3.68003e-06, 1.33228e-04)),
)  # fmt: skip

#: Right arm, base axes at the zero pose: body, joint, start, end, radius [m]. Radii enclose the
#: covers of NAO's links but for the fingers.
BODIES = (
    ("UpperArm", "ShoulderRoll", (0.0, -R1, B1), (R3, -R1 - D3, B1), 0.03),
    ("Forearm", "ElbowRoll", (R3, -R1 - D3, B1), (R3 + R5, -R1 - D3, B1), 0.025),
    ("Hand", "WristYaw", (R3 + R5, -R1 - D3, B1),
     (R3 + R5 + HAND[0], -R1 - D3, B1 + HAND[2]), 0.03),
)  # fmt: skip

#: Around the base's z axis, from the hips to the neck [m].
TORSO = Capsule(
    name="torso", joint=None, start=(0.0, 0.0, -0.1), end=(0.0, 0.0, 0.12), radius=0.055
)


def arm_table(side: str) -> list[mdh.MdhRow]:
    """Five rows of Table 1: "R" for joints 1-5, "L" for joints 6-10."""
    y = -1.0 if side == "R" else 1.0
    parameters = (
        mdh.MdhParameters(b=B1, alpha=-QUARTER, r=y * R1),
        mdh.MdhParameters(alpha=QUARTER, theta=QUARTER),
        mdh.MdhParameters(alpha=QUARTER, d=y * D3, r=R3),
        mdh.MdhParameters(alpha=-QUARTER),
        mdh.MdhParameters(alpha=QUARTER, r=R5),
    )
    rows: list[mdh.MdhRow] = []
    for p, joint, (mass, com, inertia) in zip(parameters, JOINTS, LINKS, strict=True):
        name, lower, upper, velocity, torque = joint
        if side == "L" and name in MIRRORED:
            lower, upper = -upper, -lower
        (x, _, z), (xx, xy, xz, yy, yz, zz) = com, inertia
        rows.append(
            mdh.MdhRow(
                name=side + name,
                antecedent=rows[-1].name if rows else None,
                **vars(p),
                lower=lower, upper=upper, velocity=velocity, effort=torque, axes="base",
                mass=mass, com=(x, -y * com[1], z), inertia=(xx, -y * xy, xz, yy, -y * yz, zz),
            )
        )  # fmt: skip
    return rows


def capsules(model: pin.Model) -> tuple[Capsule, ...]:
    """Torso, upper arms, forearms and hands."""
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    found = [TORSO]
    for side, y in (("R", 1.0), ("L", -1.0)):
        for name, joint, start, end, radius in BODIES:
            X_WJ = data.oMi[model.getJointId(side + joint)]
            a, b = (X_WJ.actInv(np.array([p[0], y * p[1], p[2]])).tolist() for p in (start, end))
            found.append(
                Capsule(
                    name=side + name,
                    joint=side + joint,
                    start=tuple(a),
                    end=tuple(b),
                    radius=radius,
                )
            )
    return tuple(found)


@spec
class NaoT14(Robot):
    """NAO T14: two arms of five joints each, after the paper's Table 1."""

    def build(self) -> RobotModel:
        """The ten joints of both arms, right arm first, with hands "RHand" and "LHand"."""
        tips = {
            "RHand": mdh.Tip(parent="RWristYaw", offset=HAND),
            "LHand": mdh.Tip(parent="LWristYaw", offset=HAND),
        }
        model = mdh.build_model("nao_t14", arm_table("R") + arm_table("L"), tips)
        arms = (Arm(name="right", tip="RHand"), Arm(name="left", tip="LHand"))
        return RobotModel(name="nao_t14", model=model, arms=arms, capsules=capsules(model))
