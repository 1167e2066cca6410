"""A task as a list of geometric primitives.

A primitive is a few rows of one kind: a point seen from a reference, a distance, an axis that
leans, a line's angle to a plane, a rotation, a twist, or a joint objective. Whatever a task's
reference needs from the start is read from the start state here, once. The compiled kernel
evaluates all kinds, :func:`evaluated` in numpy those that several tasks share.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array, Vector3, unit
from coopqp.model.geometry import (
    TINY,
    Alignment,
    Approach,
    PointInReference,
    Reference,
    RotationError,
    polar,
)
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.signal import ROTATION, Trajectory, quaternion_of

AT_ONCE = Profile(kind="step")
WORLD = Reference()  # at rest, so that nobody ever writes to it


class Kind(IntEnum):
    """What a primitive does; ``kernel/core/shared.hpp`` is made from it."""

    POINT = 0
    RADIAL = 1
    LEAN = 2
    TILT = 3
    ROTATION = 4
    TWIST = 5
    CENTERING = 6
    BARRIER = 7
    POSTURE = 8
    MANIPULABILITY = 9
    RELATIVE = 10


@dataclass(frozen=True, kw_only=True)
class Primitive:
    """A few rows of a task.

    Attributes:
        rows: which of the kind's rows, in the task's order; for a posture, which joints; for
            manipulability, which axes of the world.
        reference: the frame that the object is steered to; of a relative motion, its origin alone,
            in the first arm's object frame.
        profile: how the error goes to zero, or the objective to its goal.
        point: of the object, in the object frame [m].
        axis: of the object, in the object frame, of length one.
        e_start: error at the start, one number a row.
        goal: of a rotation, in the reference's axes.
        phi: rotation vector from start to goal [rad].
        Q_start: orientation at the start, shape (3, 3).
        length: a distance [m]; of a barrier, where its slope stops to grow; of manipulability m_0.
        velocity: of a twist, six numbers [m/s, rad/s].
        planar: for a distance, whether it is measured in the plane of the reference's first two
            axes; for a twist, whether it is along the object's axes.
        numbers: of joint objectives, one after the other, each by joint; of a relative motion, the
            loop that the arm closes with the first.
    """

    kind: Kind
    rows: tuple[int, ...]
    reference: Reference = WORLD
    profile: Profile = AT_ONCE
    point: Vector3 = (0.0, 0.0, 0.0)
    axis: Sequence[float] = (0.0, 0.0, 1.0)
    e_start: Sequence[float] = ()
    goal: Trajectory | None = None
    phi: Sequence[float] = (0.0, 0.0, 0.0)
    Q_start: Array = field(default_factory=lambda: np.eye(3))
    length: float = 0.0
    velocity: Sequence[float] = (0.0,) * 6
    planar: bool = False
    numbers: Sequence[Array] = ()

    @property
    def of_joints(self) -> bool:
        """Whether it is an objective for all joints, without rows of its own."""
        return self.kind in (Kind.CENTERING, Kind.BARRIER, Kind.MANIPULABILITY)

    @property
    def over_joints(self) -> bool:
        """Whether its rows are of joints, not of the object's twist."""
        return self.kind in (Kind.POSTURE, Kind.RELATIVE)

    @property
    def compiles(self) -> bool:
        """Whether the kernel can evaluate it: it reads no rotation that follows a signal."""
        return self.profile.compiles and (self.goal is None or not self.goal.moves)

    def flat(self) -> dict[str, Any]:
        return {
            "kind": float(self.kind),
            "rows": np.array(self.rows, float),
            "reference": self.reference.numbers(),
            "profile": np.array(self.profile.numbers),
            "point": np.array(self.point, float),
            "axis": np.array(self.axis, float),
            "e_start": np.array([*self.e_start, 0.0, 0.0, 0.0][:3]),
            "phi": np.array(self.phi, float),
            "Q_start": np.ascontiguousarray(self.Q_start, float),
            "length": float(self.length),
            "velocity": np.array(self.velocity, float),
            "planar": float(self.planar),
            "numbers": np.concatenate([np.zeros(0), *self.numbers]),
        }


