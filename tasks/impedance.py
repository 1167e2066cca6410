"""The object yields to wrenches as a mass on springs and dampers: a row for each axis given.

    M e_ddot + D e_dot + K e = w

e is how far the object is from its reference, as in :mod:`coopqp.tasks.pose`, and w the external
wrench on it at its origin, world axes; for angles that is so to first order. A steady force F moves
it by F / K. After Caccavale, Chiacchio, Marino and Villani 2008, with two kinds of M:

- ``mass`` is left out: that of object and arms together in this pose; no law has to know w.
- ``mass`` is given: the law must know w, ``torque_qp: {external_wrench: observed}``.

Where ``damping`` is left out, every mode has the ``damping_ratio``. Only laws that command torques
can do this; there is no gain, and no integral brings e back.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from coopqp.base.spec import Array, NonNegative, Positive, spec
from coopqp.model.closed_chain import AXES, ClosedChain
from coopqp.model.marker import Marker
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.signal import Instant, MovingPose
from coopqp.task import Evaluate, Part, Task, TaskRows, pose_parts
from coopqp.task import Impedance as OfRows
from coopqp.tasks.pose import Pose

Axis = Literal["x", "y", "z", "rot_x", "rot_y", "rot_z"]


def _numbers(given: object) -> object:
    """Refuse true and false, which are 1 and 0 elsewhere."""
    if isinstance(given, dict):
        for axis, value in given.items():
            if isinstance(value, bool):
                raise ValueError(f"{axis}: found {str(value).lower()}, needs a number")
    return given


Springs = Annotated[dict[Axis, Positive], Field(min_length=1), BeforeValidator(_numbers)]
Dampers = Annotated[dict[Axis, NonNegative], Field(min_length=1), BeforeValidator(_numbers)]


@spec
class Impedance(Task):
    """The object is a mass on springs and dampers along some axes; needs a law by torques."""

    goal: MovingPose
    """Where the springs pull the object, in the world."""
    stiffness: Springs
    """K along some of x, y, z and about rot_x, rot_y, rot_z [N/m, N m/rad]; others are free."""
    damping: Dampers | None = None
    """D of the same axes [N s/m, N m s/rad]; by damping_ratio if omitted."""
    damping_ratio: Annotated[float, Field(gt=0.0, le=2.0)] = 1.0
    """Of every mode, where damping is omitted; 1 does not overshoot."""
    mass: Springs | None = None
    """M of the same axes [kg, kg m2]; what object and arms have there if omitted."""
    weight: NonNegative = 100.0
    """Cost of a squared error; with that of other tasks, 1, hands that press sag by some per cent
    of F/K to squeeze less [s2/unit2]."""
    profile: Profile = Profile()
    """How the reference moves from the start to the goal."""
    tolerance_angle: Positive = 5e-3
    """Orientation error at the end that still counts as reached [rad]."""

    def __post_init__(self) -> None:
        for key in ("damping", "mass"):
            given = getattr(self, key)
            if given is not None and set(given) != set(self.stiffness):
                raise ValueError(f"{key}: needs the axes of stiffness, {', '.join(self._axes)}")
        if self.gain != Task.gain:
            raise ValueError(
                f"gain: found {self.gain:g}, which has no effect on an impedance; leave it out; "
                "stiffness, damping and mass have"
            )
        if self.mode == "scaled":
            raise ValueError("mode: an impedance is soft or hard, not scaled")

    @property
    def _axes(self) -> tuple[str, ...]:
        return tuple(axis for axis in AXES if axis in self.stiffness)

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return self._axes

    def parts(self, chain: ClosedChain) -> tuple[Part, ...]:
        turns = sum(axis.startswith("rot") for axis in self._axes)
        moves = len(self._axes) - turns
        return pose_parts(moves, turns, self.tolerance, self.tolerance_angle)

    @property
    def impedance(self) -> OfRows:
        return OfRows(
            axes=tuple(AXES.index(axis) for axis in self._axes),
            stiffness=self._by_row(self.stiffness),
            damping=None if self.damping is None else self._by_row(self.damping),
            damping_ratio=self.damping_ratio,
            mass=None if self.mass is None else self._by_row(self.mass),
        )

    def _by_row(self, given: dict[Axis, float]) -> Array:
        return np.array([given[axis] for axis in self._axes])  # type: ignore[index]

    def bind(self, start: State) -> Evaluate:
        whole = Pose(goal=self.goal, profile=self.profile).bind(start)
        every = TaskRows(np.zeros(6), np.zeros((6, start.chain.n)), np.zeros(6))
        chosen = np.array([AXES.index(axis) for axis in self._axes])

        def evaluate(state: State, rows: TaskRows) -> None:
            whole(state, every)
            rows.e[:], rows.J[:] = every.e[chosen], every.J[chosen]
            rows.rate[:] = every.rate[chosen]

        return evaluate

    def marks(self, at: Instant) -> tuple[Marker, ...]:
        return Pose(goal=self.goal).marks(at)
