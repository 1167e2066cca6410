"""The model's own loop error (bias), observed slowly and never corrected.

Lengths, encoders and grasps are a little off. So where the real loops are closed the model's are
open by some b, a loop-closure offset that changes slowly. With e_c = e(q) at the commanded
configuration, e_m at the measured one, and compliance between them, the internal force is
proportional to e_c - e_m: it vanishes where the *command* carries the model's error. Hence

    J_c v = -kappa (e_c - o),     o' = (e(q_m - u) - e_c) / time

Correcting e_m, or all of e_c, to zero would integrate b without end, until the motors saturate. The
observer is stable for every delay while the compliance of the grasp is part of the whole (small
gain); ``time`` exceeds the 0.1 s of the resonances of servos and grasps, and no more, since the
internal force of a motion grows with it.

u is the servos' sag under the object's weight. Springs of stiffness K hold the joints, and the
hands' forces h_i on the object carry its weight,

    u = -K^-1 sum_i J_i' h_i,     d = J_c u

with the h_i as grips alike share them, forces at the hands' points and as little torque as can be:
h = W G' (G W G')^-1 w, W = diag(1, (0.03 m)^2). Grips that yield transmit no more. It opens the
loop by d without any squeeze: an observer of e_m alone would rest only where the hands pull by d
over the servos' compliance, and never on grips that creep. What d changes by as the arms move is
known, and so taken off o at once, o' = ... - d'; the rest would lag behind by ``time``. The
load is the object's weight, less what is fed forward, where the stiffness is known, else nothing,
until it is felt: at rest, by least squares of q_m - q_c. Servos that act by the arms' inertia tell
of it while they move, too, with lags T and frequencies omega that are alike in all joints, by

    q_m - q_c = -T v - a / omega^2 + u + K^-1 J_c' lambda

from three samples, weighted with K; so a load that nobody has told of is known soon after lift-off.
Noise of 0.5 mrad or a delay of 0.1 s would make that run away: only simulators have such servos.

Where a joint may stay behind its servo's command by a dead band, so much of q_m - q_c is none.

What is wrong with u then winds up a grip that creeps: it gives way as fast as the offset moves,
and what is left of e(q_m - u) - e_c stays. So a loop's offset stays, too, where a second at rest
has left what there was, and another one, until the object moves or something has happened to the
hands; its position and its rotation each for itself, since one may be at its bound meanwhile.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.base.errors import require_known
from coopqp.base.spec import Array, NonNegative, Positive, spec
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State

#: Time constant, at least so long and at least so many ticks [s].
TIME, TICKS = 0.15, 10
#: So much faster where the object rests on servos of known stiffness: what is left then is of grips
#: that yield more than the servos do.
SOONER = 1.5
#: So much faster at rest where something happens to the hands: the product of what two ticks leave
#: is above HAPPENED squared, and so many times the variance between ticks.
SOONEST, LOUDER = 3.0, 5.0
#: Hands that begin farther apart than this do not hold the object as written [m], [rad].
MOST_POSITION, MOST_ORIENTATION = 30e-3, 100e-3
#: Most rotation for each metre of ``Observer.most`` [rad/m].
ROTATION = 10.0
#: The sag is computed anew after so long [s]; readings are trusted to so much [rad].
RENEWED, DOUBT = 0.05, 5e-4
#: After so long at rest the load is felt, with this time constant [s].
AFTER, FEELS = 0.2, 0.3
#: In motion with this one [s], where it differs by more than this share of the object's weight, as
#: air, friction and acceleration make it; a servo's lag [s], and 1/omega^2 [s^2]; by how much more
#: one lags than others [s].
FEELS_MOVING, OF_WEIGHT, LATE, LAG_DOUBT = 0.05, 0.3, (0.1, 3e-3), 2e-3
#: Smaller sags of unknown servos may as well be errors of their feed-forward [rad].
SLIGHT = 2e-4
#: Share of what is left of a loop's error by which it must change in a span at rest [s], else its
#: offset stays after so many of them; what it must change by for the offset to move again [m], a
#: rotation counts as below.
STALLED, SPAN, SPANS, HAPPENED = 0.03, 1.0, 2, 5e-4
#: Size of a grip: its rotational stiffness over the other is (this)^2 [m].
GRIP_SIZE = 0.03
#: An object that is commanded to move faster does not rest: the servos' lag would count as a sag
#: [m/s]; a rotation counts by 0.1 m. Joints may move meanwhile, in the null space or as the offset
#: has them move: hands that do not move, or move apart, tell of no load; but not faster [rad/s].
MOVES, REST, TURN_COUNTS = 0.5, 0.005, 0.1
SPEEDS = np.repeat([1.0, TURN_COUNTS], 3)
#: A load that is felt makes no joint sag by more [rad], unless of the sags so much has its shape,
#: by squares; else a wall or a hand may hold the arms up.
FARTHEST, SHAPED = 0.02, 0.9
#: Sags below this are rounding.
TINY = 1e-15


@spec
class Observer:
    """How the model's error is observed, where joints are measured."""

    enabled: bool = True
    """Whether it is observed at all; else it stays as it is when the hands take hold."""
    stiffness: Positive | Mapping[str, Positive] | None = None
    """Of the joint servos that the object's weight makes sag, one for all or by joint, others do
    not yield [N m/rad]; believed to be alike and felt at rest if omitted."""
    inertial_stiffness: Positive | None = None
    """Instead, of servos that turn an error into an acceleration, by computed torque: their
    stiffness over the arms' inertia M(q) [1/s^2]."""
    object_compensated: NonNegative = 0.0
    """Share of the object's weight in the servos' feed-forward, which makes nothing sag."""
    most: Positive = 0.01
    """How far the model's error may be from its first value [m]; in rotation 10 rad/m of that."""
    dead_band: NonNegative | Mapping[str, NonNegative] = 0.0
    """Range in which a joint may stay off its servo's command, by backlash or friction, one for all
    or by joint [rad, m]."""


