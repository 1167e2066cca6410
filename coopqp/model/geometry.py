"""Where a point and an axis of the object are, seen from a reference in space that may move.

The reference is a frame with origin c on the point, line, plane or circle in space and third axis
along the line or the normal. The origin moves at c_dot and the frame turns about an axis through
it at omega. Its first two axes, a basis of the plane normal to the third, are chosen once at the
start and turn with the frame, so they never jump. With R its axes, p a point and a an axis of the
object, and everything in the reference's own coordinates,

    x = R' (p - c),   x_dot = R' (J_p v - c_dot - omega x (p - c))
    y = R' a,         y_dot = R' (J_omega v - omega) x y

so that an error f(x, y) has its exact Jacobian and rate from one chain rule, moving or not.
"""

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array, Direction, Vector3, one_angle, spec, unit
from coopqp.model.profile import Profile
from coopqp.model.state import PointOfObject, State
from coopqp.signal import DIRECTION, POINT, Instant, Moment, Signal, Trajectory, trajectory_of

#: Below this two directions count as parallel, or a point as on an axis, and any way is taken.
TINY = 1e-14  # sine of an angle, or [m]; below it are rounding and no way

#: Half angle of the cone about the opposite direction in which rows are kept from growing [rad].
CONE = 0.02

_STILL, _UP = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)


@spec
class Turn:
    """A turn of a reference about an axis through its point."""

    axis: Direction
    """In the world; any length."""
    angle: float | None = None
    """How far [rad]."""
    angle_deg: float | None = None
    """How far [degrees]; instead of angle."""
    profile: Profile = Profile()
    """When and how."""

    def __post_init__(self) -> None:
        one_angle("angle", self.angle, self.angle_deg, needed=True)
        if not self.profile.compiles:
            raise ValueError(f"profile: found {self.profile.kind}, which is for a task's own way")

    @property
    def radians(self) -> float:
        return math.radians(self.angle_deg) if self.angle is None else self.angle  # type: ignore[arg-type]


class Reference:
    """A frame that the object is steered to; InvalidValueError: it moves in two ways at once.

    Args:
        origin: where it is at t = 0, in the world, shape (3,) [m]; or a signal, or a trajectory.
        direction: of its third axis before it turns, in the world; any length; or a signal.
        velocity: of its origin, in the world, shape (3,) [m/s].
        turn: about an axis through its origin.
        start: the instant from which it sets out.
        point, axis: of the object, in the object frame [m]; there and along it inputs begin, so
            that nothing has to move for them.

    Attributes:
        c, c_dot: its origin and that one's velocity, in the world, shape (3,) [m; m/s].
        RT: its axes as rows, R', shape (3, 3).
        omega: its angular velocity, in the world, shape (3,) [rad/s].
        moves: whether anything changes with time.
        follows: whether it follows a signal.
        arrives: name of the input that is its place, where it follows nothing else; else empty.
    """

    def __init__(
        self,
        origin: Vector3 | Signal | Trajectory = _STILL,
        direction: Vector3 | Signal = _UP,
        velocity: Vector3 = _STILL,
        turn: Turn | None = None,
        *,
        start: Instant | None = None,
        point: Vector3 | None = None,
        axis: Vector3 | None = None,
    ) -> None:
        start = start or Moment()
        if isinstance(origin, Signal) and any(velocity):
            words = "velocity: the place is a signal, which says how it moves; omit it"
            raise InvalidValueError(words)
        if isinstance(direction, Signal) and turn is not None:
            words = "turn: the direction is a signal, which says how it turns; omit it"
            raise InvalidValueError(words)
        here = along = None
        if isinstance(start, State):
            if isinstance(origin, Signal) and point is not None:
                here = start.point(np.array(point))
            if isinstance(direction, Signal):
                along = DIRECTION.read(_UP if axis is None else start.R_WO @ np.array(axis))
        self._origin = (
            origin if isinstance(origin, Trajectory) else trajectory_of(origin, POINT, start, here)
        )
        self._axes = trajectory_of(direction, DIRECTION, start, along)
        self._c_0, self._RT_0 = self._origin.value.copy(), self._axes.R.T
        self.c, self.RT = self._c_0.copy(), self._RT_0.copy()
        self.c_dot, self.omega = np.array(velocity, float), np.zeros(3)
        self._turning = turn.profile if turn else None
        self._turn = turn.radians * unit(turn.axis) if turn else np.zeros(3)
        self._slides = bool(self.c_dot.any())
        self.follows = self._origin.moves or self._axes.moves
        self.arrives = "" if turn is not None or self._axes.moves else self._origin.arrives
        self.moves = self.follows or turn is not None or self._slides

    def numbers(self) -> Array:
        """(22,): c_0, R_0', c_dot, turn, its profile (kind, duration, delay), whether it turns."""
        profile = (0.0, 1.0, 0.0, 0.0) if self._turning is None else (*self._turning.numbers, 1.0)
        return np.concatenate([self._c_0, self._RT_0.ravel(), self.c_dot, self._turn, profile])

    def update(self, at: Instant) -> None:
        if not self.moves:
            return
        if self._origin.moves:
            self._origin.update(at)
            self.c[:], self.c_dot[:] = self._origin.value, self._origin.rate
        elif self._slides:
            np.multiply(self.c_dot, at.t, self.c)
            np.add(self.c, self._c_0, self.c)
        if self._axes.moves:
            self._axes.update(at)
            self.RT[:], self.omega[:] = self._axes.R.T, self._axes.rate
        elif self._turning:
            share, speed = self._turning.at(at.t)
            self._RT_0.dot(pin.exp3(self._turn * share).T, self.RT)
            np.multiply(self._turn, speed, self.omega)


