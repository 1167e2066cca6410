"""The filter as a step of a robot action processor."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

from lerobot.processor import ProcessorStepRegistry, RobotActionProcessorStep, TransitionKey

from coopqp.adapters.motors import KEYS
from lerobot_robot_coopqp.config_coopqp import Filter


@ProcessorStepRegistry.register("coopqp_filter")
@dataclass
class CoopqpFilterStep(RobotActionProcessorStep):
    """The nearest action that keeps all limits; the first one begins at the observation.

    Its pipeline needs ``to_transition=robot_action_observation_to_transition``.
    """

    filter: Filter = field(default_factory=Filter)

    def __post_init__(self) -> None:
        if isinstance(self.filter, dict):
            self.filter = Filter(**self.filter)
        self._filter = self.filter.build()

    def action(self, action: dict) -> dict:
        start = None
        if not self._filter.begun:
            seen = self.transition[TransitionKey.OBSERVATION] or {}
            start = {key: float(seen[key]) for key in KEYS}
        found = self._filter.filter_chunk([action], start)
        self.found = found
        return found.actions[0]

    def transform_features(self, features: Any) -> Any:
        return features

    def reset(self) -> None:
        self._filter.reset()

    def get_config(self) -> dict[str, Any]:
        return {"filter": dataclasses.asdict(self.filter)}
