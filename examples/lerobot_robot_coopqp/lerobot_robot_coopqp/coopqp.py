"""The robot that filters what it sends, and the leaders that move one object."""

from __future__ import annotations

import dataclasses
from functools import cached_property

from lerobot.robots.bi_so_follower import BiSOFollower
from lerobot.teleoperators.bi_so_leader import BiSOLeader

from coopqp.adapters.chunk_filter import ChunkFilter
from coopqp.adapters.motors import JOINTS, SIDES
from lerobot_robot_coopqp.config_coopqp import CoopqpBiSOFollowerConfig, CoopqpBiSOLeaderConfig


class CoopqpBiSOFollower(BiSOFollower):
    """BiSOFollower; every action is the nearest one that keeps all limits.

    The first begins where the motors are; others where the last one led.
    """

    config_class = CoopqpBiSOFollowerConfig
    name = "coopqp_bi_so_follower"

    @cached_property
    def filter(self) -> ChunkFilter:
        """Built at the first connection, when the calibration files are read."""
        arms = dict(zip(SIDES, (self.left_arm, self.right_arm), strict=True))
        degrees = {side: arm.config.use_degrees for side, arm in arms.items()}
        if degrees["left"] != degrees["right"]:
            raise ValueError("use_degrees of both arms must be the same")
        read = {
            side: {joint: dataclasses.asdict(arm.calibration[joint]) for joint in JOINTS}
            for side, arm in arms.items()
            if arm.calibration
        }
        return self.config.filter.build(read, use_degrees=degrees["left"])

    def connect(self, calibrate: bool = True) -> None:
        super().connect(calibrate)
        self.filter.reset()
        self._start = self._positions()

    def send_action(self, action: dict) -> dict:
        found = self.filter.filter_chunk([action], self._start)
        self._start, self.found = None, found
        return super().send_action(found.actions[0])

    def _positions(self) -> dict[str, float]:
        return {
            f"{side}_{motor}.pos": value
            for side, arm in zip(SIDES, (self.left_arm, self.right_arm), strict=True)
            for motor, value in arm.bus.sync_read("Present_Position").items()
        }


class CoopqpBiSOLeader(BiSOLeader):
    """BiSOLeader; while both grippers are closed the leaders move one object.

    What they do alike moves it; what brings their hands closer becomes a squeeze of at most
    ``filter.squeeze``; what else they do differently is left out. The robot's own filter must allow
    the same squeeze.
    """

    config_class = CoopqpBiSOLeaderConfig
    name = "coopqp_bi_so_leader"

    @cached_property
    def filter(self) -> ChunkFilter:
        """LeRobot's leaders speak degrees, or shares of what their own calibration swept."""
        return self.config.filter.build()

    def get_action(self) -> dict:
        action = super().get_action()
        start = None if self.filter.begun else action
        return self.filter.filter_chunk([action], start).actions[0]

    def connect(self, calibrate: bool = True) -> None:
        super().connect(calibrate)
        self.filter.reset()
