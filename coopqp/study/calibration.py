"""The constant errors of a model, from the joints that a run has measured.

Where the hands hold one object the real loops are closed, so what the model's loops are open by at
measured joints q_m is the model's own error. With A_i the object in hand i, X_i the hand, and what
is looked for, a shift and a turn xi_i of the object in each hand but the first, and what the
encoders say too much, o,

    X_i(q_m - o) A_i exp(xi_i) = X_0(q_m - o) A_0      in every tick

by Gauss-Newton least squares: errors are millimetres, so the second step is the last that matters.
Where the object is in *all* hands cannot be told: moving it in all of them alike opens no loop.
Rows count by what is left of them, positions and orientations apart.

A combination of parameters that the motion does not show, or not to ``SIZE``, stays zero, and is
said. Hand-eye calibration by closed loops: Hollerbach and Wampler 1996.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError
from coopqp.base.rank import RANK_TOLERANCE
from coopqp.base.spec import Array
from coopqp.model.closed_chain import AXES, ClosedChain
from coopqp.model.state import State

#: Ticks that are used at most, evenly spread.
MOST = 1500
#: TickBatch below which noise is no noise.
FEWEST = 10
#: Steps of Gauss and Newton.
STEPS = 5
#: What an offset must be known to [m, rad]; what the motion shows less well stays zero.
SIZE = 5e-3
#: Standard deviation of a row at first, and least [m, rad].
FIRST, LEAST = np.array([1e-4, 1e-3]), np.array([1e-8, 1e-7])
#: Share of a parameter in what is not shown, above which it is not shown itself.
SHARE = 0.1
#: Joints that move less than this stand still [rad, m].
STILL = 0.02
#: A fit leaves more than noise where it leaves so many times as much, and more than a share of
#: the error, and more than this [m, rad].
TIMES, LEFT, WORTH = 3.0, 0.1, np.array([1e-4, 5e-4])
WORLD = pin.LOCAL_WORLD_ALIGNED
#: Newton steps to the start with the new loops closed.
NEWTON = 20


@dataclass(frozen=True)
class Offset:
    """A parameter.

    Attributes:
        name: such as "left.rot_x" of the object in a hand, in its axes, or "encoder[LElbowRoll]".
        unit: "m" or "rad".
        value: of it [unit].
        deviation: its standard deviation by noise alone; infinite where the motion does not show
            it, NaN where there is one instant only.
    """

    name: str
    unit: str
    value: float
    deviation: float


@dataclass(frozen=True)
class Calibration:
    """What a run tells of the model's errors.

    Attributes:
        chain: with the offsets of the object in the hands, at the nearest start to where the run
            began with its loops closed.
        offsets: all that was looked for.
        before, after: what the loops are open by, root of the mean square of the largest one:
            position, orientation [m, rad], without the offsets and with them.
        noise: the same of what jumps from tick to tick.
        predicted: the same in the ticks far from the start, with the offsets that those near it
            alone tell; and ``unfitted``, with none. None where the joints stand still.
        hidden: how many combinations of offsets the motion does not show.
        ticks: how many were used.
        travel: how far the joint went that went farthest [rad, m].
    """

    chain: ClosedChain
    offsets: tuple[Offset, ...]
    before: Array
    after: Array
    noise: Array
    predicted: Array | None
    unfitted: Array | None
    hidden: int
    ticks: int
    travel: float

    @property
    def explains(self) -> bool | None:
        """Whether the offsets explain the run but for noise; None where nothing moved."""
        if self.predicted is None or self.unfitted is None:
            return None
        most = np.maximum(np.maximum(TIMES * self.noise, LEFT * self.unfitted), WORTH)
        return bool((self.predicted <= most).all())


def calibrate(chain: ClosedChain, q: Array, *, encoders: bool = False) -> Calibration:
    """Find the constant errors that explain what the loops are open by.

    Args:
        chain: as modelled.
        q: measured joints with the real loops closed, passive ones too, in order, shape (T, n).
        encoders: whether to look for offsets of the motors' encoders as well.

    Raises:
        InvalidValueError: only one arm holds; too few ticks; or the hands are where the model says.
    """
    if chain.holding < 2:
        raise InvalidValueError("nothing to calibrate: one arm holds the object, no loop is closed")
    if not len(q) or (len(q) < FEWEST and (encoders or len(q) > 1)):
        raise InvalidValueError(f"found {len(q)} measured ticks, needs at least {FEWEST}")
    every = q[:: -(-len(q) // MOST)]
    fit = _Fit(chain, encoders=encoders)
    nothing = np.zeros(len(fit.names))
    before = fit.errors(every, nothing)
    if np.abs(before).max() < LEAST.max():
        raise InvalidValueError("nothing to calibrate: the hands are where the model says")
    solution = fit.solve(every)
    after = fit.errors(every, solution.x)
    travel = np.ptp(every, axis=0)
    near, far = _near_and_far(every)
    moved = bool(travel.max() > STILL) and len(q) >= 2 * FEWEST
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
    """Parameters x, their standard deviations, and a basis of what was not shown, (P, hidden)."""

    x: Array
    deviations: Array
    hidden: Array


class _Fit:
    """The least-squares problem."""

    def __init__(self, chain: ClosedChain, *, encoders: bool) -> None:
        self.chain, self._loops = chain, chain.holding - 1
        self._data = chain.model.createData()
        motors = [i for i in range(chain.n) if i not in chain.passive] if encoders else []
        self._motors = np.array(motors, int)
        arms = chain.arms[1 : chain.holding]
        self.names = [f"{arm.name}.{axis}" for arm in arms for axis in AXES]
        self.names += [f"encoder[{chain.joint_names[i]}]" for i in motors]
        self.units = ["m", "m", "m", "rad", "rad", "rad"] * self._loops
        self.units += [chain.joint_units[i] for i in motors]

    def encoder_offsets(self, x: Array) -> Array:
        """What each encoder says too much, shape (n,)."""
        offsets = np.zeros(self.chain.n)
        offsets[self._motors] = x[6 * self._loops :]
        return offsets

    def chain_with(self, x: Array) -> ClosedChain:
        """The chain with the object elsewhere in the hands."""
        hold, arms = self.chain.hold, self.chain.arms[1 : self.chain.holding]
        moves = zip(arms, self._moves(x), strict=True)
        moved = {arm.name: hold.X_EO[arm.name] * X for arm, X in moves}
        return ClosedChain(replace(hold, X_EO={**hold.X_EO, **moved}))

    def _moves(self, x: Array) -> list[pin.SE3]:
        """Shift and turn in each hand but the first, both in the object's axes."""
        poses = x[: 6 * self._loops].reshape(-1, 6)
        return [pin.SE3(pin.exp3(xi[3:]), xi[:3]) for xi in poses]

    def errors(self, q: Array, x: Array) -> Array:
        """What each loop is open by in each tick, shape (T, L, 2, 3) [m; rad]."""
        return self._linearised(q, x, slopes=False)[0]

    def solve(self, q: Array) -> _Solution:
        """The parameters that leave least, and what is known of them."""
        x, sigma = np.zeros(len(self.names)), FIRST
        solution = _Solution(x, x, np.zeros((len(x), 0)))
        for _ in range(STEPS):
            e, J = self._linearised(q, solution.x, slopes=True)
            solution = _step(e, J, sigma, solution.x)
            left = e + np.einsum("tlkip,p->tlki", J, solution.x - x)
            sigma = np.maximum(np.sqrt(np.mean(left**2, axis=(0, 1, 3))), LEAST)
            x = solution.x
        return solution

    def offsets(self, solution: _Solution) -> tuple[Offset, ...]:
        """The parameters by name."""
        share = np.linalg.norm(solution.hidden, axis=1)
        deviations = np.where(share > SHARE, np.inf, solution.deviations)
        of = zip(self.names, self.units, solution.x.tolist(), deviations.tolist(), strict=True)
        return tuple(Offset(*each) for each in of)

    def _linearised(self, q: Array, x: Array, *, slopes: bool) -> tuple[Array, Array]:
        """Errors and their derivatives, shapes (T, L, 2, 3) and (T, L, 2, 3, P)."""
        model, data, loops = self.chain.model, self._data, self._loops
        offsets = self.encoder_offsets(x)
        moved = self._moves(x)
        e = np.zeros((len(q), loops, 2, 3))
        J = np.zeros((len(q) if slopes else 0, loops, 2, 3, len(x)))
        frames, levers = self.chain.frames[: loops + 1], np.zeros((loops, 3, 3))
        for k, row in enumerate(q):
            pin.framesForwardKinematics(model, data, row - offsets)
            X_0, *others = (data.oMf[frame] for frame in frames)
            for i, X in enumerate(others):
                X_i = X * moved[i]
                e[k, i] = X_i.translation - X_0.translation, pin.log3(X_i.rotation @ X_0.rotation.T)
                if slopes:
                    # Of the first order; the turn's own offset turns what comes after it.
                    J[k, i, 0, :, 6 * i : 6 * i + 3] = X.rotation
                    J[k, i, 1, :, 6 * i + 3 : 6 * i + 6] = X_i.rotation
                    levers[i] = pin.skew(X_i.translation - X.translation)
            if slopes and len(self._motors):
                pin.computeJointJacobians(model, data, row - offsets)
                J_0, *J_arms = (pin.getFrameJacobian(model, data, f, WORLD) for f in frames)
                of_q = (J_0 - np.array(J_arms))[:, :, self._motors].reshape(loops, 2, 3, -1)
                for i, J_i in enumerate(J_arms):  # of the object where it has been moved to
                    of_q[i, 0] += levers[i] @ J_i[3:, self._motors]
                J[k, ..., 6 * loops :] = of_q
        return e, J