class Programmed(Protocol):
    """A task, as far as its program goes."""

    def program(self, start: State) -> tuple[Primitive, ...] | None:
        """The rows as primitives."""


class Programs:
    """The programs of tasks that set out from one unchanging state, each made when first needed."""

    def __init__(self, start: State) -> None:
        self.start = start
        self._made: dict[int, tuple[Programmed, tuple[Primitive, ...] | None]] = {}

    def of(self, task: Programmed) -> tuple[Primitive, ...] | None:
        """A task's program; None where it has none."""
        if id(task) not in self._made:
            self._made[id(task)] = task, task.program(self.start)  # its id is taken as long
        return self._made[id(task)][1]


def sees_twist(program: Sequence[Primitive] | None) -> bool:
    """Whether a task's rows are those of the object's twist, and nothing else."""
    return program is not None and not any(p.of_joints or p.over_joints for p in program)


def point(
    start: State, reference: Reference, p_O: Vector3, profile: Profile, rows: tuple[int, ...]
) -> Primitive:
    """A point's place along the reference's axes in ``rows``; its error shrinks to zero."""
    return Primitive(
        kind=Kind.POINT, rows=rows, reference=reference, point=p_O, profile=profile,
        e_start=_place(start, reference, p_O)[list(rows)].tolist(),
    )  # fmt: skip


def radial(
    start: State, reference: Reference, p_O: Vector3, profile: Profile, length: float, *,
    planar: bool,
) -> Primitive:  # fmt: skip
    """A point's distance from the reference's origin, or from its third axis."""
    x = _place(start, reference, p_O)
    away = math.hypot(x[0], x[1]) if planar else math.hypot(*x)
    return Primitive(
        kind=Kind.RADIAL, rows=(0,), reference=reference, point=p_O, profile=profile,
        e_start=(away - length,), length=length, planar=planar,
    )  # fmt: skip


def lean(start: State, reference: Reference, axis: Sequence[float], profile: Profile) -> Primitive:
    """An axis of the object goes to the reference's third, ``geometry.Alignment``."""
    reference.update(start)
    a_O = unit((axis[0], axis[1], axis[2]))
    seen = polar(reference.RT @ start.R_WO @ a_O)
    phi = seen.angle * np.array([-seen.way[1], seen.way[0], 0.0])
    return Primitive(
        kind=Kind.LEAN, rows=(0, 1), reference=reference, axis=a_O.tolist(), profile=profile,
        phi=phi.tolist(),
    )  # fmt: skip


def tilt(start: State, reference: Reference, axis: Sequence[float], profile: Profile) -> Primitive:
    """A line of the object goes into the plane of the reference's first two axes."""
    reference.update(start)
    a_O = unit((axis[0], axis[1], axis[2]))
    angle = 0.5 * math.pi - polar(reference.RT @ start.R_WO @ a_O).angle
    return Primitive(
        kind=Kind.TILT, rows=(0,), reference=reference, axis=a_O.tolist(), profile=profile,
        e_start=(angle,),
    )  # fmt: skip


def rotation(
    goal: Trajectory, profile: Profile, Q_start: Array, reference: Reference = WORLD
) -> Primitive:
    """An orientation goes to its goal, ``geometry.RotationError``."""
    return Primitive(
        kind=Kind.ROTATION, rows=(0, 1, 2), reference=reference, profile=profile, goal=goal,
        phi=np.asarray(pin.log3(goal.R @ Q_start.T)).tolist(), Q_start=Q_start.copy(),
    )  # fmt: skip


def fixed(R: Array) -> Trajectory:
    """A rotation that does not move, as a goal."""
    return Trajectory(ROTATION, quaternion_of(R))


def _place(start: State, reference: Reference, p_O: Vector3) -> Array:
    reference.update(start)
    seen: Array = reference.RT @ (start.point(np.array(p_O)) - reference.c)
    return seen


Fill = Callable[[State, Array, Array, Array], None]
"""Writes e, J and rate of some rows, shapes (k,), (k, n) and (k,), at a state."""


