"""Joints go to given values: one row a joint.

With the reference r(t) = q_start + s(t) (goal - q_start),

    e = q - r,   J = I,   rate = r_dot

Joints that are not named ask for nothing: they pull neither way, e = 0 and rate = 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from coopqp.checked import Array, spec
from coopqp.closed_chain import ClosedChain
from coopqp.errors import InvalidValueError, UnknownNameError, under
from coopqp.mark import Mark, PostureMark
from coopqp.profile import Profile
from coopqp.state import State
from coopqp.task import Evaluate, Task, TaskRows


@spec
class Posture(Task):
    """Joints go to given values with what the tasks leave free (one row a joint)."""

    unit: ClassVar[str] = "rad"
    joint_space: ClassVar[bool] = True

    goal: dict[str, float | list[float]] | list[float]
    """Values by arm (base first) or joint, or all of them in the order of the joints [rad, m].

    Joints that are not named stay free: their rows are zero."""
    profile: Profile = Profile()
    """How the reference moves from the start to the goal."""

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        """The joints."""
        return chain.joint_names

    @property
    def end(self) -> float:
        """When the reference arrives [s]."""
        return self.profile.end

    def bind(self, start: State) -> Evaluate:
        """The reference sets out from the joints' values now.

        Raises:
            UnknownNameError: the goal names neither an arm nor a joint.
            InvalidValueError: it has a wrong number of values.
        """
        goal, profile = posture(self.goal, start.chain), self.profile
        given = np.isfinite(goal).astype(float)
        q_start = start.q.copy()
        way = np.where(given > 0.0, goal - q_start, 0.0)
        diagonal = np.arange(start.chain.n)

        def evaluate(state: State, rows: TaskRows) -> None:
            share, speed = profile.at(state.t)
            rows.J[diagonal, diagonal] = given  # joints without a goal are not asked to stand still
            np.multiply(way, share, rows.rate)
            np.subtract(state.q, q_start, rows.e)
            np.subtract(rows.e, rows.rate, rows.e)
            np.multiply(rows.e, given, rows.e)
            np.multiply(way, speed, rows.rate)

        return evaluate

    def marks(self, t: float) -> tuple[Mark, ...]:
        """The arms as they shall stand."""
        return (PostureMark(goal=self.goal),)


def posture(goal: Mapping[str, float | list[float]] | list[float], chain: ClosedChain) -> Array:
    """The goal as one number a joint, shape (n,) [rad, m]; NaN where nothing is given.

    Raises:
        UnknownNameError: a key is neither an arm nor a joint.
        InvalidValueError: a wrong number of values.
    """
    names, robot = chain.joint_names, chain.robot
    if isinstance(goal, list):
        with under("goal"):
            return _counted("goal", goal, names)
    joints_of = {arm.name: robot.arm_joints(arm) for arm in robot.arms}
    joints_of |= {name: (name,) for name in names}
    q = np.full(chain.n, np.nan)
    for key, value in goal.items():
        with under("goal", key):
            if key not in joints_of:
                raise UnknownNameError("arm or joint", key, joints_of, "posture.goal: ")
            joints = joints_of[key]
            q[[names.index(joint) for joint in joints]] = _counted(key, value, joints)
    return q


def _counted(key: str, value: float | list[float], joints: Sequence[str]) -> Array:
    """A number a joint."""
    numbers = np.atleast_1d(np.asarray(value, float))
    if len(numbers) != len(joints):
        raise InvalidValueError(
            f"posture.{key}: found {len(numbers)} numbers, needs {len(joints)}: {', '.join(joints)}"
        )
    return numbers