class WeightSag:
    """The sag for one newton of weight.

    Attributes:
        compliance: K^-1, shape (n, n) [rad/(N m)].
        torque: of the springs, shape (n,) [N m/N]. sag: u, shape (n,) [rad/N].
        up: against gravity, (3,). at_origin: each hand's wrench for a load along x, y, z, (6 N, 3).
        opened: by which the loops open for one newton, shape (6 L,) [m/N, rad/N].
    """

    def __init__(self, chain: ClosedChain, compliance: Array) -> None:
        self.compliance, self.torque = compliance, np.zeros(chain.n)
        self.sag, self.opened = np.zeros(chain.n), np.zeros(6 * (len(chain.arms) - 1))
        self._squeeze = self._bent = np.zeros(chain.n)
        self.up = -chain.model.gravity.linear
        self.up = self.up / max(float(np.linalg.norm(self.up)), 1e-12)
        com = pin.skew(np.array(chain.held.com))
        self.at_origin = at_origin = np.zeros((6 * len(chain.arms), 3))
        if places := [X.translation for X in chain.hand_poses()]:
            at_origin[: 6 * len(places)] = _shares(places) @ np.vstack([np.eye(3), com])
        # Of J_ext = M [J_0; J_1; ...], so that sum_i J_i' h_i = J_ext' M^-T h.
        self._to_rows = np.linalg.solve(chain.mixing.T, at_origin)

    def update(self, state: State, along: Array | None = None) -> None:
        """Follow an up-to-date state, in which the hands may squeeze ``along`` a loop direction."""
        R = state.R_WO
        rows = self._to_rows.dot(self.up.dot(R)).reshape(-1, 3).dot(R.T)
        rows.ravel().dot(state.J_ext, self.torque)
        self.compliance.dot(self.torque, self.sag)
        np.negative(self.sag, self.sag)
        if along is not None:
            self._squeeze = along.dot(state.J_rel)
            self._bent = self.compliance.dot(self._squeeze)
            self._bent /= max(float(self._bent.dot(self._squeeze)), TINY)
            self.straighten(self.sag)
        state.J_rel.dot(self.sag, self.opened)

    def straighten(self, sag: Array) -> None:
        """Take out of a sag, shape (n,) [rad], what a squeeze along that direction does to it."""
        sag -= self._squeeze.dot(sag) * self._bent

    def load(self, sag: Array) -> float:
        """The load that a sag, shape (n,) [rad], tells of, by least squares [N]; NaN if of none."""
        size = -self.torque.dot(self.sag)
        if not size > TINY:
            return math.nan
        load = max(0.0, float(-self.torque.dot(sag) / size))
        other = sag - load * self.sag
        if np.abs(sag).max() > FARTHEST and other.dot(other) > (1.0 - SHAPED) * sag.dot(sag):
            return math.nan
        return load


