"""LeRobot's two SO-101 (``bi_so_follower``, Feetech STS3215): names, units, zeros and signs.

LeRobot's zero is the middle of the range that was swept by hand, so that offsets of some degrees
are the rule. Sources: LeRobot 0.6.1, ``motors/motors_bus.py``, ``robots/bi_so_follower``.
"""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from coopqp.base.errors import InvalidValueError, UnreadableFileError, require_known
from coopqp.base.reading import read_text
from coopqp.base.spec import Array, spec
from coopqp.model.closed_chain import ClosedChain

SIDES = "left", "right"
JOINTS = "shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"
GRIPPER = "gripper"
#: Motors in LeRobot's order, and the keys of its actions and observations.
MOTORS = tuple(f"{side}_{joint}" for side in SIDES for joint in (*JOINTS, GRIPPER))
KEYS = tuple(f"{motor}.pos" for motor in MOTORS)
#: Columns of the arms' joints and of the grippers in an action.
ARMS, GRIPPERS = [0, 1, 2, 3, 4, 6, 7, 8, 9, 10], [5, 11]
MAX_BYTES = 1 << 20  # of a calibration file
COUNT = 360.0 / 4095.0  # degrees of a count, as LeRobot reckons


@spec
class MotorUnits:
    """What the numbers of two arms' motors say of the URDF's joints: q = sign motor + offset."""

    signs: dict[str, Literal[-1, 1]] = Field(default_factory=dict)
    """By motor, such as left_elbow_flex; 1 where omitted."""
    offsets_deg: dict[str, float] = Field(default_factory=dict)
    """By motor [degrees]; 0 where omitted."""
    use_degrees: bool = True
    """As in LeRobot's configuration; else -100 to 100 of each motor's range."""
    calibration: dict[str, dict[str, dict[str, int]]] = Field(default_factory=dict)
    """By side, what LeRobot's calibration file of that arm says; it bounds the joints, too."""

    def __post_init__(self) -> None:
        for key, names in (("signs", self.signs), ("offsets_deg", self.offsets_deg)):
            require_known("motor", names, [MOTORS[i] for i in ARMS], f"{key}: ")
        if not self.use_degrees and set(self.calibration) != set(SIDES):
            words = "needs both arms' calibration, as -100 to 100 are shares of a motor's range"
            raise InvalidValueError(f"use_degrees: {words}")
        for side, joint in ((s, j) for s in self.calibration for j in JOINTS):
            own = self.calibration[side].get(joint, {})
            if side not in SIDES or not own.get("range_min", 0) < own.get("range_max", 0):
                words = "needs range_min < range_max, and sides left, right"
                raise InvalidValueError(f"calibration.{side}.{joint}: {words}")

    @classmethod
    def read(cls, left: Path | str, right: Path | str, **others: Any) -> MotorUnits:
        """With LeRobot's calibration files, ``<id>_left.json`` and ``<id>_right.json``.

        Raises:
            CoopqpError: a file cannot be read, or is no calibration.
        """
        found = {}
        for side, file in zip(SIDES, (left, right), strict=True):
            try:
                found[side] = json.loads(read_text(Path(file), MAX_BYTES))
            except ValueError as error:
                words = f"is no calibration of LeRobot, which is JSON: {error}"
                raise UnreadableFileError(file, words) from None
        return cls(calibration=found, **others)

    @cached_property
    def half_range(self) -> Array:
        """Half of what each servo can go, shape (10,) [rad]; infinite without calibration."""
        ranges = [self._of(i, "range_max") - self._of(i, "range_min") for i in ARMS]
        return np.radians([0.5 * COUNT * r if r else np.inf for r in ranges])

    @property
    def unit(self) -> str:
        """Of the arms' numbers: deg, or % of half of a range."""
        return "deg" if self.use_degrees else "%"

    @cached_property
    def scale(self) -> Array:
        """How far a joint goes where its motor goes by one unit, shape (10,) [rad]."""
        signs = np.array([self.signs.get(MOTORS[i], 1) for i in ARMS], float)
        if self.use_degrees:
            return np.asarray(np.radians(signs))
        turned = np.array([-1.0 if self._of(i, "drive_mode") else 1.0 for i in ARMS])
        return np.asarray(signs * turned * self.half_range / 100.0)

    @cached_property
    def offset(self) -> Array:
        """Where a joint is when its motor says 0, shape (10,) [rad]."""
        return np.radians([self.offsets_deg.get(MOTORS[i], 0.0) for i in ARMS])

    def _of(self, i: int, key: str) -> int:
        side, _, joint = MOTORS[i].partition("_")
        return self.calibration.get(side, {}).get(joint, {}).get(key, 0)

    def joints(self, actions: Array) -> Array:
        """The arms' joints at actions (N, 12), left before right, shape (N, 10) [rad]."""
        return np.asarray(actions[:, ARMS] * self.scale + self.offset)

    def motors(self, q: Array) -> Array:
        """The arms' part of actions at joints (N, 10), shape (N, 10)."""
        return np.asarray((q - self.offset) / self.scale)

    def bounded(self, chain: ClosedChain) -> ClosedChain:
        """The chain with both hands free of each other, its joints in the servos' ranges, too.

        InvalidValueError: its joints are not those of two SO-101, such as left/shoulder_pan.
        """
        wanted = tuple(f"{side}/{joint}" for side in SIDES for joint in JOINTS)
        if chain.joint_names != wanted:
            found = ", ".join(chain.joint_names)
            words = f"LeRobot's two arms need {', '.join(wanted)}, as in the scenario two_so101"
            raise InvalidValueError(f"robot: found joints {found}; {words}")
        robot = replace(chain.robot, model=chain.robot.model.copy())
        model = robot.model
        model.lowerPositionLimit = np.maximum(chain.lower, self.offset - self.half_range)
        model.upperPositionLimit = np.minimum(chain.upper, self.offset + self.half_range)
        return ClosedChain(replace(chain.hold, robot=robot, released=(robot.arms[1].name,)))
