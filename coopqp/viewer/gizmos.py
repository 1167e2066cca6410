"""From a gizmo's pose to what tasks are sent, and back; one gizmo for each task that has a goal.

A task may have two things to drag, such as a plane its point and its normal: the gizmo's place is
the one, its third axis the other.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from coopqp.checked import Array
from coopqp.scenario.scenario import Scenario
from coopqp.signal import Course
from coopqp.state import State
from coopqp.viewer.live import Live
from coopqp.viewer.messages import Gizmo

NOT_TURNED = (0.0, 0.0, 0.0, 1.0)


@dataclass
class Handle:
    """A gizmo and what it sends.

    Attributes:
        look: of the gizmo.
        point: of the object that its task moves, in the object frame, shape (3,) [m].
        lives: the fields that it steers.
    """

    look: Gizmo
    point: Array
    lives: list[Live] = field(default_factory=list)

    def pose(self, targets: Mapping[str, Array], state: State) -> Array:
        """Where it is, shape (7,)."""
        place, turn = state.point(self.point), np.array(NOT_TURNED)
        for live in self.lives:
            value = targets.get(live.name)
            if value is None:
                continue
            if live.kind.numbers:
                place = value[:3]
            if live.kind.turns:
                turn = value[live.kind.numbers :]
        return np.concatenate([place, turn])

    def sent(self, pose: Sequence[float]) -> Iterable[tuple[str, list[float]]]:
        """What its tasks are sent for a pose x, y, z, qx, qy, qz, qw, by input."""
        for live in self.lives:
            kind, turn = live.kind, np.array(pose[3:])
            if kind.axis:
                yield live.name, Course(kind, turn).R[:, 2].tolist()
                continue
            place = list(pose[:3]) if kind.numbers else []
            yield live.name, place + (turn.tolist() if kind.turns else [])

    def carried(self, place: Sequence[float], targets: Mapping[str, Array], state: State) -> Array:
        """The pose with which the object's origin goes to a place, turned as before."""
        lever = state.R_WO @ self.point
        return np.concatenate([np.array(place) + lever, self.pose(targets, state)[3:]])


def handles(scenario: Scenario, lives: Sequence[Live]) -> tuple[Handle, ...]:
    """One for each task of which something can be dragged."""
    found: dict[tuple[int, int], Handle] = {}
    for live in lives:
        phase = scenario.schedule[live.phase]
        task = phase.tasks[live.task]
        own = [other for other in lives if (other.phase, other.task) == (live.phase, live.task)]
        look = Gizmo(
            label=task.name,
            phase=live.phase,
            moves=any(other.kind.numbers for other in own),
            turns=any(other.kind.turns for other in own),
        )
        point = np.array(getattr(task, "point", (0.0, 0.0, 0.0)), float)
        handle = found.setdefault((live.phase, live.task), Handle(look, point))
        handle.lives.append(live)
    return tuple(found.values())
