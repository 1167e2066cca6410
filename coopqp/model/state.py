"""What is true at one instant, with the kinematics computed once.

W is the world, O the object, i an arm. Poses of the object as carried by each arm are averaged
with the chain's weights alpha: p = sum alpha_i p_i, and R = exp(sum alpha_i log(R_i R_0')) R_0.
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.linalg import lapack

from coopqp.base.rank import independent_rows, least_squares
from coopqp.base.spec import Array, read_only, real, vector
from coopqp.model.closed_chain import ClosedChain
from coopqp.signal import InputValues, Instant, Kind, quaternion_of


class Memory:
    """What a law remembers from tick to tick, by name, in one array that can be recorded."""

    def __init__(self, sizes: Mapping[str, int]) -> None:
        self.sizes = dict(sizes)
        ends = list(itertools.accumulate(self.sizes.values(), initial=0))
        self.numbers = np.zeros(ends[-1])
        self._parts = dict(zip(self.sizes, map(slice, ends, ends[1:]), strict=True))

    def __getitem__(self, name: str) -> Array:
        """The numbers of one name; a view, to be written to."""
        return self.numbers[self._parts[name]]

    def shown(self) -> Memory:
        """The same numbers, for those who must not write to them."""
        other = copy.copy(self)
        other.numbers = read_only(self.numbers)
        return other


class State:
    """The state of a closed chain at one instant; its arrays are reused from tick to tick.

    It begins at q, or the chain's start, and t [s]; InvalidValueError: q is no n numbers. The law
    makes its own ``memory`` where this does not fit; with t, q and v it replays a tick.

    Attributes:
        q, v: configuration and velocity, shape (n,) [rad, m; rad/s, m/s]. Where velocities are
            commanded, q is the *commanded* configuration, the integral of the commands, and the
            measured one is ``q_measured``; where torques are, q is measured.
        p_WO, R_WO: the object's pose, shapes (3,) [m] and (3, 3).
        loop_error: how far arm i carries the object from where arm 0 does, shape (6 L,): position
            [m], then rotation vector [rad], per loop; open loops come last.
        loop_offset: loop-closure offset, shape (6 L,), not corrected: the model's bias, observed
            where joints are measured, and the displacement that squeezing hands are commanded.
        drift: loop_error - loop_offset, what the Baumgarte stabilisation corrects, shape (6 L,).
        closed_error: the part of drift that belongs to closed loops.
        q_measured: measured joint positions, shape (n,); None where they are the commanded.
        hand_wrench: measured wrenches of the hands on the object, by the robot's arms, each at its
            hand's point, world axes, shape (6 N,) [N, N m]; None where there are none.
        observer_state: weight that the loop observer estimates [N], NaN before it is measured;
            time at rest [s]; loop error where joints were first measured, shape (2 + 6 L,).
        corrected: share of the Baumgarte correction that the last tick did.
        jacobians_due: whether only the poses are up to date; Jacobians are computed when asked for.
        joints_due: whether ``J_ext`` is the kernel's, and what else is known of each joint is due.
        inputs: filtered values of what arrived from outside, by name; empty where nothing can.
    """

    def __init__(
        self,
        chain: ClosedChain,
        q: ArrayLike | None = None,
        t: float = 0.0,
        memory: Memory | None = None,
    ) -> None:
        arms, n = len(chain.arms), chain.n
        self.chain = chain
        self.t = t
        self.q = vector("q", chain.q_start if q is None else q, n)
        self.v = np.zeros(n)
        self.memory = Memory({}) if memory is None else memory
        self.inputs = InputValues()
        self._J_ext = np.zeros((6 * arms, n))
        self._J_shown = read_only(self._J_ext)
        self._J_task, self._J_rel = self._J_shown[:6], self._J_shown[6:]
        self._q_seen, self.jacobians_due, self.joints_due = self.q.copy(), False, False
        self.loop_error, self.loop_offset, self.drift = np.zeros((3, 6 * (arms - 1)))
        self.observer_state = np.full(2 + 6 * (arms - 1), np.nan)
        self.q_measured: Array | None = None
        self.hand_wrench: Array | None = None
        self._commanded = np.zeros(n)  # no configuration yet
        self._own: dict[str, Any] = dict.fromkeys(("q", *_SHOWN_ELSEHOW))  # of nobody yet
        self.corrected = 1.0
        self.p_WO, self.R_WO = np.zeros(3), np.eye(3)
        self._model, self._data = chain.model, chain.model.createData()
        self._J_joints = read_only(self._data.J)
        frames = (self._data.oMf[frame] for frame in chain.frames)
        self._hands = [(X.translation, X.rotation) for X in frames]  # views, which stay valid
        self._prepare_loop_rows()
        self.update()

    def __reduce__(self) -> tuple[Any, ...]:
        # Its arrays are views into each other and into pinocchio's data: a copy is made anew.
        return state_of, (self.chain, self.kept())

    def kept(self) -> Kept:
        """All that :func:`state_of` needs beside the chain, to be sent elsewhere."""
        sensed = self.q_measured, self.hand_wrench, self.observer_state
        own = (self.v, self.loop_offset, sensed, self.corrected, self._commanded)
        return self.q, self.t, self.memory, own, self.inputs.now()

    def __repr__(self) -> str:
        return f"State(t={self.t:g}, q={self.q}, v={self.v})"

    def lock(self) -> None:
        """Show arrays that nobody can write to, and replace no attributes, while plug-ins look."""
        own = self._own
        if not (
            self.q is own["q"]
            and self.v is own["v"]
            and self.loop_offset is own["loop_offset"]
            and self.memory is own["memory"]
            and self.inputs is own["inputs"]
        ):
            self._show()
        if self.q_measured is not own["q_measured"]:
            self._show_measured()
        self.__dict__.update(self._shown)
        self.__class__ = _Locked

    def unlock(self) -> None:
        object.__setattr__(self, "__class__", State)
        self.__dict__.update(self._own)

    def _show(self) -> None:
        """Make read-only views, of all that the state has now."""
        of = ("q", "v", "loop_offset", "p_WO", "R_WO", "loop_error", "drift", "closed_error")
        self._own = {name: getattr(self, name) for name in (*of, *_SHOWN_ELSEHOW)}
        self._shown: dict[str, Any] = {name: read_only(self._own[name]) for name in of}
        self._shown["memory"] = self.memory.shown()
        self._shown["inputs"] = self.inputs.shown()
        self._show_measured()

    def _show_measured(self) -> None:
        """The same of what was measured, or whatever a driver has given instead."""
        given: Any = self.q_measured
        self._own["q_measured"] = self._shown["q_measured"] = given
        if isinstance(given, np.ndarray):
            self._shown["q_measured"] = shown = given.view()
            shown.flags.writeable = False

    def update(self) -> None:
        """Compute everything that follows from q; a law does it at the start of each tick."""
        self._q_seen[:] = self.q
        self._differentiate()
        self._update_errors()
        self.update_drift()

    def _differentiate(self) -> None:
        self.jacobians_due = self.joints_due = False
        model, data, axes = self._model, self._data, pin.LOCAL_WORLD_ALIGNED
        pin.computeJointJacobians(model, data, self._q_seen)
        for frame in self.chain.frames:
            pin.updateFramePlacement(model, data, frame)
        J_arms = [pin.getFrameJacobian(model, data, frame, axes) for frame in self.chain.frames]
        self.chain.mixing.dot(np.concatenate(J_arms), self._J_ext)

    def written(self) -> dict[str, Array]:
        """Arrays by name that the kernel writes instead of :meth:`update`; others are then due.

        ``q_seen`` is the q that the poses belong to, ``commanded`` what :meth:`advance` keeps.
        """
        return {
            "q": self.q, "v": self.v, "loop_offset": self.loop_offset, "p_WO": self.p_WO,
            "R_WO": self.R_WO, "loop_error": self.loop_error, "drift": self.drift,
            "q_seen": self._q_seen, "commanded": self._commanded, "J_ext": self._J_ext,
            "observer_state": self.observer_state,
        }  # fmt: skip

    def _refresh(self) -> None:
        """Compute all of the q that the poses belong to, if that is still to be done."""
        if self.jacobians_due or self.joints_due:
            self._differentiate()
            if self._rows_chosen:
                self._update_loop_rows()

    @property
    def J_ext(self) -> Array:
        """[J_tsk; J_rel] of eq. (31), shape (6 N, n)."""
        if self.jacobians_due:
            self._refresh()
        return self._J_shown

    @property
    def J_task(self) -> Array:
        """Its first six rows, (v; omega) of the object in world axes."""
        if self.jacobians_due:
            self._refresh()
        return self._J_task

    @property
    def J_rel(self) -> Array:
        """The other 6 L rows."""
        if self.jacobians_due:
            self._refresh()
        return self._J_rel

    @property
    def J_joints(self) -> Array:
        """What each joint does to a body that it moves, shape (6, n), world axes.

        Velocity of the body's point that is at the world's origin, then angular velocity. A point p
        of the body goes along a direction d at [d; p x d]' J_joints v. Of this q; ask in each tick.
        """
        self._refresh()
        return self._J_joints

    def place_object(self, p: Array, R: Array, J: Array) -> None:
        """Show the object at a pose that no joint has brought it to, with J_task = J, (6, n)."""
        self.p_WO[:], self.R_WO[:], self._J_ext[:6] = p, R, J

    @property
    def J_loop(self) -> Array:
        """The independent rows of J_rel, for the solvers."""
        self._refresh()
        return self._J_loop_shown

    @property
    def e_loop(self) -> Array:
        """The drift in these rows."""
        self._refresh()
        return self._e_loop_shown

    def advance(self, v: Array, dt: float) -> None:
        """Go on to the next tick with the commanded v, (n,): q + v dt, t + dt; q_measured stays."""
        self.q += dt * v
        self.v[:] = v
        self.t += dt
        self._commanded[:] = self.q

    @property
    def reading(self) -> Array | None:
        """A copy of ``q_measured`` where it is n real numbers; NaN are some."""
        if self.q_measured is None:
            return None
        try:
            found = real(self.q_measured)
        except ValueError:
            return None
        return found if found.shape == self.q.shape else None

    @property
    def overwritten(self) -> bool:
        """Whether q, with sensors that measure another, is not what :meth:`advance` has left."""
        if self.q_measured is None or not self._commanded.any():
            return False
        return not np.array_equal(self.q, self._commanded)

    @property
    def overwritten_by(self) -> Array:
        """By how much q differs from what :meth:`advance` has left, shape (n,) [rad, m]."""
        return self.q - self._commanded

    def update_poses(self) -> None:
        """Compute the object's pose and the loop errors alone, without the Jacobians."""
        self._q_seen[:] = self.q
        pin.forwardKinematics(self._model, self._data, self.q)
        for frame in self.chain.frames:
            pin.updateFramePlacement(self._model, self._data, frame)
        self._update_errors()

    def update_drift(self) -> None:
        """Compute what follows from the loop offset; call it after that has changed."""
        np.subtract(self.loop_error, self.loop_offset, self.drift)
        if self._rows_chosen:
            self._update_loop_rows()

    def close_loops(self, iterations: int = 1) -> None:
        """Newton steps of least norm to closed loops, q -= J' (J J')^-1 e; then v along them.

        One does for an integration step's drift.
        """
        if not len(self.e_loop):
            return
        for _ in range(iterations):
            self.q -= self._through_loops(self.e_loop)
            self.update()
        self.v -= self._through_loops(self.J_loop.dot(self.v))

    def _through_loops(self, rows: Array) -> Array:
        """Joint motion of least norm that moves the loop rows by this much."""
        J = self.J_loop
        _, x, info = lapack.dposv(J.dot(J.T), rows)
        if info:  # not positive definite: the loops are singular here
            return least_squares(J, rows)
        return np.asarray(J.T.dot(x), float)

    def point(self, p_O: Array) -> Array:
        """World position of a point of the object, both of shape (3,) [m]."""
        return self.p_WO + self.R_WO @ p_O

    def joint_pose(self, joint: int) -> pin.SE3:
        """Pose of the frame of a joint (an id; 0 is the world) in the world, up to date."""
        self._refresh()
        return self._data.oMi[joint]

    def place(self, geometry: pin.GeometryModel, placed: pin.GeometryData) -> None:
        """Put bodies that are fixed to the chain's joints where they are now, into ``placed``."""
        self._refresh()
        pin.updateGeometryPlacements(self._model, self._data, geometry, placed)

    @property
    def loop_position_error(self) -> float:
        """Largest drift between where two arms carry the object [m]."""
        return self._largest(0)

    @property
    def loop_orientation_error(self) -> float:
        """Largest drift between how two arms carry the object [rad]."""
        return self._largest(3)

    def _largest(self, first: int) -> float:
        drift = self.closed_error.tolist()
        parts = (drift[i : i + 3] for i in range(first, len(drift), 6))
        return max((math.hypot(*part) for part in parts), default=0.0)

    def _update_errors(self) -> None:
        (p_0, R_0), *others = self._hands
        errors = self.loop_error.reshape(-1, 6)
        for error, (p_i, R_i) in zip(errors, others, strict=True):
            error[:3] = p_i - p_0
            # log(R_i R_0') is the rotation from how arm 0 to how arm i carries it, world axes.
            error[3:] = pin.log3(R_i.dot(R_0.T))
        mean = self.chain.alpha[1:].dot(errors)
        np.add(p_0, mean[:3], self.p_WO)
        pin.exp3(mean[3:]).dot(R_0, self.R_WO)

    def _prepare_loop_rows(self) -> None:
        loops = self.chain.loops
        rank = min(loops.rank, len(loops.kept))
        self._kept = np.array(loops.kept, int)
        self.closed_error = self.drift[: loops.closed]
        self._J_loop, self._e_loop = self._J_rel[: loops.closed], self.closed_error
        self._rows_chosen = loops.varying or len(loops.kept) < loops.closed
        if self._rows_chosen:
            self._J_loop, self._e_loop = np.zeros((rank, self.chain.n)), np.zeros(rank)
        self._J_loop_shown, self._e_loop_shown = read_only(self._J_loop), read_only(self._e_loop)

    def _update_loop_rows(self) -> None:
        rows = self._kept
        if self.chain.loops.varying:
            rows = rows[independent_rows(self._J_rel[rows], max_rows=len(self._e_loop))]
            # At a singular pose fewer rows are independent; the missing ones ask for nothing.
            self._J_loop[:], self._e_loop[:] = 0.0, 0.0
        self._J_loop[: len(rows)] = self._J_rel[rows]
        self._e_loop[: len(rows)] = self.drift[rows]


