"""Two or more robots side by side: one model, names as "left/panda_joint1"."""

from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from pydantic import Field, PlainValidator, ValidationInfo, WithJsonSchema

from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.spec import Pose, spec, type_name
from coopqp.grasp import pose_matrix
from coopqp.robot import Arm, Capsule, Robot, RobotModel, Shape, copy_per_velocity


def _read(value: Any, info: ValidationInfo) -> Robot:
    """A robot as it is, or spelled as in a scenario file."""
    if isinstance(value, Robot):
        return value
    read = (info.context or {}).get("robot")
    if read is None:
        raise ValueError("needs a robot")
    robot: Robot = read(value)
    return robot


SPELLING = {"type": ["string", "object"], "description": "One robot by name, with its fields."}


@spec
class Placed(Pose):
    """A robot and where its base is in the world."""

    robot: Annotated[Robot, PlainValidator(_read), WithJsonSchema(SPELLING)]
    """Which robot, as under the scenario's key robot."""


@spec
class Several(Robot):
    """Separate robots placed in one world."""

    robots: Annotated[dict[str, Placed], Field(min_length=1)]
    """By name: {robot: ..., position: [m], rpy or rpy_deg}."""
    name: str = ""
    """Of all together, as pages show it; the robots' own names if omitted."""

    def build(self) -> RobotModel:
        """All joints, robot by robot; joints, frames and arms have the robot's name in front."""
        parts = [_part(name, placed) for name, placed in self.robots.items()]
        model = pin.Model()
        for (_, placed), part in zip(self.robots.items(), parts, strict=True):
            model = pin.appendModel(model, part.model, 0, pose_matrix(placed))
        for part in parts:  # appendModel forgets the armatures
            copy_per_velocity(part.model, model)
        model.name = "several"
        keys = ("arms", "shapes", "capsules", "collision_shapes", "unseen", "warnings")
        joined: dict[str, Any] = {
            key: tuple(item for part in parts for item in getattr(part, key)) for key in keys
        }
        name = self.name or " + ".join(part.name for part in parts)
        return RobotModel(name=name, model=model, **joined)


def _part(name: str, placed: Placed) -> RobotModel:
    try:
        robot = placed.robot.build()
    except CoopqpError as error:
        inside = InvalidValueError(f"robot {name}: {error}").at(*error.keys)
        kind = type_name(type(placed.robot))
        raise inside.at("robots", name, "robot", kind) from error
    return _renamed(f"{name}/", robot, pose_matrix(placed))


def _renamed(prefix: str, robot: RobotModel, X_WB: pin.SE3) -> RobotModel:
    """The robot with a prefix to every name, and what is fixed to its base put into the world."""
    model = robot.model.copy()
    for j in range(1, model.njoints):
        model.names[j] = prefix + model.names[j]
    for frame in model.frames:
        frame.name = prefix + frame.name
    return replace(
        robot,
        model=model,
        arms=tuple(Arm(name=prefix + arm.name, tip=prefix + arm.tip) for arm in robot.arms),
        shapes=_renamed_shapes(prefix, robot.shapes),
        collision_shapes=_renamed_shapes(prefix, robot.collision_shapes),
        capsules=tuple(_renamed_capsule(prefix, capsule, X_WB) for capsule in robot.capsules),
        unseen=tuple(prefix + line for line in robot.unseen),
        warnings=tuple(prefix.removesuffix("/") + ": " + line for line in robot.warnings),
    )


def _renamed_shapes(prefix: str, shapes: tuple[Shape, ...]) -> tuple[Shape, ...]:
    return tuple(replace(shape, frame=prefix + shape.frame) for shape in shapes)


def _renamed_capsule(prefix: str, capsule: Capsule, X_WB: pin.SE3) -> Capsule:
    named = replace(capsule, name=prefix + capsule.name)
    if capsule.joint is not None:
        return replace(named, joint=prefix + capsule.joint)
    start, end = (X_WB.act(np.array(point)).tolist() for point in (capsule.start, capsule.end))
    return replace(named, start=tuple(start), end=tuple(end))
