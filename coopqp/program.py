"""A task as a list of geometric primitives: one description for laws, kernel and pictures.

A primitive is a few rows of one kind: a point seen from a reference, a distance, an axis that
leans, a line's angle to a plane, a rotation, a twist, or a joint objective. What it needs from
where it sets out is :func:`begin`. The compiled kernel evaluates all kinds, :func:`evaluated` all
but manipulability in numpy.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array, Vector3, unit
from coopqp.model import marker
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.geometry import (
    TINY,
    PointInReference,
    Reference,
    RotationError,
    inverse_alignment,
    polar,
)
from coopqp.model.profile import Profile
from coopqp.model.state import PointOfObject, State
from coopqp.signal import Instant, Trajectory

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
    """A few rows of a task."""

    kind: Kind
    # which of the kind's rows, in the task's order; for a posture, which joints; for
    # manipulability, which axes of the world
    rows: tuple[int, ...]
    # the frame that the object is steered to; of a relative motion, its origin alone, in the first
    # arm's object frame
    reference: Reference = WORLD
    profile: Profile = AT_ONCE  # how the error goes to zero, or the objective to its goal
    point: Vector3 = (0.0, 0.0, 0.0)  # of the object, in the object frame [m]
    axis: Sequence[float] = (0.0, 0.0, 1.0)  # of the object, in the object frame, of length one
    # of a rotation, in the reference's axes, None as at the start; of a relative motion, a pose; of
    # a posture, all joints, NaN where nothing is asked; of a twist, its components
    goal: Trajectory | None = None
    order: Sequence[int] = ()  # which number of a twist's goal each row follows
    # a distance [m]; of a barrier, where its slope stops to grow; of manipulability m_0
    length: float = 0.0
    # for a distance, whether it is measured in the plane of the reference's first two axes; for a
    # twist, whether it is along the object's axes
    planar: bool = False
    numbers: Sequence[Array] = ()  # of joint objectives, one after the other, each by joint
    loop: int = 0  # that the arm of a relative motion closes with the first

    @property
    def of_joints(self) -> bool:
        """Whether it is an objective for all joints, without rows of its own."""
        return self.kind in (Kind.CENTERING, Kind.BARRIER, Kind.MANIPULABILITY)

    @property
    def compiles(self) -> bool:
        """Whether the kernel can evaluate it: it reads no rotation that follows a signal."""
        return self.profile.compiles and (self.goal is None or not self.goal.moves)

    def flat(self, start: State) -> dict[str, Any]:
        begins, numbers, velocity = begin(self, start), self.numbers, np.zeros(6)
        if self.kind is Kind.TWIST and self.goal:
            velocity[list(self.rows)] = self.goal.value[list(self.order)]
        elif self.kind is Kind.POSTURE:
            numbers = start.q, -begins.e
        elif self.kind is Kind.RELATIVE:
            numbers = (np.array([float(self.loop)]),)
        return {
            "kind": float(self.kind),
            "rows": np.array(self.rows, float),
            "reference": self.reference.numbers(),
            "profile": np.array(self.profile.numbers),
            "point": np.array(self.point, float),
            "axis": np.array(self.axis, float),
            "e_start": np.array([*begins.e, 0.0, 0.0, 0.0][:3]),
            "phi": np.array(begins.phi, float),
            "Q_start": np.ascontiguousarray(begins.Q, float),
            "length": float(self.length),
            "velocity": velocity,
            "planar": float(self.planar),
            "numbers": np.concatenate([np.zeros(0), *numbers]),
        }


def point(reference: Reference, p_O: Vector3, profile: Profile, rows: tuple[int, ...]) -> Primitive:
    """A point's place along the reference's axes in ``rows``; its error shrinks to zero."""
    return Primitive(kind=Kind.POINT, rows=rows, reference=reference, point=p_O, profile=profile)


def lean(reference: Reference, axis: Vector3, profile: Profile) -> Primitive:
    """An axis of the object goes to the reference's third."""
    a_O = unit(axis).tolist()
    return Primitive(kind=Kind.LEAN, rows=(0, 1), reference=reference, axis=a_O, profile=profile)


def rotation(goal: Trajectory | None, profile: Profile, reference: Reference = WORLD) -> Primitive:
    """An orientation goes to its goal, ``geometry.RotationError``."""
    return Primitive(
        kind=Kind.ROTATION, rows=(0, 1, 2), reference=reference, goal=goal, profile=profile
    )


