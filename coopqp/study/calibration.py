"""The constant errors of a model, identified from the measured joints of a run.

Where the hands hold one object the real loops are closed, so the loop error at measured joints q_m
is the model's own error. With A_i the object in hand i, X_i the hand, and the unknown shift and
rotation xi_i of the object in each hand but the first, and encoder offsets o,

    X_i(q_m - o) A_i exp(xi_i) = X_0(q_m - o) A_0      in every tick

by Gauss-Newton least squares: errors are millimetres, so the second step is the last that matters.
A motion of the object in *all* hands alike opens no loop, and is not identifiable. Rows are
weighted by their residuals, positions and orientations apart.

A combination of parameters that the motion does not identify to ``SIZE`` stays zero, and is named.
Hand-eye calibration by closed loops: Hollerbach and Wampler 1996.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError
from coopqp.base.rank import RANK_TOLERANCE
from coopqp.base.spec import Array
from coopqp.model.closed_chain import AXES, ClosedChain
from coopqp.model.state import State

#: Number of ticks that are used at most, evenly spread, and that are needed to estimate noise.
MAX_TICKS, MIN_TICKS = 1500, 10
#: Gauss-Newton steps, and Newton steps to the start with the new loops closed.
STEPS, NEWTON = 5, 20
#: Accuracy that an offset must be identified to [m, rad]; else it stays zero.
SIZE = 5e-3
#: Standard deviation of a row at first, and its minimum [m, rad].
FIRST, SMALLEST = np.array([1e-4, 1e-3]), np.array([1e-8, 1e-7])
#: Share of a parameter in what is not identified, above which it is not identified itself.
SHARE = 0.1
#: Joints that move less than this stand still [rad, m].
STILL = 0.02
#: A residual is more than noise above so many times the noise, this share of the error, and this
#: much [m, rad].
TIMES, LEFT, WORTH = 3.0, 0.1, np.array([1e-4, 5e-4])
WORLD = pin.LOCAL_WORLD_ALIGNED


@dataclass(frozen=True)
class Offset:
    """A parameter, such as "left.rot_x" of the object in a hand, in its axes, or "encoder[J1]"."""

    name: str
    unit: str  # "m" or "rad"
    value: float  # in this unit
    # standard deviation by noise alone; infinite where the motion does not identify the parameter,
    # NaN where there is one instant only
    deviation: float


@dataclass(frozen=True)
class Calibration:
    """The identified errors of a model."""

    # with the offsets of the object in the hands, at the nearest start to where the run began with
    # its loops closed
    chain: ClosedChain
    offsets: tuple[Offset, ...]  # all parameters
    # before, after: RMS of the largest loop error, position and orientation [m, rad], without the
    # offsets and with them
    before: Array
    after: Array
    noise: Array  # the same of the noise from tick to tick
    # predicted, unfitted: the same in the ticks far from the start, with the offsets identified
    # from those near it alone, and without offsets; None where the joints stand still
    predicted: Array | None
    unfitted: Array | None
    hidden: int  # number of combinations of offsets that the motion does not identify
    ticks: int  # number used
    travel: float  # of the joint that moved farthest [rad, m]

    @property
    def not_shown(self) -> tuple[str, ...]:
        """Names of the offsets that the motion does not identify."""
        return tuple(offset.name for offset in self.offsets if np.isinf(offset.deviation))

    @property
    def explains(self) -> bool | None:
        """Whether the offsets explain the run but for noise; None where nothing moved."""
        if self.predicted is None or self.unfitted is None:
            return None
        allowed = np.maximum(np.maximum(TIMES * self.noise, LEFT * self.unfitted), WORTH)
        return bool((self.predicted <= allowed).all())


def calibrate(chain: ClosedChain, q: Array, *, encoders: bool = False) -> Calibration:
    """Identify the constant errors that explain the loop errors of a chain as modelled.

    q are measured joints with the real loops closed, passive ones too, in order, shape (T, n); with
    ``encoders`` offsets of the motors' encoders are identified as well.
    """
    if chain.holding < 2:
        raise InvalidValueError("nothing to calibrate: one arm holds the object, no loop is closed")
    if not len(q) or (len(q) < MIN_TICKS and (encoders or len(q) > 1)):
        raise InvalidValueError(f"found {len(q)} measured ticks, needs at least {MIN_TICKS}")
    every = q[:: -(-len(q) // MAX_TICKS)]
    fit = _Fit(chain, encoders=encoders)
    nothing = np.zeros(len(fit.names))
    before = fit.errors(every, nothing)
    if np.abs(before).max() < SMALLEST.max():
        raise InvalidValueError("nothing to calibrate: the hands are where the model says")
    solution = fit.solve(every)
    after = fit.errors(every, solution.x)
    travel = np.ptp(every, axis=0)
    near, far = _near_and_far(every)
    moved = bool(travel.max() > STILL) and len(q) >= 2 * MIN_TICKS
    start = State(fit.chain_with(solution.x), every[0] - fit.encoder_offsets(solution.x))
    start.close_loops(NEWTON)
    return Calibration(
        chain=start.chain.moved(start.q),
        offsets=fit.offsets(solution),
        before=_size(before),
        after=_size(after),
        noise=_noise(after),
        predicted=_size(fit.errors(far, fit.solve(near).x)) if moved else None,
        unfitted=_size(fit.errors(far, nothing)) if moved else None,
        hidden=solution.hidden.shape[1],
        ticks=len(every),
        travel=float(travel.max()),
    )


class _Solution(NamedTuple):
    """Parameters x, standard deviations, and a basis of what is not identified, (P, hidden)."""

    x: Array
    deviations: Array
    hidden: Array


class _Fit:
    def __init__(self, chain: ClosedChain, *, encoders: bool) -> None:
        self.chain, self._loops = chain, chain.holding - 1
        motors = [i for i in range(chain.n) if i not in chain.passive] if encoders else []
        self._motors = np.array(motors, int)
        arms = chain.arms[1 : chain.holding]
        self.names = [f"{arm.name}.{axis}" for arm in arms for axis in AXES]
        self.names += [f"encoder[{chain.joint_names[i]}]" for i in motors]
        self.units = ["m", "m", "m", "rad", "rad", "rad"] * self._loops
        self.units += [chain.joint_units[i] for i in motors]

    def encoder_offsets(self, x: Array) -> Array:
        """Offset of each encoder, shape (n,)."""
        offsets = np.zeros(self.chain.n)
        offsets[self._motors] = x[6 * self._loops :]
        return offsets

    def _moves(self, x: Array) -> list[pin.SE3]:
        """Shift and rotation in each hand but the first, both in the object's axes."""
        poses = x[: 6 * self._loops].reshape(-1, 6)
        return [pin.SE3(pin.exp3(xi[3:]), xi[:3]) for xi in poses]

    def chain_with(self, x: Array) -> ClosedChain:
        """The chain with the object elsewhere in the hands."""
        hold, arms = self.chain.hold, self.chain.arms[1 : self.chain.holding]
        moves = zip(arms, self._moves(x), strict=True)
        moved = {arm.name: hold.X_EO[arm.name] * X for arm, X in moves}
        return ClosedChain(replace(hold, X_EO={**hold.X_EO, **moved}))

    def errors(self, q: Array, x: Array) -> Array:
        """Error of each loop in each tick, shape (T, L, 2, 3) [m; rad]."""
        return self._linearised(q, x)[0]

    def solve(self, q: Array) -> _Solution:
        x, sigma = np.zeros(len(self.names)), FIRST
        for _ in range(STEPS):
            e, J = self._linearised(q, x)
            solution = _step(e, J, sigma, x)
            residual = e + np.einsum("tlkip,p->tlki", J, solution.x - x)
            sigma = np.maximum(np.sqrt(np.mean(residual**2, axis=(0, 1, 3))), SMALLEST)
            x = solution.x
        return solution

    def offsets(self, solution: _Solution) -> tuple[Offset, ...]:
        share = np.linalg.norm(solution.hidden, axis=1)
        deviations = np.where(share > SHARE, np.inf, solution.deviations)
        return tuple(map(Offset, self.names, self.units, solution.x.tolist(), deviations.tolist()))

    def _linearised(self, q: Array, x: Array) -> tuple[Array, Array]:
        """Errors and their derivatives, shapes (T, L, 2, 3) and (T, L, 2, 3, P)."""
        chain, loops, moves = self.chain_with(x), self._loops, self._moves(x)
        model, data, frames = chain.model, chain.model.createData(), chain.frames[: loops + 1]
        e = np.zeros((len(q), loops, 2, 3))
        J = np.zeros((*e.shape, len(x)))
        for k, row in enumerate(q - self.encoder_offsets(x)):
            pin.computeJointJacobians(model, data, row)
            X_0, *others = (pin.updateFramePlacement(model, data, frame) for frame in frames)
            J_0, *J_arms = (pin.getFrameJacobian(model, data, frame, WORLD) for frame in frames)
            for i, (X, J_i) in enumerate(zip(others, J_arms, strict=True)):
                e[k, i] = X.translation - X_0.translation, pin.log3(X.rotation @ X_0.rotation.T)
                # First order; the rotation also turns what comes after it.
                J[k, i, 0, :, 6 * i : 6 * i + 3] = X.rotation @ moves[i].rotation.T
                J[k, i, 1, :, 6 * i + 3 : 6 * i + 6] = X.rotation
                J[k, i, ..., 6 * loops :] = (J_0 - J_i)[:, self._motors].reshape(2, 3, -1)
        return e, J


