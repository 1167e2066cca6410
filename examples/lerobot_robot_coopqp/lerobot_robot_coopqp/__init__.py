"""LeRobot's two SO-101 behind coopqp's filter: a robot, a teleoperator and a processor's step."""

from lerobot_robot_coopqp.config_coopqp import (
    CoopqpBiSOFollowerConfig,
    CoopqpBiSOLeaderConfig,
    Filter,
)
from lerobot_robot_coopqp.coopqp import CoopqpBiSOFollower, CoopqpBiSOLeader
from lerobot_robot_coopqp.step import CoopqpFilterStep

__all__ = [
    "CoopqpBiSOFollower",
    "CoopqpBiSOFollowerConfig",
    "CoopqpBiSOLeader",
    "CoopqpBiSOLeaderConfig",
    "CoopqpFilterStep",
    "Filter",
]