class Begin(NamedTuple):
    """Where a primitive sets out."""

    e: Array = np.zeros(0)  # its error to the goal, one number a row
    phi: Array = np.zeros(3)  # rotation vector from there to the goal [rad]
    Q: Array = np.eye(3)  # the orientation there, shape (3, 3)


def begin(p: Primitive, start: State) -> Begin:
    """Error and rotation of a primitive at a state from which its reference sets out."""
    if p.goal:
        p.goal.update(start)
    p.reference.update(start)
    RT, goal = p.reference.RT, p.goal
    x = RT @ (start.point(np.array(p.point)) - p.reference.c)
    if p.kind is Kind.POINT:
        return Begin(x[list(p.rows)])
    if p.kind is Kind.RADIAL:
        away = math.hypot(x[0], x[1]) if p.planar else math.hypot(*x)
        return Begin(np.array([away - p.length]))
    if p.kind in (Kind.LEAN, Kind.TILT):
        axis = polar(RT @ start.R_WO @ np.array(p.axis))
        if p.kind is Kind.TILT:
            return Begin(np.array([0.5 * math.pi - axis.angle]))
        return Begin(phi=axis.angle * np.array([-axis.way[1], axis.way[0], 0.0]))
    if p.kind is Kind.ROTATION:
        Q = RT @ start.R_WO
        return Begin(phi=np.array(pin.log3(goal.R @ Q.T)) if goal else np.zeros(3), Q=Q)
    if p.kind is Kind.RELATIVE and goal:
        arms = RelativePose(start.chain, p.loop)
        arms.update(start)
        e, phi = arms.R_0.T @ arms.gap - goal.value[:3], pin.log3(goal.R @ arms.Q.T)
        return Begin(e, np.array(phi), arms.Q)
    if p.kind is Kind.POSTURE and goal:
        return Begin(np.where(np.isfinite(goal.value), start.q - goal.value, 0.0))
    return Begin()


def sees_twist(program: Sequence[Primitive] | None) -> bool:
    """Whether a task's rows are those of the object's twist, and nothing else."""
    of_joints = (Kind.POSTURE, Kind.RELATIVE)
    return program is not None and not any(p.of_joints or p.kind in of_joints for p in program)


def markers(geometry: Sequence[Primitive], at: Instant) -> tuple[marker.Marker, ...]:
    """What the object is steered to at an instant, then its point that is."""
    for p in geometry:
        if p.goal:
            p.goal.update(at)
        p.reference.update(at)
    found, of = list[marker.Marker](), {p.kind: p for p in geometry}
    spot, radial, turned = of.get(Kind.POINT), of.get(Kind.RADIAL), of.get(Kind.ROTATION)
    placed = spot or radial or of.get(Kind.TWIST)
    if radial:
        c, normal = radial.reference.c, radial.reference.RT[2]
        ball = marker.SphereMarker(center=c, radius=radial.length)
        circle = marker.CircleMarker(center=c, normal=normal, radius=radial.length)
        found.append(circle if radial.planar else ball)
    elif spot and spot.rows == (2,):
        found.append(marker.PlaneMarker(normal=spot.reference.RT[2], through=spot.reference.c))
    elif spot and (spot.rows == (0, 1) or Kind.LEAN in of):
        found.append(marker.LineMarker(direction=spot.reference.RT[2], through=spot.reference.c))
    elif Kind.LEAN in of:
        found.append(marker.LineMarker(direction=of[Kind.LEAN].reference.RT[2]))
    whole = spot.reference.c if spot and len(spot.rows) == 3 else None
    if turned and turned.goal:
        R = turned.reference.RT.T @ turned.goal.R
        found.append(marker.PoseMarker(rotation=R, position=whole))
    elif whole is not None:
        found.append(marker.PointMarker(at=whole))
    return (*found, marker.TrackedMarker(point=placed.point)) if placed else tuple(found)


Fill = Callable[[State, Array, Array, Array], None]
"""Writes e, J and rate of some rows, shapes (k,), (k, n) and (k,), at a state."""