def _step(e: Array, J: Array, sigma: Array, x: Array) -> _Solution:
    """One step along what the motion identifies; rows are in standard deviations."""
    weight = 1.0 / sigma[:, None]
    rows = (weight[..., None] * J).reshape(-1, len(x)) * SIZE
    U, values, Vt = np.linalg.svd(rows, full_matrices=False)
    known = values > max(RANK_TOLERANCE * values[0], 1.0)
    along = Vt[known].T / values[known]
    wanted = rows @ (x / SIZE) - (weight * e).reshape(-1)
    freedom = len(rows) - len(x)
    deviations = SIZE * np.linalg.norm(along, axis=1) if freedom else np.full(len(x), np.nan)
    return _Solution(SIZE * along @ (U[:, known].T @ wanted), deviations, Vt[~known].T)


def _near_and_far(q: Array) -> tuple[Array, Array]:
    """The ticks nearer to the first than half of the largest distance, and the others."""
    way = np.linalg.norm(q - q[0], axis=1)
    near = int(np.sum(way < 0.5 * way.max()))
    cut = max(MIN_TICKS, min(near, len(q) - MIN_TICKS))
    order = np.argsort(way)
    return q[order[:cut]], q[order[cut:]]


def _size(errors: Array) -> Array:
    """RMS of the largest loop error, shape (2,) [m, rad]."""
    largest = np.linalg.norm(errors, axis=3).max(axis=1)
    return np.asarray(np.sqrt(np.mean(largest**2, axis=0)), float)


def _noise(errors: Array) -> Array:
    """The same of noise, by second differences."""
    curvature = errors[2:] - 2.0 * errors[1:-1] + errors[:-2]
    return _size(curvature) / np.sqrt(6.0) if len(curvature) else np.zeros(2)
