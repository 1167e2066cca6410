"""The YAML keys that robots from files and tables share: arms, free and locked joints, limits."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator

from coopqp.base.spec import NonNegative, Positive, spec
from coopqp.grasp import range_fault


@spec
class ArmJoints:
    """Tip and joints of an arm."""

    tip: str
    """Frame of the hand: a link, joint or site of the robot."""
    joints: tuple[str, ...] | None = None
    """Those that this arm moves by; all between base and tip when omitted."""


class _TipAlone:
    """Lets an arm be its tip's name alone, also in the JSON Schema."""

    @staticmethod
    def read(value: Any) -> Any:
        if isinstance(value, dict | ArmJoints):
            return value
        if type(value) not in (str, int):  # a number may be a row of an MDH table
            raise ValueError("needs the tip's frame, or {tip: frame, joints: [...]}")
        return {"tip": str(value)}

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Any:
        return {"anyOf": [{"type": "string"}, handler(core)]}


class _NamesAlone:
    """Lets locked joints be a list of names, also in the JSON Schema."""

    @staticmethod
    def read(value: Any) -> Any:
        if isinstance(value, list | tuple) and all(isinstance(name, str) for name in value):
            return dict.fromkeys(value)
        if not isinstance(value, dict):
            raise ValueError("needs a list of joints, or joints with values")
        return value

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Any:
        return {"anyOf": [{"type": "array", "items": {"type": "string"}}, handler(core)]}


def _some_arms(value: Any) -> Any:
    if not isinstance(value, dict) or not value:
        raise ValueError("needs arms by name, such as {right: TIP, left: TIP}")
    return value


Arms = Annotated[
    dict[str, Annotated[ArmJoints, BeforeValidator(_TipAlone.read), _TipAlone()]],
    BeforeValidator(_some_arms),
]
"""Arms by name, each its tip's frame or {tip: frame, joints: [...]}; the first is the reference."""

Locked = Annotated[dict[str, float | None], BeforeValidator(_NamesAlone.read), _NamesAlone()]
"""Joints that stay where they are: names, or names with values [rad or m]."""


@spec
class JointLimits:
    """Limits of a joint that replace those of the file."""

    lower: float | None = None
    """[rad or m]"""
    upper: float | None = None
    """[rad or m]"""
    velocity: Positive | None = None
    """[rad/s or m/s]"""
    effort: NonNegative | None = None
    """[N m or N]"""

    def __post_init__(self) -> None:
        if wrong := range_fault(self.lower, self.upper):
            raise ValueError(wrong)
