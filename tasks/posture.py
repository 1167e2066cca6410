"""Joints go to given values: one row a joint.

With the reference r(t) = g(t) + (1 - s(t)) (q_start - g_start) and g the goal, be it a signal,

    e = q - r,   J = I,   rate = r_dot

Joints that are not named ask for nothing: they pull neither way, e = 0 and rate = 0.
"""

from collections.abc import Iterator, Mapping
from typing import Annotated, ClassVar

import numpy as np

from coopqp.base.errors import InvalidValueError, UnknownNameError, under
from coopqp.base.spec import Array, spec
from coopqp.base.wording import counted
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.marker import Marker, PostureMarker
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.program import Kind, Primitive
from coopqp.signal import Instant, Reads, Signal, Trajectory, of_joints
from coopqp.task import Task

JointValues = Annotated[float | list[float] | Signal, Reads(float | list[float])]
_Constants = dict[str, JointValues] | list[float]
Goal = Annotated[_Constants | Signal, Reads(_Constants, mapping=True)]


@spec
class Posture(Task):
    """Joints go to given values with what the tasks leave free (one row a joint)."""

    unit: ClassVar[str] = "rad"
    joint_space: ClassVar[bool] = True

    goal: Goal
    """Values by arm (base first) or joint, or all of them in the order of the joints [rad, m].

    Each a constant or a signal. Joints that are not named stay free: their rows are zero."""
    profile: Profile = Profile()
    """How the reference moves from the start to the goal."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return chain.joint_names

    def program(self, start: State) -> tuple[Primitive, ...]:
        goal = _Goal(self.goal, start)
        goal.update(start)
        rows = tuple(np.flatnonzero(np.isfinite(goal.value)).tolist())
        return (Primitive(kind=Kind.POSTURE, rows=rows, profile=self.profile, goal=goal),)

    def marks(self, at: Instant) -> tuple[Marker, ...]:
        """The arms as they shall stand, where that is constant."""
        if isinstance(self.goal, list):
            return (PostureMarker(goal=self.goal),)
        given = self.goal.items() if isinstance(self.goal, dict) else ()
        goal = {key: value for key, value in given if not isinstance(value, Signal)}
        return (PostureMarker(goal=goal),) if goal else ()


class _Goal(Trajectory):
    """Where all joints shall be, shape (n,) [rad, m; rad/s, m/s]; NaN and zero if not given."""

    def __init__(
        self, goal: Mapping[str, JointValues] | list[float] | Signal, start: State
    ) -> None:
        chain = start.chain
        super().__init__(of_joints(chain.joint_names), np.full(chain.n, np.nan))
        self._trajectories: list[tuple[list[int], Trajectory]] = []
        for joints, given in _given(goal, chain):
            at, kind = [chain.joint_names.index(joint) for joint in joints], of_joints(joints)
            if isinstance(given, Signal):
                self._trajectories.append((at, given.bind(kind, start, start.q[at])))
            else:
                self.value[at] = given
        self.moves = any(moving.moves for _, moving in self._trajectories)

    def update(self, at: Instant) -> None:
        for joints, moving in self._trajectories:
            moving.update(at)
            self.value[joints], self.rate[joints] = moving.value, moving.rate


def posture(goal: Mapping[str, JointValues] | list[float], chain: ClosedChain) -> Array:
    """The goal as one number a joint, shape (n,) [rad, m]; NaN where nothing is given."""
    return _Goal(goal, State(chain)).value


def _given(
    goal: Mapping[str, JointValues] | list[float] | Signal, chain: ClosedChain
) -> Iterator[tuple[tuple[str, ...], float | list[float] | Signal]]:
    """Joints, and what is given for them."""
    names, robot = chain.joint_names, chain.robot
    if not isinstance(goal, Mapping):
        with under("goal"):
            yield names, _counted("goal", goal, names)
        return
    joints_of = {arm.name: robot.arm_joints(arm) for arm in robot.arms}
    joints_of |= {name: (name,) for name in names}
    for key, value in goal.items():
        with under("goal", key):
            if key not in joints_of:
                raise UnknownNameError("arm or joint", key, joints_of, "posture.goal: ")
            yield joints_of[key], _counted(key, value, joints_of[key])


def _counted(key: str, value: JointValues, joints: tuple[str, ...]) -> JointValues:
    if not isinstance(value, Signal) and np.size(value) != len(joints):
        raise InvalidValueError(
            f"posture.{key}: found {counted(np.size(value), 'number')}, needs {len(joints)}: "
            f"{', '.join(joints)}"
        )
    return value
