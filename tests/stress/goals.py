"""Random tasks of the catalogue, all from one seed.

Each builder makes a task that an object pose fulfils; goals in reach come from a pose that a walk
along the loops has found, so that several tasks can hold at once, and others from anywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin
from walks import vector

from coopqp import tasks
from coopqp.base.spec import Array, cross
from coopqp.base.spec import Pose as PoseValue
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import KINDS, Profile
from coopqp.task import Task

Vector = tuple[float, float, float]
T = TypeVar("T")

FARTHEST = 0.4  # distance of a goal from the start, as a share of the arms' reach
TURN = 1.0  # largest turn to an unreachable goal [rad]
SPEED = 0.1  # of a twist, a share of the reach in a second [1/s], and [rad/s]


@dataclass(frozen=True)
class Aim:
    """Where a task wants the object.

    Attributes:
        rng: for what the pose leaves open.
        X: pose of the object in the world.
        point: a point of the object, in the object frame [m].
        axis, normal: unit vectors in the object frame, at right angles.
    """

    rng: np.random.Generator
    X: pin.SE3
    point: Vector
    axis: Array
    normal: Array

    @property
    def there(self) -> Vector:
        """Where the point goes, in the world [m]."""
        return vector(self.X.act(np.array(self.point)))

    @property
    def along(self) -> Vector:
        """Where the axis shall point, in the world."""
        return vector(self.X.rotation @ self.axis)

    @property
    def across(self) -> Vector:
        """Where the normal shall point, in the world."""
        return vector(self.X.rotation @ self.normal)

    @property
    def own_axis(self) -> Vector:
        """The axis in the object frame."""
        return vector(self.axis)

    @property
    def rpy(self) -> Vector:
        """Orientation of the object [rad]."""
        return vector(pin.rpy.matrixToRpy(self.X.rotation))

    @property
    def pose(self) -> PoseValue:
        """The pose as tasks have it."""
        return PoseValue(position=vector(self.X.translation), rpy=self.rpy)


Common = dict[str, Any]
Build = Callable[[Aim, Common], Task]


def _point_on_circle(aim: Aim, common: Common) -> Task:
    radius = float(aim.rng.uniform(0.02, 0.2))
    middle = np.array(aim.there) + radius * np.array(aim.across)
    return tasks.PointOnCircle(
        center=vector(middle), normal=aim.along, radius=radius, point=aim.point, **common
    )


def _distance(aim: Aim, common: Common) -> Task:
    length = float(aim.rng.uniform(0.05, 0.4))
    to = np.array(aim.there) + length * np.array(aim.along)
    return tasks.Distance(to=vector(to), length=length, point=aim.point, **common)


def _twist(aim: Aim, common: Common) -> Task:
    axes = ("x", "y", "z", "rot_x", "rot_y", "rot_z")
    some = aim.rng.choice(axes, size=int(aim.rng.integers(1, 4)), replace=False)
    velocity: Any = {str(axis): float(aim.rng.uniform(-SPEED, SPEED)) for axis in some}
    return tasks.Twist(velocity=velocity, point=aim.point, **common)


def _relative_motion(aim: Aim, common: Common) -> Task:
    goal = PoseValue(
        position=vector(aim.rng.uniform(-0.1, 0.1, 3)), rpy=vector(aim.rng.uniform(-0.5, 0.5, 3))
    )
    return tasks.RelativeMotion(goal=goal, **common)


def _of(kind: Callable[..., Task], *, point: str = "point", **names: str) -> Build:
    """A task whose fields are what an aim has by these names."""
    fields = {**names, **({"point": point} if point else {})}
    return lambda aim, common: kind(**{k: getattr(aim, x) for k, x in fields.items()}, **common)


BUILDERS: dict[str, Build] = {
    "point_on_point": _of(tasks.PointOnPoint, goal="there"),
    "point_on_plane": _of(tasks.PointOnPlane, normal="along", through="there"),
    "point_on_line": _of(tasks.PointOnLine, direction="along", through="there"),
    "point_on_circle": _point_on_circle,
    "line_on_line": _of(tasks.LineOnLine, direction="along", through="there", axis="own_axis"),
    "line_on_plane": _of(tasks.LineOnPlane, normal="across", through="there", axis="own_axis"),
    "plane_on_plane": _of(tasks.PlaneOnPlane, normal="along", through="there", axis="own_axis"),
    "revolute": _of(tasks.Revolute, direction="along", through="there", axis="own_axis"),
    "prismatic": _of(tasks.Prismatic, direction="along", through="there", rpy="rpy"),
    "pointing": _of(tasks.Pointing, direction="along", axis="own_axis", point=""),
    "orientation": _of(tasks.Orientation, rpy="rpy", point=""),
    "pose": _of(tasks.Pose, goal="pose", point=""),
    "distance": _distance,
    "twist": _twist,
    "relative_motion": _relative_motion,
}


def pick(rng: np.random.Generator, among: Sequence[T]) -> T:
    """One of several, each as likely; what rng.choice draws, which makes an array of them first."""
    return among[int(rng.integers(len(among)))]


def random_aim(rng: np.random.Generator, X: pin.SE3) -> Aim:
    """A point and two directions of the object that shall be as the pose has them."""
    axis, other = rng.normal(size=(2, 3))
    axis /= np.linalg.norm(axis)
    normal = cross(axis, other)
    point = vector(rng.uniform(-0.04, 0.04, 3)) if rng.random() < 0.5 else (0.0, 0.0, 0.0)
    return Aim(rng, X, point, axis, normal / np.linalg.norm(normal))


def anywhere(rng: np.random.Generator, start: pin.SE3, arms: float) -> pin.SE3:
    """A pose near the start, where arms of a length [m] reach or not."""
    way, axis = rng.normal(size=(2, 3))
    way *= rng.uniform(0.01, FARTHEST) * arms / np.linalg.norm(way)
    turn = pin.exp3(rng.uniform(0.0, TURN) * axis / np.linalg.norm(axis))
    return pin.SE3(turn @ start.rotation, start.translation + way)


def some_aim(rng: np.random.Generator, X: pin.SE3, chain: ClosedChain, *, reach: bool) -> Aim:
    """At a pose in reach, or anywhere about it."""
    return random_aim(rng, X if reach else anywhere(rng, X, chain.reach))


def common(rng: np.random.Generator, dt: float, name: str) -> Common:
    """Keys that every task has."""
    return {
        "name": name,
        "mode": pick(rng, ("soft", "soft", "soft", "hard", "scaled")),
        "priority": int(rng.integers(0, 3)),
        "weight": float(10.0 ** rng.uniform(-2.0, 2.0)),
        "gain": float(dt ** -rng.uniform(0.4, 1.0)),
        "profile": profile(rng),
    }


def profile(rng: np.random.Generator) -> Profile:
    """How a reference moves, often at once."""
    kind: Any = pick(rng, KINDS)
    return Profile(kind=kind, duration=float(rng.uniform(0.1, 0.7)))
