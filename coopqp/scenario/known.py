"""What of a scenario is the same as in one that has passed all checks before.

Variants of one file differ in a key or two. Robot, chain and trials of all others are then taken
from the variant before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from coopqp.scenario.scenario import Scenario
from coopqp.scenario.trial import Places
from coopqp.task import Task
from coopqp.wording import Location

#: Keys of the file from which a chain follows, beside the start and the object.
CHAIN = ("robot", "grasp", "grasps", "weights", "folder")
#: Keys of the object that no task and no limit of the motion sees.
INERTIAL = ("mass", "com", "inertia")


@dataclass(frozen=True)
class Checked:
    """A scenario that has passed all checks."""

    data: Mapping[str, Any]
    scenario: Scenario
    places: Mapping[str, Places]


class Known:
    """The scenario before, for who reads one variant of a file after the other."""

    def __init__(self) -> None:
        self.last: Checked | None = None

    def lend_robot(self, data: Mapping[str, Any], scenario: Scenario) -> None:
        """Give a scenario the robot of the last one, where it is the same."""
        if self.last and _same(self.last.data, data, ("robot", "folder")):
            vars(scenario)["robot_model"] = self.last.scenario.robot_model

    def lend_chain(self, data: Mapping[str, Any], scenario: Scenario) -> Alike:
        """Give it the closed chain as well; what else is the same."""
        last = self.last
        if last is None or not _same_chain(last, data, scenario):
            return Alike(data, None)
        chain = last.scenario.chain
        if scenario.held != last.scenario.held:
            chain = chain.carrying(scenario.held)
        vars(scenario)["chain"] = chain
        return Alike(data, last)


@dataclass(frozen=True)
class Alike:
    """What of a scenario is the same as in the last one.

    Attributes:
        data: of its file.
        last: with the same chain, but for the inertia of the object; None where there is none.
    """

    data: Mapping[str, Any]
    last: Checked | None

    def place(self, phase: str) -> Places | None:
        """Where plug-ins were tried in a phase."""
        return self.last.places.get(phase) if self.last else None

    def task(self, at: Location, task: Task) -> bool:
        """Whether a task is the same, in phases as long."""
        if self.last is None or task.of_forces or not self._as_long:
            return False
        return bool(_at(self.last.data, at) == _at(self.data, at))

    @cached_property
    def _as_long(self) -> bool:
        """Whether all phases take as long as they did, and inputs are followed alike."""
        last = self.last
        if last is None or not _same(last.data, self.data, ("inputs", "duration")):
            return False
        phases = ([p["duration"] for p in x.get("phases") or ()] for x in (last.data, self.data))
        return next(phases) == next(phases)

    @property
    def limits(self) -> bool:
        """Whether all limits are."""
        keys = ("limits", "dt", "start_outside")
        return self.last is not None and _same(self.last.data, self.data, keys)


def _same_chain(last: Checked, data: Mapping[str, Any], scenario: Scenario) -> bool:
    before = last.scenario
    released = [[phase.released for phase in one.schedule] for one in (before, scenario)]
    return (
        _same(last.data, data, CHAIN)
        and scenario.start == before.start
        and released[0] == released[1]
        and _moved_alike(last.data.get("object"), data.get("object"))
    )


def _moved_alike(one: Any, other: Any) -> bool:
    """Whether objects are the same but for their inertia."""
    parts = ({k: x for k, x in (held or {}).items() if k not in INERTIAL} for held in (one, other))
    return next(parts) == next(parts)


def _same(one: Mapping[str, Any], other: Mapping[str, Any], keys: tuple[str, ...]) -> bool:
    return all(one.get(key) == other.get(key) for key in keys)


def _at(data: Any, location: Location) -> Any:
    """What is at a place of a file; None where that is not."""
    for key in location:
        try:
            data = data[key]
        except (KeyError, IndexError, TypeError):
            return None
    return data