def evaluated(program: Sequence[Primitive], start: State) -> Fill:
    """The rows of a task's primitives, in numpy; their references move once a state."""
    goals: dict[int, Reference | Trajectory] = {id(p.goal): p.goal for p in program if p.goal}
    moving: dict[int, Reference | Trajectory] = {id(p.reference): p.reference for p in program}
    places: dict[tuple[int, Vector3], PointInReference] = {}
    moves = [*goals.values(), *moving.values()]  # a reference may be a goal's place
    blocks, at = list[tuple[Fill, slice, Profile, Array]](), 0
    for p in program:
        of_all = p.of_joints or p.kind is Kind.POSTURE
        part = slice(None) if of_all else slice(at, at + len(p.rows))
        if p.kind in (Kind.POINT, Kind.RADIAL):
            place = PointInReference(p.point, p.reference, start.chain.n)
            place = places.setdefault((id(p.reference), p.point), place)
            block = (_point_rows if p.kind is Kind.POINT else _radial_rows)(p, place)
        else:
            block = _FILLS[p.kind](p, start)
        blocks.append((block, part, p.profile, begin(p, start).e))
        at += len(p.rows)

    def fill(state: State, e: Array, J: Array, rate: Array) -> None:
        for move in moves:
            move.update(state)
        for place in places.values():
            place.update(state)
        for block, part, profile, e_start in blocks:
            block(state, e[part], J[part], rate[part])
            share, speed = profile.at(state.t)
            if share < 1.0:  # the error shrinks to zero from what it is at the start
                first = slice(part.start, (part.start or 0) + len(e_start))
                e[first] -= e_start * (1.0 - share)
                rate[first] -= e_start * speed

    return fill


def _point_rows(p: Primitive, place: PointInReference) -> Fill:
    rows = slice(p.rows[0], p.rows[-1] + 1)

    def fill(state: State, e: Array, J: Array, rate: Array) -> None:
        e[:], J[:], rate[:] = place.x[rows], place.J[rows], place.rate[rows]

    return fill


def _radial_rows(p: Primitive, place: PointInReference) -> Fill:
    away, across = np.zeros(3), slice(0, 2 if p.planar else 3)

    def fill(state: State, e: Array, J: Array, rate: Array) -> None:
        distance = math.hypot(*place.x[across].tolist())
        away[:] = 1.0, 0.0, 0.0
        if distance > TINY:
            np.divide(place.x[across], distance, away[across])
        e[0], rate[0] = distance - p.length, away.dot(place.rate)
        away.dot(place.J, J[0])

    return fill


def _lean_rows(p: Primitive, start: State) -> Fill:
    """An axis of the object goes into the direction of the reference, :func:`inverse_alignment`.

    The reference direction goes from the axis at the start to the reference's third axis on the
    shortest way; D turns it, D(s) = exp((1 - s) phi). With y = D' R' a, its angle theta from the
    third axis and its way u from it,

        e = theta u,   J = E D' R' J_omega,   rate = E (D' R' omega - s_dot phi)
    """
    a_O, reference, phi = np.array(p.axis), p.reference, begin(p, start).phi

    def fill(state: State, e: Array, J: Array, rate: Array) -> None:
        share, speed = p.profile.at(state.t)
        C = pin.exp3(phi * (share - 1.0)).dot(reference.RT)
        found = polar(C.dot(state.R_WO.dot(a_O)))
        E = inverse_alignment(found)
        e[0], e[1] = found.angle * found.way[0], found.angle * found.way[1]
        J[:] = E.dot(C).dot(state.J_task[3:])
        rate[:] = E.dot(C.dot(reference.omega) - speed * phi)

    return fill


def _tilt_rows(p: Primitive, start: State) -> Fill:
    """A line of the object goes into the plane of the reference's first two axes."""
    a_O, plane = np.array(p.axis), p.reference
    aside, across = np.zeros(3), np.zeros(3)  # normal to the line's way; in the world's axes

    def fill(state: State, e: Array, J: Array, rate: Array) -> None:
        line = polar(plane.RT.dot(state.R_WO.dot(a_O)))
        aside[0], aside[1] = line.way[1], -line.way[0]
        aside.dot(plane.RT, across)
        e[0], rate[0] = 0.5 * math.pi - line.angle, across.dot(plane.omega)
        across.dot(state.J_task[3:], J[0])

    return fill


def _rotation_rows(p: Primitive, start: State) -> Fill:
    begins, reference, Q = begin(p, start), p.reference, np.zeros((3, 3))
    error = RotationError(p.goal, p.profile, begins.phi, begins.Q)

    def fill(state: State, e: Array, J: Array, rate: Array) -> None:
        reference.RT.dot(state.R_WO, Q)
        error.fill(state.t, Q, reference.RT, state.J_task[3:], (e, J, rate))
        if reference.moves:
            rate += error.rows.dot(reference.omega)

    return fill