def _step(e: Array, J: Array, sigma: Array, x: Array) -> _Solution:
    """One step along what the motion shows; rows are counted in standard deviations."""
    weight = 1.0 / sigma[:, None]
    rows = (weight[..., None] * J).reshape(-1, len(x)) * SIZE
    U, values, Vt = np.linalg.svd(rows, full_matrices=False)
    shown = values > max(RANK_TOLERANCE * values[0], 1.0)
    along = Vt[shown].T / values[shown]
    wanted = rows @ (x / SIZE) - (weight * e).reshape(-1)
    freedom = len(rows) - len(x)
    deviations = SIZE * np.linalg.norm(along, axis=1) if freedom else np.full(len(x), np.nan)
    return _Solution(SIZE * along @ (U[:, shown].T @ wanted), deviations, Vt[~shown].T)


def _near_and_far(q: Array) -> tuple[Array, Array]:
    """The ticks less than half as far from the first as the farthest one is, and the others."""
    way = np.linalg.norm(q - q[0], axis=1)
    near = int(np.sum(way < 0.5 * way.max()))
    cut = max(FEWEST, min(near, len(q) - FEWEST))
    order = np.argsort(way)
    return q[order[:cut]], q[order[cut:]]


def _size(errors: Array) -> Array:
    """Root of the mean square of the loop that is open farthest, shape (2,) [m, rad]."""
    largest = np.linalg.norm(errors, axis=3).max(axis=1)
    return np.asarray(np.sqrt(np.mean(largest**2, axis=0)), float)


def _noise(errors: Array) -> Array:
    """The same of noise, which alone differs from the mean of the ticks before and after."""
    bend = errors[2:] - 2.0 * errors[1:-1] + errors[:-2]
    return _size(bend) / np.sqrt(6.0) if len(bend) else np.zeros(2)


def not_shown(offsets: Sequence[Offset]) -> tuple[str, ...]:
    """Names of the offsets that the motion does not show."""
    return tuple(offset.name for offset in offsets if np.isinf(offset.deviation))