class PlaceOf(Trajectory):
    """The place of a pose, as the origin of a reference; its follower has moved the pose before."""

    def __init__(self, pose: Trajectory) -> None:
        self.kind, self.moves = POINT, pose.moves
        self.value, self.rate = pose.value[:3], pose.rate[:3]


class PointInReference:
    """A point of the object in the axes of a reference, updated before: x, Jacobian, rate."""

    def __init__(self, p_O: ArrayLike, reference: Reference, n: int) -> None:
        self._tracked, self._reference = PointOfObject(p_O, n), reference
        self.x, self.J, self.rate = np.zeros(3), np.zeros((3, n)), np.zeros(3)

    def update(self, state: State) -> None:
        tracked, reference = self._tracked, self._reference
        tracked.update(state)
        lever = tracked.p - reference.c
        reference.RT.dot(lever, self.x)
        reference.RT.dot(tracked.J, self.J)
        if reference.moves:
            drag = reference.c_dot + pin.skew(reference.omega).dot(lever)
            reference.RT.dot(drag, self.rate)


@dataclass(frozen=True, slots=True)
class Polar:
    """A unit vector by its angle [rad] from the third axis, 0 to pi, and its way from it.

    The way is a unit vector in the plane of the first two axes; the first where none is known.
    """

    angle: float
    sine: float
    way: tuple[float, float]


def polar(y: Array) -> Polar:
    """The unit vector y, shape (3,), by angle and way; finite for all of them."""
    y_0, y_1, y_2 = y.tolist()
    sine = math.hypot(y_0, y_1)
    way = (y_0 / sine, y_1 / sine) if sine > TINY else (1.0, 0.0)
    return Polar(math.atan2(sine, y_2), sine, way)


#: Diagonal of the inverse Jacobian next to the opposite direction.
LOWEST = (math.pi - CONE) / math.tan(math.pi - CONE)


def inverse_alignment(axis: Polar) -> Array:
    """E with e_dot = E omega, shape (2, 3), where an axis leans by e = theta u, turning at omega.

        E = [ -(1-h) u_0 u_1     h + (1-h) u_0^2   -theta u_1 ]   h = theta cot theta
            [ -h - (1-h) u_1^2   (1-h) u_0 u_1      theta u_0 ]

    All is smooth but at theta = pi, where no way is shortest: one is taken at the start, and if the
    axis gets there later, as with a step, u is the reference's first axis, so the error is pi, not
    zero, and the object leaves. There h, the row sideways, would grow beyond bounds; within
    ``CONE`` of pi it keeps its value at the cone's edge.
    """
    theta, (u, w) = axis.angle, axis.way
    if axis.sine > TINY:
        h = max(theta * math.cos(theta) / axis.sine, LOWEST)
    else:
        h = 1.0 if theta < 1.0 else LOWEST
    k = 1.0 - h
    return np.array(
        [[-k * u * w, h + k * u * u, -theta * w], [-h - k * w * w, k * u * w, theta * u]]
    )


class RotationError:
    """Three rows that turn Q, an orientation that the joints change, onto its goal.

    The reference turns about one axis of the goal, which may turn itself at omega_g, Q_r = exp((s -
    1) phi) Q_goal with phi = log(Q_goal Q_start') at the start. With Q_e = Q Q_r', Jl the left
    Jacobian of SO(3) and R' J_omega the Jacobian of Q's rotation,

        e = log Q_e,   J = Jl^-1(e) R' J_omega
        rate = Jl^-1(e) Q_e (s_dot phi + exp((s - 1) phi) omega_g)

    Q_goal is a rotation or a pose that is updated before this, None for Q_start. ``rows`` is
    Jl^-1(e) R' of the last tick, shape (3, 3): what R brings in by turning itself.
    """

    def __init__(
        self, goal: Trajectory | None, profile: Profile, phi: Array, Q_start: Array
    ) -> None:
        self._profile, self._phi, self._start = profile, phi, Q_start
        self._goal = goal if goal and goal.moves else None
        self.rows = np.zeros((3, 3))

    def fill(
        self, t: float, Q: Array, RT: Array, J_omega: Array, out: tuple[Array, Array, Array]
    ) -> None:
        """Write e, J and rate, shapes (3,) [rad], (3, n) [rad/rad] and (3,) [rad/s].

        RT turns the axes of J_omega, shape (3, n), into those of the orientation Q.
        """
        e, J, rate = out
        share, speed = self._profile.at(t)
        turning = self._phi * speed
        if goal := self._goal:
            left = pin.exp3(self._phi * (share - 1.0))
            Q_r = left.dot(goal.R)
            turning += left.dot(goal.rate[goal.kind.numbers :])
        else:  # the same, and exactly the start at the start
            Q_r = pin.exp3(self._phi * share).dot(self._start)
        Q_e = Q.dot(Q_r.T)
        e[:] = pin.log3(Q_e)
        J_log = _inverse_left_jacobian(e)
        J_log.dot(RT, self.rows)
        self.rows.dot(J_omega, J)
        J_log.dot(Q_e.dot(turning), rate)


_ONE = np.eye(3)


def _inverse_left_jacobian(w: Array) -> Array:
    """Jl^-1(w), log(exp(a) exp(w)) = w + Jl^-1(w) a; pinocchio's Jlog3 loses digits at 1e-4 rad."""
    x, y, z = w.tolist()
    t2 = x * x + y * y + z * z
    if t2 < 1e-3:
        c = (1.0 + t2 / 60.0 * (1.0 + t2 / 42.0 * (1.0 + t2 / 40.0))) / 12.0
    else:
        half = 0.5 * math.sqrt(t2)
        c = (1.0 - half / math.tan(half)) / t2
    S = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    J: Array = _ONE - 0.5 * S + c * S.dot(S)
    return J
