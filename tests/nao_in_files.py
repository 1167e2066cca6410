"""NAO written out as URDF, as MJCF and as a table."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pinocchio as pin

from coopqp.robot import Robot, RobotModel
from coopqp.robot_files.mdh import Tip
from coopqp.robots import MdhTable, Mjcf, NaoT14, Urdf, nao_t14

HANDS = {"right": "RHand", "left": "LHand"}


def words(numbers: Any) -> str:
    """Numbers as they stand in XML, exact."""
    return " ".join(repr(float(number)) for number in numbers)


def six(inertia: pin.Inertia) -> list[float]:
    """Ixx iyy izz ixy ixz iyz."""
    I = inertia.inertia  # noqa: E741
    return [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]


def urdf_text(robot: RobotModel) -> str:
    """A robot with joints about z as URDF."""
    model = robot.model
    links = {0: "base", **{j: f"{model.names[j]}_link" for j in range(1, model.njoints)}}
    lines = ['<robot name="nao">', '<link name="base"/>']
    for j in range(1, model.njoints):
        body = model.inertias[j]
        keys = zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), six(body), strict=True)
        inertia = " ".join(f'{key}="{float(value)!r}"' for key, value in keys)
        lines.append(
            f'<link name="{links[j]}"><inertial><origin xyz="{words(body.lever)}"/>'
            f'<mass value="{words([body.mass])}"/><inertia {inertia}/></inertial></link>'
            f'<joint name="{model.names[j]}" type="revolute">{origin(model.jointPlacements[j])}'
            f'<parent link="{links[model.parents[j]]}"/><child link="{links[j]}"/>'
            f'<axis xyz="0 0 1"/><limit {urdf_limits(model, j)}/></joint>'
        )
    for arm in robot.arms:
        tip = model.frames[model.getFrameId(arm.tip)]
        lines.append(
            f'<link name="{arm.tip}"/><joint name="{arm.tip}_mount" type="fixed">'
            f'{origin(tip.placement)}<parent link="{links[tip.parentJoint]}"/>'
            f'<child link="{arm.tip}"/></joint>'
        )
    return "\n".join([*lines, "</robot>"])


def origin(X: pin.SE3) -> str:
    return f'<origin xyz="{words(X.translation)}" rpy="{words(pin.rpy.matrixToRpy(X.rotation))}"/>'


def urdf_limits(model: pin.Model, j: int) -> str:
    keys = {
        "lower": model.lowerPositionLimit,
        "upper": model.upperPositionLimit,
        "velocity": model.velocityLimit,
        "effort": model.effortLimit,
    }
    return " ".join(f'{key}="{words(values[j - 1 : j])}"' for key, values in keys.items())


def mjcf_text(robot: RobotModel) -> str:
    """A robot with joints about z as MJCF: one body in the world for each arm."""
    model = robot.model

    def pose(X: pin.SE3) -> str:
        x, y, z, w = pin.Quaternion(X.rotation).coeffs()
        return f'pos="{words(X.translation)}" quat="{words([w, x, y, z])}"'

    def body(j: int) -> str:
        link = model.inertias[j]
        ends = words([model.lowerPositionLimit[j - 1], model.upperPositionLimit[j - 1]])
        torque = model.effortLimit[j - 1]
        tips = [f for f in model.frames if f.parentJoint == j and f.name in HANDS.values()]
        sites = "".join(f'<site name="{tip.name}" {pose(tip.placement)}/>' for tip in tips)
        inside = "".join(body(k) for k in range(1, model.njoints) if model.parents[k] == j)
        return (
            f'<body name="{model.names[j]}_link" {pose(model.jointPlacements[j])}>'
            f'<joint name="{model.names[j]}" axis="0 0 1" range="{ends}" '
            f'actuatorfrcrange="{words([-torque, torque])}"/>'
            f'<inertial mass="{words([link.mass])}" pos="{words(link.lever)}" '
            f'fullinertia="{words(six(link))}"/>{sites}{inside}</body>'
        )

    arms = "".join(body(j) for j in range(1, model.njoints) if model.parents[j] == 0)
    return (
        '<mujoco model="nao"><compiler angle="radian" autolimits="true"/>'
        f"<worldbody>{arms}</worldbody></mujoco>"
    )


def in_urdf(folder: Path) -> Robot:
    (folder / "nao.urdf").write_text(urdf_text(NaoT14().build()), encoding="utf-8")
    return Urdf(path=folder / "nao.urdf", arms=HANDS)


def in_mjcf(folder: Path) -> Robot:
    (folder / "nao.xml").write_text(mjcf_text(NaoT14().build()), encoding="utf-8")
    speeds = {f"*{name}": {"velocity": speed} for name, _, _, speed, _ in nao_t14.JOINTS}
    return Mjcf(path=folder / "nao.xml", arms=HANDS, joint_limits=speeds)


def in_table(_: Path) -> Robot:
    rows = tuple(
        replace(row, alpha=None, alpha_deg=math.degrees(row.parameters.alpha))
        for row in [*nao_t14.arm_table("R"), *nao_t14.arm_table("L")]
    )
    tips = {f"{s}Hand": Tip(parent=f"{s}WristYaw", offset=nao_t14.HAND) for s in "RL"}
    return MdhTable(rows=rows, tips=tips, arms=HANDS)
