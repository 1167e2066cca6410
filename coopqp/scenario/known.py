"""What of a scenario is the same as in one that has passed all checks before.

Variants of one file differ in a key or two. Robot, chain and trials of all others are then taken
from the variant before.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from coopqp.base.wording import Location
from coopqp.scenario.scenario import Scenario
from coopqp.scenario.trial import Places
from coopqp.task import Task

#: Keys of the file from which a chain follows, beside the start and the object.
CHAIN = ("robot", "grasp", "grasps", "weights", "folder")
#: Keys of the object that no task and no limit of the motion sees.
INERTIAL = ("mass", "com", "inertia")


class Known:
    """The last scenario that has passed, for who reads one variant of a file after the other.

    After :meth:`lend_chain` it says what else of the scenario that is read now is the same.
    """

    def __init__(self) -> None:
        self._data: Mapping[str, Any] = {}
        self._now: Mapping[str, Any] = {}
        self._scenario: Scenario | None = None
        self._places: Mapping[str, Places] = {}
        self._alike = False

    def keep(
        self, data: Mapping[str, Any], scenario: Scenario, places: Mapping[str, Places]
    ) -> None:
        """A scenario has passed; its tasks and limits were tried at these places, by phase."""
        self._data, self._scenario, self._places = data, scenario, places

    def lend_robot(self, data: Mapping[str, Any], scenario: Scenario) -> None:
        """Give a scenario the robot of the last one, where it is the same."""
        self._now, self._alike = data, False
        if self._scenario and self._same("robot", "folder"):
            vars(scenario)["robot_model"] = self._scenario.robot_model

    def lend_chain(self, scenario: Scenario) -> None:
        """Give it the closed chain as well, where it is the same but for the object's inertia."""
        before = self._scenario
        if before is None or not self._same_chain(before, scenario):
            return
        self._alike, chain = True, before.chain
        if scenario.held != before.held:
            chain = chain.carrying(scenario.held)
        vars(scenario)["chain"] = chain

    def place(self, phase: str) -> Places | None:
        """Where plug-ins were tried in a phase of the same chain."""
        return self._places.get(phase) if self._alike else None

    def task(self, at: Location, task: Task) -> bool:
        """Whether a task is the same, inputs are followed alike, and phases as long."""
        if not self._alike or task.of_forces or not self._same("inputs", "duration"):
            return False
        durations = [[p["duration"] for p in x.get("phases") or ()] for x in self._both]
        tasks = [_at(data, at) for data in self._both]
        return bool(durations[0] == durations[1] and tasks[0] == tasks[1])

    @property
    def limits(self) -> bool:
        """Whether all limits are the same."""
        return self._alike and self._same("limits", "dt", "start_outside")

    @property
    def _both(self) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
        return self._data, self._now

    def _same(self, *keys: str) -> bool:
        return all(self._data.get(key) == self._now.get(key) for key in keys)

    def _same_chain(self, before: Scenario, scenario: Scenario) -> bool:
        released = [[phase.released for phase in x.schedule] for x in (before, scenario)]
        objects = [
            {key: x for key, x in (data.get("object") or {}).items() if key not in INERTIAL}
            for data in self._both
        ]
        return (
            self._same(*CHAIN)
            and scenario.start == before.start
            and released[0] == released[1]
            and objects[0] == objects[1]
        )


def _at(data: Any, location: Location) -> Any:
    """What is at a place of a file; None where that is not."""
    for key in location:
        try:
            data = data[key]
        except (KeyError, IndexError, TypeError):
            return None
    return data