def evaluated(program: Sequence[Primitive], start: State) -> Fill:
    """The rows of a task's primitives, in numpy; their references move once a state."""
    moving: dict[int, Reference | Trajectory] = {id(p.reference): p.reference for p in program}
    goals: dict[int, Reference | Trajectory] = {id(p.goal): p.goal for p in program if p.goal}
    seen: dict[tuple[int, Vector3], PointInReference] = {}
    for p in program:
        if p.kind in (Kind.POINT, Kind.RADIAL):
            place = PointInReference(p.point, p.reference, start.chain.n)
            seen.setdefault((id(p.reference), p.point), place)
    moves = [*goals.values(), *moving.values()]  # a reference may be a goal's place
    for move in moves:
        move.update(start)
    blocks, at = list[tuple[Fill, slice]](), 0
    for p in program:
        part = slice(at, at + len(p.rows))
        blocks.append((_FILLS[p.kind](p, start, seen.get((id(p.reference), p.point))), part))
        at = part.stop

    def fill(state: State, e: Array, J: Array, rate: Array) -> None:
        for move in moves:
            move.update(state)
        for point in seen.values():
            point.update(state)
        for block, part in blocks:
            block(state, e[part], J[part], rate[part])

    return fill


def _point_rows(p: Primitive, start: State, seen: PointInReference | None) -> Fill:
    assert seen is not None
    approach, rows = Approach(p.profile, p.e_start), slice(p.rows[0], p.rows[-1] + 1)

    def fill(state: State, e: Array, J: Array, rate: Array) -> None:
        e[:], J[:], rate[:] = seen.x[rows], seen.J[rows], seen.rate[rows]
        approach.shift(state.t, e, rate)

    return fill


def _radial_rows(p: Primitive, start: State, seen: PointInReference | None) -> Fill:
    assert seen is not None
    approach, away = Approach(p.profile, p.e_start), np.zeros(3)
    across = slice(0, 2 if p.planar else 3)

    def fill(state: State, e: Array, J: Array, rate: Array) -> None:
        distance = math.hypot(*seen.x[across].tolist())
        away[:] = 1.0, 0.0, 0.0
        if distance > TINY:
            np.divide(seen.x[across], distance, away[across])
        e[0], rate[0] = distance - p.length, away.dot(seen.rate)
        away.dot(seen.J, J[0])
        approach.shift(state.t, e, rate)

    return fill


def _lean_rows(p: Primitive, start: State, seen: PointInReference | None) -> Fill:
    return Alignment((p.axis[0], p.axis[1], p.axis[2]), p.reference, p.profile, start).fill


def _tilt_rows(p: Primitive, start: State, seen: PointInReference | None) -> Fill:
    approach, a_O, plane = Approach(p.profile, p.e_start), np.array(p.axis), p.reference
    aside, across = np.zeros(3), np.zeros(3)  # normal to the line's way; in the world's axes

    def fill(state: State, e: Array, J: Array, rate: Array) -> None:
        line = polar(plane.RT.dot(state.R_WO.dot(a_O)))
        aside[0], aside[1] = line.way[1], -line.way[0]
        aside.dot(plane.RT, across)
        e[0], rate[0] = 0.5 * math.pi - line.angle, across.dot(plane.omega)
        across.dot(state.J_task[3:], J[0])
        approach.shift(state.t, e, rate)

    return fill


def _rotation_rows(p: Primitive, start: State, seen: PointInReference | None) -> Fill:
    assert p.goal is not None
    error, reference, Q = RotationError(p.goal, p.profile, p.Q_start), p.reference, np.zeros((3, 3))

    def fill(state: State, e: Array, J: Array, rate: Array) -> None:
        reference.RT.dot(state.R_WO, Q)
        error.fill(state.t, Q, reference.RT, state.J_task[3:], (e, J, rate))
        if reference.moves:
            rate += error.rows.dot(reference.omega)

    return fill


_FILLS = {
    Kind.POINT: _point_rows, Kind.RADIAL: _radial_rows, Kind.LEAN: _lean_rows,
    Kind.TILT: _tilt_rows, Kind.ROTATION: _rotation_rows,
}  # fmt: skip
