"""Two SCARA arms side by side: two hinges, a hinge at the wrist, a slide up and down."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from coopqp import Arm, Robot, RobotModel, spec

#: Joint: pinocchio's type, effort [N m, N], speed [rad/s, m/s], range both ways [rad, m].
JOINTS = {
    "shoulder": (pin.JointModelRZ(), 50.0, 3.0, 2.6),
    "elbow": (pin.JointModelRZ(), 50.0, 3.0, 2.6),
    "wrist": (pin.JointModelRZ(), 10.0, 6.0, math.pi),
    "lift": (pin.JointModelPZ(), 100.0, 0.5, 0.15),
}


@spec
class TwoScaras(Robot):
    """Two SCARA arms of four joints; x forward, y left, z up."""

    link: float = 0.3
    """Length of upper arm and forearm [m]."""
    distance: float = 0.5
    """Between the two shoulders [m]."""
    mass: float = 2.0
    """Of each link [kg]."""

    def build(self) -> RobotModel:
        """Eight joints, right arm first, with tips right_hand and left_hand."""
        model = pin.Model()
        for side, y in (("right", -0.5 * self.distance), ("left", 0.5 * self.distance)):
            self._add_arm(model, side, y)
        arms = tuple(Arm(name=side, tip=f"{side}_hand") for side in ("right", "left"))
        return RobotModel(name="two_scaras", model=model, arms=arms)

    def _add_arm(self, model: pin.Model, side: str, y: float) -> None:
        along = np.array([self.link, 0.0, 0.0])
        places = (np.array([0.0, y, 0.0]), along, along, np.zeros(3))
        parent = 0
        for (name, (joint, effort, speed, reach)), place in zip(
            JOINTS.items(), places, strict=True
        ):
            parent = model.addJoint(
                parent, joint, pin.SE3(np.eye(3), place), f"{side}_{name}",
                np.array([effort]), np.array([speed]), np.array([-reach]), np.array([reach]),
            )  # fmt: skip
            body = pin.Inertia.FromBox(self.mass, self.link, 0.05, 0.05)
            model.appendBodyToJoint(parent, body, pin.SE3.Identity())
        model.addFrame(
            pin.Frame(f"{side}_hand", parent, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME)
        )
