"""What can be said of the node, as parameters of ROS; and which controller moves which joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from coopqp.base.errors import InvalidValueError, UnknownNameError
from coopqp.base.spec import NonNegative, Positive, spec
from coopqp.model.closed_chain import ClosedChain


@spec
class RosSettings:
    """Parameters of the node."""

    controllers: Annotated[list[str], Field(min_length=1)]
    """Of ros2_control; each is sent velocities on /NAME/commands."""
    law: str = "qp"
    """The scenario's controller that decides."""
    reference: Literal["commanded", "measured"] = "commanded"
    """As :class:`coopqp.OnlineLoop` has it, and so the next one."""
    grasp: Literal["as_held", "as_written"] = "as_held"
    """Whether the object is held as the hands are at the first tick."""
    joint_states: str = "/joint_states"
    """Topic on which the robot says where it is."""
    frame: str = "world"
    """The scenario's world in ROS; targets in another frame are refused."""
    silent_after: Positive = 0.1
    """How long joint states may fail to come before the robot counts as silent [s]."""
    patience: Positive = 0.25
    """How long after that the loop stops [s]."""
    position_gain: NonNegative = 1.0
    """Share of its distance to where it was commanded that a joint makes good a second [1/s]."""
    diagnostics_every: Positive = 0.1
    """Time between two messages on /diagnostics [s]."""
    out: str = ""
    """Folder for the session; none if empty."""


def ros_name(joint: str) -> str:
    """What ROS calls a joint; of several robots in one scenario ``left/joint1`` is left_joint1."""
    return joint.replace("/", "_")


@dataclass(frozen=True)
class Joints:
    """The robot's own joints, and who moves them.

    Attributes:
        names: in ROS, in the loop's order without the grasps' passive joints.
        own: their places in q.
        ordered: by controller, places in q of its joints in its order.
    """

    names: tuple[str, ...]
    own: NDArray[np.intp]
    ordered: Mapping[str, NDArray[np.intp]]


def joints_of(
    chain: ClosedChain, controllers: Sequence[str], orders: Mapping[str, Sequence[str]]
) -> Joints:
    """Who moves which joint.

    Args:
        chain: whose joints.
        controllers: of ros2_control, by name.
        orders: the joints of each; a single controller without an order moves all.

    Raises:
        CoopqpError: a joint is unknown, moved twice or not at all, or an order is missing.
    """
    own = np.setdiff1d(np.arange(chain.n), chain.passive)
    places = {ros_name(chain.joint_names[i]): int(i) for i in own}
    ordered: dict[str, NDArray[np.intp]] = {}
    moved: list[str] = []
    for name in controllers:
        given = orders.get(name) or (list(places) if len(controllers) == 1 else [])
        if not given:
            words = "several controllers need each their joints, in their order"
            raise InvalidValueError(f"{name}.joints: {words}")
        for joint in given:
            if joint not in places:
                raise UnknownNameError("joint", joint, places, f"{name}.joints: ")
            if joint in moved:
                raise InvalidValueError(f"{name}.joints: '{joint}' is there twice")
            moved.append(joint)
        ordered[name] = np.array([places[joint] for joint in given])
    if left := [joint for joint in places if joint not in moved]:
        raise InvalidValueError(f"joints: no controller moves {', '.join(left)}")
    return Joints(tuple(places), own, ordered)