class LoopObserver:
    """Estimates ``State.loop_offset``.

    InvalidValueError: the settings name a joint that there is not.

    Attributes:
        at_bound: arms whose loops with the first one are at their bound since the last update.
        note: what is wrong, where something is.
        paused: whether what is measured now is not to be believed, so that the loop offset stays.
        feels_in_motion: whether it follows the load in motion as well.
        dead_band: of each joint, shape (n,) [rad, m].
    """

    def __init__(self, chain: ClosedChain, dt: float, settings: Observer | None = None) -> None:
        self._chain, self._dt, self._share = chain, dt, dt / max(TIME, TICKS * dt)
        self.settings = settings or Observer()
        self._compliance = np.diag(_compliance(chain, self.settings.stiffness))
        self._inertial = self.settings.inertial_stiffness
        self._known = self.settings.stiffness is not None or self._inertial is not None
        self._follow_inertia(chain.q_start)
        self._samples = np.full((3, 2, chain.n), math.nan)  # commanded and measured, newest first
        self._sampled = -1.0
        self._bounds = self.settings.most, ROTATION * self.settings.most
        self.dead_band = by_joint(
            chain, self.settings.dead_band, np.zeros(chain.n), "observer", "dead_band"
        )
        self._band, self._yields_late = 0.5 * self.dead_band, bool(self.dead_band.any())
        self._weight = float(np.linalg.norm(chain.model.gravity.linear)) * chain.held.mass
        self._fed_forward = self.settings.object_compensated * self._weight
        self.feels_in_motion = bool(self._inertial and self._weight)
        self.at_bound: tuple[str, ...] = ()
        self.note, self.paused = "", False
        self._every = max(1, round(RENEWED / dt))
        self._estimate = np.array([math.nan, math.inf, 0.0])  # load, doubt, number of ticks
        self._span = max(1, round(SPAN / dt))
        loops = len(chain.arms) - 1
        # What is left of position and rotation of each loop, counted as speeds are: summed since a
        # span began, its mean in the one before, and the last one; for how many spans in succession
        # they have stalled, and their noise's variance; ticks since the span began.
        self._left, self._halves = np.zeros((3, 2 * loops, 3)), np.zeros((2, 2 * loops))
        self._stalled, self._noise = self._halves
        self._spent = np.zeros(1)

    @cached_property
    def _data(self) -> pin.Data:
        return self._chain.model.createData()

    @cached_property
    def _measured(self) -> State:
        """Where the sensors say that the joints are; most laws never ask."""
        return State(self._chain)

    @cached_property
    def _sag(self) -> WeightSag:
        return WeightSag(self._chain, self._compliance)

    @property
    def load(self) -> float:
        """The weight that the arms carry [N]; NaN while it is not known."""
        return float(self._estimate[0]) + self._fed_forward

    @property
    def doubt(self) -> float:
        """What readings that are half a milliradian off add to it [N]."""
        return float(self._estimate[1])

    def flat(self) -> dict[str, Any]:
        """Numbers, and arrays that the kernel writes where it does an :meth:`update` itself."""
        own = {"told": self._estimate, "dt": self._dt, "share": self._share, "every": self._every}
        own |= {"left": self._left, "stalled": self._halves}
        own |= {"spent": self._spent, "span": self._span, "band": self._band}
        own["compliance"] = self._compliance.ravel()  # a view, which follows the inertia
        return {**vars(self._sag), **own, "most": np.array(self._bounds), "known": self._known}

    def begins(self, state: State) -> bool:
        """A tick begins; whether the offset follows what is measured in it."""
        self.at_bound, self.note = (), ""
        learns = not (self.paused or state.corrected < 1.0 or not self.settings.enabled)
        if not learns:
            self._samples[:] = math.nan
        elif self._inertial and (k := self._estimate[2]) % self._every == 0 and k != self._sampled:
            self._sampled = k
            self._follow_inertia(state.q)
            if self.feels_in_motion:
                self._feel_in_motion(state)
        return learns

    @property
    def stated_stiffness(self) -> Array | None:
        """Of the servos, shape (n,) [N m/rad]; infinite where none is stated, None without any."""
        with np.errstate(divide="ignore"):
            return 1.0 / np.diag(self._compliance) if self._known else None

    def sag(self, state: State) -> Array:
        """What the object's load would make each joint sag by, fed forward or not, (n,) [rad]."""
        if not self.settings.enabled:
            self._sag.update(state)
        load = float(state.observer_state[0]) + self._fed_forward
        return self._sag.sag * (load if math.isfinite(load) else 0.0)

    def begin(self, state: State) -> None:
        """Take the whole loop error at q for the model's, so that arms do not press at first."""
        self._measured.q[:] = state.q  # made now, not in a tick
        state.update()
        self._first(state, state.loop_error)
        state.loop_offset[:] = state.loop_error
        state.update()

    def update(self, state: State, along: Array | None = None) -> bool:
        """Follow the measured q, but along the unit vector ``along``; False where not finite."""
        learns = self.begins(state)
        if state.q_measured is None:
            return True
        measured = self._measured
        found = state.reading
        if found is None or self._chain.unusable(found):
            return False  # a sensor that says nothing teaches nothing
        if not learns:
            return True
        measured.q[:] = found
        if math.isnan(state.observer_state[0]):
            measured.update_poses()
            self._first(state, measured.loop_error)
        began, before = self._estimate[2] == 0.0, self._sag.opened.copy()
        rests = _rests(state)
        load = self._unload(state, along, rests=rests)
        opened = load * self._sag.opened
        measured.update_poses()
        left = _without(measured.loop_error - state.loop_error, along)
        halves = (left.reshape(-1, 6) * SPEEDS).reshape(-1, 3)
        self._look_back(halves, rests=rests)
        learnt = np.repeat(self._learns(halves, state.observer_state[1]), 3) * left
        if not began:
            learnt += load * before - opened
        about = state.observer_state[2:] - opened
        learnt[len(state.closed_error) :] = 0.0  # what holds nothing has no offset
        pressed = 0.0 if along is None else along.dot(state.loop_offset) * along
        state.loop_offset -= pressed
        self._learn(state.loop_offset, _without(learnt, along), _without(about, along))
        state.loop_offset += pressed
        state.update_drift()
        return True

    def _first(self, state: State, error: Array) -> None:
        """Believe in the object's weight where the servos' stiffness says what it does."""
        state.observer_state[0] = self._weight - self._fed_forward if self._known else 0.0
        state.observer_state[1], state.observer_state[2:] = 0.0, error
        self._estimate[2], self._sampled = 0.0, -1.0
        self._samples[:] = math.nan
        self._look_back(self._left[2], rests=False)
        self._sag  # noqa: B018 - made now, not in a tick

    def _follow_inertia(self, q: Array) -> None:
        """Have the compliance of servos that act by the arms' inertia at q."""
        if self._inertial:
            M = pin.crba(self._chain.model, self._data, q)
            own = np.setdiff1d(np.arange(self._chain.n), self._chain.passive)
            M = np.triu(M) + np.triu(M, 1).T
            at = np.ix_(own, own)
            self._compliance[at] = np.linalg.inv(M[at]) / self._inertial

    def _feel_in_motion(self, state: State) -> None:
        """Follow the load by three samples of a motion, in which the servos lag behind as well."""
        samples, found = self._samples, state.reading
        samples[1:] = samples[:-1].copy()
        samples[0] = state.q, np.full(len(state.q), math.nan) if found is None else found
        if not np.isfinite(samples).all() or math.isnan(state.observer_state[0]):
            return
        h, (c, m), then = self._every * self._dt, samples.swapaxes(0, 1), self._measured
        then.q[:], then.v[:] = c[1], state.v  # as the sag is of then
        then.update()
        if _rests(then):
            return
        v, a = (m[0] - m[2]) / (2.0 * h), (m[0] - 2.0 * m[1] + m[2]) / h**2
        lag = m[1] - c[1] - state.observer_state[0] * self._sag.sag
        yields = np.diag(self._compliance) > 0.0
        root = np.linalg.cholesky(self._compliance[np.ix_(yields, yields)])
        squeezed = np.linalg.qr(root.T @ then.J_rel.T[yields])[0]
        causes = np.column_stack([v, a, self._sag.sag, lag])[yields]
        causes = np.linalg.solve(root, causes)
        causes -= squeezed @ (squeezed.T @ causes)
        doubts = np.sqrt(DOUBT**2 + (LAG_DOUBT * v) ** 2 + self._band**2)[yields]
        doubt = float(np.linalg.norm(np.linalg.solve(root, doubts))) / len(doubts) ** 0.5
        A, prior = causes[:, :3], doubt / np.array([*LATE, self._weight])
        more = float(np.linalg.solve(A.T @ A + np.diag(prior**2), A.T @ causes[:, 3])[2])
        more = max(more, -self._fed_forward - float(state.observer_state[0]))
        usual, share = OF_WEIGHT * self._weight, min(1.0, h / FEELS_MOVING)
        state.observer_state[0] += share * (more - min(max(more, -usual), usual))

    def _unload(self, state: State, along: Array | None, *, rests: bool) -> float:
        """Take sag and squeeze out of the measured joints; the load that makes them sag."""
        sag, own, q, known = self._sag, state.observer_state, self._measured.q, self._known
        if self._estimate[2] % self._every == 0:
            sag.update(state, along if known else None)
            self._estimate[1] = DOUBT / max(float(np.abs(sag.sag).max()), TINY)
        self._estimate[2] += 1
        lag, load = q - state.q, math.nan
        if self._yields_late:
            lag -= np.clip(lag, -self._band, self._band)
            np.add(state.q, lag, out=q)
        if along is not None and known:
            sag.straighten(lag)
            np.add(state.q, lag, out=q)
        if rests and (along is None or known):  # else a squeeze could not be told from a load
            load = sag.load(lag)
        own[1] = own[1] + self._dt if math.isfinite(load) else 0.0
        if own[1] > AFTER:
            own[0] += min(1.0, self._dt / FEELS) * (load - own[0])
        self._estimate[0] = own[0] if known else math.nan
        load = float(own[0])
        if not known and load * np.abs(sag.sag).max() < SLIGHT:
            load = 0.0
        q -= load * sag.sag
        return load

    def _learns(self, left: Array, rested: float) -> Array:
        """Shares of what is left of position and rotation of each loop that the offset takes."""
        last = self._left[2]
        along, apart = (left * last).sum(axis=1), ((left - last) ** 2).sum(axis=1)
        self._noise += self._share * (0.5 * apart - self._noise)
        last[:] = left
        happens = (along > np.maximum(HAPPENED**2, LOUDER * self._noise)) & (rested > AFTER)
        sooner = SOONER if self._known and rested > AFTER else 1.0
        return self._share * np.where(happens, SOONEST, sooner) * (self._stalled < SPANS)

    def _look_back(self, left: Array, *, rests: bool) -> None:
        """See what stalls, by what was left of it in this span and before."""
        total, before, _ = self._left
        if not rests:
            self._spent[0], total[:], before[:], self._stalled[:] = 0.0, 0.0, math.nan, 0.0
            return
        total += left
        self._spent[0] += 1.0
        if self._spent[0] < self._span:
            return
        mean = total / self._span
        size, change = (before**2).sum(axis=1), mean - before
        stands = (change**2).sum(axis=1) < HAPPENED**2
        stalled = np.abs((change * before).sum(axis=1)) < STALLED * size
        stalled = np.where(self._stalled < SPANS, stalled, stands)
        self._stalled[:] = np.where(stalled, self._stalled + 1.0, 0.0)
        self._spent[0], before[:], total[:] = 0.0, mean, 0.0

    def _learn(self, offset: Array, learnt: Array, about: Array) -> None:
        """Move the offset, at most as far ``about`` a value as a model's error changes."""
        offset += learnt
        away = (offset - about).tolist()
        for i in range(0, 6 * (self._chain.holding - 1), 3):
            bound, size = self._bounds[i // 3 % 2], math.hypot(*away[i : i + 3])
            if size > bound:
                part = slice(i, i + 3)
                offset[part] = about[part] + bound / size * (offset[part] - about[part])
                self._left[1, i // 3], self._stalled[i // 3] = math.nan, 0.0  # can come no nearer
                self._say(i)

    def _say(self, row: int) -> None:
        first, *others = (arm.name for arm in self._chain.arms)
        arm, turn = others[row // 6], row // 3 % 2
        self.at_bound = tuple(dict.fromkeys((*self.at_bound, arm)))
        size = f"{1e3 * self._bounds[turn]:g} {'mrad' if turn else 'mm'}"
        self.note = (
            f"the model's error between {arm} and {first} has changed by {size}, the most that "
            "observer.most lets it; has the object slipped, or is a joint's reading wrong?"
        )


def _rests(state: State) -> bool:
    if state.v.dot(state.v) > MOVES * MOVES:  # before anybody asks for Jacobians
        return False
    twist = state.J_task.dot(state.v) * SPEEDS
    return bool(twist.dot(twist) < REST * REST)


def _shares(points: list[Array]) -> Array:
    """Each hand's wrench at the object's origin for one there, shape (6 N, 6), object axes."""
    grips, one = np.diag([1.0, 1.0, 1.0, *[GRIP_SIZE**2] * 3]), np.eye(3)
    moved = [pin.SE3(one, p).toDualActionMatrix() for p in points]
    each = [G @ grips @ G.T for G in moved]
    return np.asarray(np.vstack(each) @ np.linalg.inv(sum(each)), float)


def _without(x: Array, along: Array | None) -> Array:
    return x if along is None else np.asarray(x - along.dot(x) * along, float)


def by_joint(
    chain: ClosedChain, given: float | Mapping[str, float] | None, default: Array, *place: str
) -> Array:
    """Of each joint as given, else by default, shape (n,); UnknownNameError: no such joint."""
    names = chain.joint_names
    if not isinstance(given, Mapping):
        return default.copy() if given is None else np.full(chain.n, float(given))
    require_known("joint", given, names, at=place)
    return np.array([given.get(name, K) for name, K in zip(names, default, strict=True)], float)


def _compliance(chain: ClosedChain, given: float | Mapping[str, float] | None) -> Array:
    """1/K by joint, shape (n,) [rad/(N m)]; zero where a joint does not yield or has no motor."""
    yields = given is None and np.array(chain.joint_units) == "rad"
    rigid = np.where(yields, np.ones(chain.n), np.inf)
    found = 1.0 / by_joint(chain, given, rigid, "observer", "stiffness")
    found[chain.passive] = 0.0
    return found