#: What of a state plug-ins see in another way than by a view of its array.
_SHOWN_ELSEHOW = ("memory", "inputs", "q_measured")


class _Locked(State):
    """A state while code of plug-ins looks at it: what it has cannot be replaced."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not name.startswith(("_", "jacobians_due", "joints_due")):  # what it computes when asked
            raise AttributeError(f"state.{name} cannot be replaced: plug-ins only read the state")
        object.__setattr__(self, name, value)


_Locked.__name__ = State.__name__  # which errors of plug-ins name

Kept = tuple[Array, float, Memory, tuple[Any, ...], InputValues]


def state_of(chain: ClosedChain, kept: Kept) -> State:
    """The state of a chain, up to date, from what another of it has :meth:`State.kept`."""
    q, t, memory, own, inputs = kept
    state = State(chain, q, t, memory)
    state.inputs = inputs
    state.v[:], state.loop_offset[:], sensed, state.corrected, state._commanded[:] = own
    state.q_measured, state.hand_wrench, state.observer_state[:] = sensed
    state.update()
    return state


def object_at(at: Instant, kind: Kind) -> Array | None:
    """Where the object is, as a rotation or a pose; None at an instant without a state."""
    if not isinstance(at, State):
        return None
    return np.concatenate([at.p_WO[: kind.numbers], quaternion_of(at.R_WO)])


class PointOfObject:
    """A point of the object, p_O [m]: its place p in the world and velocity Jacobian J (3, n)."""

    def __init__(self, p_O: ArrayLike, n: int) -> None:
        self._p_O = np.array(p_O, float)
        self.p, self.J = np.zeros(3), np.zeros((3, n))

    def update(self, state: State) -> None:
        lever = state.R_WO.dot(self._p_O)
        np.add(state.p_WO, lever, self.p)
        J = state.J_task
        np.subtract(J[:3], pin.skew(lever).dot(J[3:]), self.J)