def _twist_rows(p: Primitive, start: State) -> Fill:
    assert p.goal is not None
    tracked, goal = PointOfObject(p.point, start.chain.n), p.goal
    rows, order, V = np.array(p.rows), np.array(p.order), np.zeros((6, start.chain.n))

    def fill(state: State, e: Array, J: Array, rate: Array) -> None:
        share, _ = p.profile.at(state.t)
        tracked.update(state)
        if p.planar:
            state.R_WO.T.dot(tracked.J, V[:3])
            state.R_WO.T.dot(state.J_task[3:], V[3:])
        else:
            V[:3], V[3:] = tracked.J, state.J_task[3:]
        np.take(V, rows, axis=0, out=J, mode="clip")
        np.multiply(goal.value[order], share, rate)

    return fill


def _centering_rows(p: Primitive, start: State) -> Fill:
    middle, scale = p.numbers

    def fill(state: State, e: Array, J: Array, rate: Array) -> None:
        np.subtract(state.q, middle, out=e)
        np.multiply(e, scale, out=e)

    return fill


def _barrier_rows(p: Primitive, start: State) -> Fill:
    middle, per_half, per_range = p.numbers
    x = np.zeros(start.chain.n)

    def fill(state: State, e: Array, J: Array, rate: Array) -> None:
        np.subtract(state.q, middle, out=x)
        np.multiply(x, per_half, out=x)
        np.clip(x, -p.length, p.length, out=x)
        np.multiply(x, per_range, out=e)
        np.divide(e, 1.0 - x * x, out=e)

    return fill


def _posture_rows(p: Primitive, start: State) -> Fill:
    assert p.goal is not None
    goal, diagonal = p.goal, np.arange(start.chain.n)
    given = np.isfinite(goal.value).astype(float)

    def fill(state: State, e: Array, J: Array, rate: Array) -> None:
        J[diagonal, diagonal] = given  # joints without a goal are not asked to stand still
        np.subtract(state.q, goal.value, e)
        e[given == 0.0] = 0.0
        rate[:] = goal.rate

    return fill


class RelativePose:
    """R_0, Q = R_0' R_i, shapes (3, 3), and gap = p_i - p_0 in the world, shape (3,) [m]."""

    def __init__(self, chain: ClosedChain, loop: int) -> None:
        self.at, self._alpha = 6 * loop, chain.alpha[1:]
        self.R_0, self.Q, self.gap = np.eye(3), np.eye(3), np.zeros(3)

    def update(self, state: State) -> None:
        errors, at, R_0 = state.loop_error.reshape(-1, 6), self.at, self.R_0
        pin.exp3(-self._alpha.dot(errors[:, 3:])).dot(state.R_WO, R_0)
        self.gap[:] = state.loop_error[at : at + 3]
        turned = pin.exp3(state.loop_error[at + 3 : at + 6])  # R_i R_0'
        R_0.T.dot(turned.dot(R_0), self.Q)


def _relative_rows(p: Primitive, start: State) -> Fill:
    assert p.goal is not None
    chain, goal, begins = start.chain, p.goal, begin(p, start)
    arms = RelativePose(chain, p.loop)
    error = RotationError(goal, p.profile, begins.phi, begins.Q)
    first = np.linalg.inv(chain.mixing)[3:6]  # J_0 = J_task - sum alpha_i J_rel,i
    J_gap, J_omega_0 = np.zeros((3, chain.n)), np.zeros((3, chain.n))

    def fill(state: State, e: Array, J: Array, rate: Array) -> None:
        arms.update(state)
        R_0, gap, J_rel = arms.R_0, arms.gap, state.J_rel[arms.at : arms.at + 6]
        R_0.T.dot(gap, e[:3])
        e[:3] -= goal.value[:3]
        first.dot(state.J_ext, J_omega_0)
        pin.skew(gap).dot(J_omega_0, J_gap)
        np.add(J_gap, J_rel[:3], J_gap)
        R_0.T.dot(J_gap, J[:3])
        rate[:3] = goal.rate[:3]
        error.fill(state.t, arms.Q, R_0.T, J_rel[3:], (e[3:], J[3:], rate[3:]))

    return fill


_FILLS = {
    Kind.LEAN: _lean_rows, Kind.TILT: _tilt_rows, Kind.ROTATION: _rotation_rows,
    Kind.TWIST: _twist_rows, Kind.CENTERING: _centering_rows, Kind.BARRIER: _barrier_rows,
    Kind.POSTURE: _posture_rows, Kind.RELATIVE: _relative_rows,
}  # fmt: skip
