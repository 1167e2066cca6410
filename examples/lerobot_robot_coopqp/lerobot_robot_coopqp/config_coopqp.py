"""Options of the robot and of the teleoperator."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

from lerobot.robots.bi_so_follower import BiSOFollowerConfig
from lerobot.robots.config import RobotConfig
from lerobot.teleoperators.bi_so_leader.config_bi_so_leader import BiSOLeaderConfig
from lerobot.teleoperators.config import TeleoperatorConfig

import coopqp
from coopqp.adapters.chunk_filter import ChunkFilter
from coopqp.adapters.motors import MotorUnits


@dataclass
class Filter:
    """What the filter keeps: fields of coopqp's FilterSettings and MotorUnits."""

    scenario: str = "two_so101"
    fps: float = 30.0
    speed: float = 1.0
    gripper_speed: float = 250.0
    distance: float = 0.01
    holds_below: float = 30.0
    loop_position: float = 1e-3
    loop_orientation: float = 1e-2
    squeeze: float = 0.0
    signs: dict[str, int] = field(default_factory=dict)
    offsets_deg: dict[str, float] = field(default_factory=dict)

    def build(self, calibration: dict | None = None, *, use_degrees: bool = True) -> ChunkFilter:
        """A filter; the calibration by side bounds the joints as the servos do."""
        given = dataclasses.asdict(self)
        scenario = coopqp.load(given.pop("scenario"))
        units = MotorUnits(
            signs=given.pop("signs"),
            offsets_deg=given.pop("offsets_deg"),
            use_degrees=use_degrees,
            calibration=calibration or {},
        )
        return ChunkFilter(scenario, units, **given)


@RobotConfig.register_subclass("coopqp_bi_so_follower")
@dataclass
class CoopqpBiSOFollowerConfig(BiSOFollowerConfig):
    """Two followers whose actions are filtered before they are sent."""

    filter: Filter = field(default_factory=Filter)


@TeleoperatorConfig.register_subclass("coopqp_bi_so_leader")
@dataclass
class CoopqpBiSOLeaderConfig(BiSOLeaderConfig):
    """Two leaders that move one object while both grippers are closed."""

    filter: Filter = field(default_factory=lambda: Filter(fps=60.0, squeeze=0.004))
