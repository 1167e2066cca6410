"""Points of the object and of the robot stay on one side of a plane, such as a table or a wall.

With n the plane's unit normal, c a point on it and p the point, d = n'(p - c) is its distance and
the velocity damper d_dot >= -gain d lets it approach no faster than it can stop:

    -n' J_p v <= gain n'(p - c)

A point that is deeper than a millimetre on the wrong side may not go farther, but is not pushed
back (:func:`coopqp.limit.damp`), so that one that cannot recover does not stop the robot.
"""

import itertools
from dataclasses import replace

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError, require_known
from coopqp.base.qp import Row
from coopqp.base.spec import Array, Direction, Name, Positive, Vector3, overshoot, spec, unit
from coopqp.limit import Clearance, Limit, LimitRows, Tighten, TwistBounds, damp, movers, place_row
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.marker import Marker, PlaneMarker
from coopqp.model.state import State


@spec
class Workspace(Limit):
    """A half-space that the object, hands or elbows must not leave."""

    name: Name = "workspace"
    """Your name for it in rows and tables, such as "table"; give it when there are several."""
    normal: Direction
    """Of the plane, in the world, into the side that is allowed; any length."""
    through: Vector3
    """A point on the plane, in the world [m]."""
    points: tuple[Vector3, ...] | None = None
    """Points of the object, in the object frame [m]; its eight corners if omitted."""
    frames: tuple[str, ...] = ()
    """Frames of the robot whose origins stay inside too, such as RHand."""
    gain: Positive = 10.0
    """Share of the distance that may be used up per second [1/s]; at most 1/dt."""

    def __post_init__(self) -> None:
        if self.points == () and not self.frames:
            raise ValueError("needs points of the object or frames of the robot")

    def rows(self, chain: ClosedChain) -> tuple[Row, ...]:
        known = [frame.name for frame in chain.model.frames]
        require_known("frame", self.frames, known, f"{self.name}: ", ("frames",))
        points = {
            f"object[{i}]": f"{self._name_of(point)} of the object"
            for i, point in enumerate(self._points(chain))
        }
        return tuple(
            place_row(self.name, f".{what}", f"the {self.name}, {words}")
            for what, words in (points | {frame: frame for frame in self.frames}).items()
        )

    def bind(self, chain: ClosedChain, dt: float) -> Tighten:
        """One row a point; the points' world positions are kept for the distances."""
        if wrong := overshoot(self.gain, dt):
            raise InvalidValueError(f"{self.name}: {wrong}")
        points = _Points(chain, self._points(chain), self.frames)
        n, offset = self._plane()
        gain, k = np.full(len(points.p), self.gain), points.of_object
        d, turning, S = np.zeros(len(points.p)), np.zeros((len(points.p), 3)), pin.skew(-n)
        deep = np.zeros(len(points.p), bool)
        G, any_frames = np.zeros((len(points.p), chain.n)), bool(self.frames)

        def tighten(state: State, rows: LimitRows) -> None:
            points.update(state)
            points.p.dot(n, d)
            damp(np.subtract(d, offset, d), gain, deep, rows.h)
            # d_dot = n'(J_v + J_omega x arm), arm x n = S' arm; the object turns about its origin.
            points.arms.dot(S, turning)
            turning[:k].dot(state.J_task[3:], G[:k])
            np.subtract(G[:k], n.dot(state.J_task[:3]), rows.G[:k])
            if any_frames:
                turning[k:].dot(state.J_joints[3:], G[k:])
                np.subtract(G[k:], n.dot(state.J_joints[:3]), G[k:])
                np.multiply(G[k:], points.moved, rows.G[k:])

        return tighten

    def program(self, chain: ClosedChain, dt: float) -> TwistBounds | None:
        """The same plane; none with frames, which move with some of the joints."""
        if self.frames:
            return None
        n, offset = self._plane()
        return TwistBounds(points=self._points(chain), normal=n, offset=offset, gain=self.gain)

    def clearance(self, chain: ClosedChain) -> Clearance:
        """Distance of each point from the plane [m]."""
        points = _Points(chain, self._points(chain), self.frames)
        n, offset = self._plane()

        def left(state: State) -> Array:
            points.update(state)
            return np.asarray(points.p.dot(n) - offset, float)

        return left

    def relaxed(self, by: float) -> Limit:
        """The plane moved away from the side that is allowed."""
        x, y, z = (np.array(self.through) - by * unit(self.normal)).tolist()
        return replace(self, through=(x, y, z))

    def marks(self, t: float) -> tuple[Marker, ...]:
        return (PlaneMarker(normal=np.array(self.normal), through=np.array(self.through)),)

    def _plane(self) -> tuple[Array, float]:
        n = unit(self.normal)
        return n, float(n @ np.array(self.through))

    def _name_of(self, point: Array) -> str:
        if self.points is None:
            sides = (
                f"{'+' if c > 0.0 else '-'}{axis}" for c, axis in zip(point, "xyz", strict=True)
            )
            return f"corner {' '.join(sides)}"
        return f"point ({', '.join(f'{c:g}' for c in point)})"

    def _points(self, chain: ClosedChain) -> Array:
        if self.points is not None:
            return np.array(self.points, float).reshape(-1, 3)
        half = 0.5 * np.array(chain.held.size)
        return np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * half


class _Points:
    """Where points of the object, then origins of frames, are."""

    def __init__(self, chain: ClosedChain, p_O: Array, frames: tuple[str, ...]) -> None:
        bodies = [chain.model.frames[chain.model.getFrameId(name)] for name in frames]
        self._p_O, self.of_object = p_O, len(p_O)
        self._fixed = [(f.parentJoint, np.array(f.placement.translation)) for f in bodies]
        self.moved = movers(chain, [joint for joint, _ in self._fixed])
        self.p = np.zeros((len(p_O) + len(frames), 3))
        #: From what the rows turn about: the object's origin, or the world's for frames.
        self.arms = np.zeros_like(self.p)

    def update(self, state: State) -> None:
        k = self.of_object
        self._p_O.dot(state.R_WO.T, self.arms[:k])
        np.add(self.arms[:k], state.p_WO, self.p[:k])
        for i, (joint, p_J) in enumerate(self._fixed, k):
            self.p[i] = self.arms[i] = state.joint_pose(joint).act(p_J)
