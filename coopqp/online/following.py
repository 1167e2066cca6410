"""Which joint does not do what it is commanded to, told apart from arms that pull at each other.

Servos of stiffness K that hold one object let its internal wrench lambda move every joint a little,

    r = q_m - q_c(t - lag) = K^-1 J_c' lambda + e_j delta

and a faulty joint j adds a delta of its own: -2 dq_c where it moves the wrong way, -dq_c where it
does not move. What K^-1 J_c' lambda cannot explain is the parity vector of fault detection: r
projected on the complement of range(K^-1 J_c'). It vanishes for sag, squeeze and errors of the
model, however large, so that |q_m - q_c|, which they change, is never compared with a threshold. A
joint, or two that are swapped, is named where its delta explains nine tenths of the parity vector
over a window, about its mean, and white noise does not, by von Neumann's ratio. Signatures that are
parallel, as of two opposite shoulders, cannot be told apart where a motor is wrong: both are named.

Source: Chow and Willsky 1984, parity relations; von Neumann 1941; statics of a closed chain.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from coopqp.base.rank import null_space
from coopqp.base.spec import Array
from coopqp.kernel import native
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.loop_observer import LoopObserver
from coopqp.model.state import State

#: Time between samples, each the mean of its readings; after which the parity space is computed
#: anew, and before a verdict; of windows [s].
SAMPLE, RENEWED, FRESH, WINDOWS = 0.02, 0.5, 0.1, (0.2, 0.4, 2.0)
#: Samples of a window that are looked at; those before the first look; every so many the long one.
LOOKS, FEWEST, LONG = 40, 4, 4
#: The latest that a servo may follow [s]. Servos of a first order that are sound: their times [s],
#: after so many of which nothing is left, and the share of the parity vector that they may leave.
#: Share of a velocity by which all may fall short, and the gain that makes it good [1/s], at most.
LATEST, TIMES, FADED, LAGGING = 0.14, np.arange(0.02, 0.155, 0.01), 3.0, 0.15
ALIKE = (0.3, 3.0)
#: Standard deviations: of a reading at least [rad, m]; of a servo's lag [s], and of what inertia
#: adds for an acceleration, 1/frequency^2 [s^2]; of its stiffness, as a share of the sag.
NOISE, LAG_NOISE, INERTIA_NOISE, STIFFNESS_NOISE = 4e-4, 6e-3, 2e-3, 0.1
#: sigma of white noise over the median of |second differences|, which is 1.65 sigma, 1.2 of few.
OF_SECOND_DIFFERENCES = 0.73
#: Square of the parity vector's change over its variance from which a fault is looked for; mean
#: square about the mean, less the noise, from which it is one, over the variance that is not white,
#: and by how many standard deviations sqrt(1.9/(T d)) of von Neumann's ratio (variance to that of
#: second differences) for T samples of d white components: by 6 once in 1e9 looks.
SUSPICIOUS, MEAN_SQUARE, DEVIATIONS = 12.0, 3.0, 6.0
#: Share of it that a fault must explain, beside as much as sound joints leave along one direction;
#: the share that is left by others that count as equal. Two swapped joints need less where all
#: other faults leave so much more.
EXPLAINED, EXPLAINED_SWAPPED, AS_GOOD, ALONE = 0.9, 0.95, 0.03, 0.25
#: A fault that leaves more than this share, and by a standard deviation of what white noise leaves
#: more than one of other joints or a push from outside, is none, whatever that is: something else
#: has happened, as where friction makes joints late, or a person holds a hand back.
CREDIBLE = 0.05
#: delta over dq_c of a joint that does not follow, at least and, unless it stands still, at most;
#: of two swapped ones, 1 but for what else there is; above which it moves the wrong way. When in a
#: window that began; share of delta beside twice the reading's motion where its sign is wrong, and
#: commanded motion over delta at least, which without commands is that of a push.
LEAST_SLOPE, MOST_SLOPE, SWAPPED, REVERSED = 0.6, 2.5, (0.7, 1.0 / 0.7), 1.5
ONSETS, BACKWARDS, COMMANDED = np.linspace(0.0, 0.9, 10), 0.2, 0.1
#: A reading has jumped by so much at least [rad, m], most of it within two samples. One that is
#: farther from where the last two lead to has leapt, and is not believed before it is looked at:
#: six standard deviations of noise of 1 mrad, or 150 rad/s2 in a tick of 10 ms.
LEAST_JUMP, JUMP, LEAP = 8e-3, 0.8, 0.015
#: Commanded motion below which a joint says nothing, and so near to the end of its range that it
#: may press into its stop [rad, m]; share of it that a joint which stands still may measure.
LEAST_MOTION, NEAR, STANDS = 1.5e-3, 0.02, 0.1
#: Readings that do not change for so long [s] are stuck where commands move a joint by so much
#: [rad, m]; for so many samples, to see whether they are. One joint alone may stand by friction,
#: and is moved by so many times as much, unless its readings have changed in each of as many
#: samples before: no friction stops an encoder's noise.
STUCK, MOVED, AWAITED, STICKS = 0.2, 0.01, 2, 3.0
#: Singular values of K^-1 J_c' below this share of the largest are none. Least share, by squares,
#: of what shows of the clearest fault in the space that lambda leaves.
SINGULAR, LEAST_SIGNATURE = 1e-3, 1e-3
#: A second joint is named too where it leaves at most this much more of r unexplained.
AMBIGUOUS, PENALTY = 1.5, 1.5


class Suspect(NamedTuple):
    """Joints that do not follow: one, two that are swapped, or several that cannot be told apart.

    ``joints`` are indices, the likeliest first; ``slope`` is -delta over the commanded motion.
    """

    kind: str
    joints: tuple[int, ...]
    slope: float


class JointFollowing:
    """Judges commanded and measured joints, of servos as stiff as stated, else as strong.

    Attributes:
        leapt: whether a reading has leapt of late.
        doubtful: whether it has, or internal forces and lag do not explain the last samples.
        suspect: whom the last look has found, if the next one is to confirm it.
    """

    def __init__(self, chain: ClosedChain, dt: float, observer: LoopObserver) -> None:
        self._observer, stiffness = observer, observer.stated_stiffness
        self._own = own = np.setdiff1d(np.arange(chain.n), chain.passive)
        self._passive, n = chain.passive, len(own)
        self._lower, self._upper = chain.lower[own], chain.upper[own]
        K = chain.model.effortLimit[own] if stiffness is None else stiffness[own]
        usable = (K > 0.0).all() and np.isfinite(K).any()
        self._compliance = 1.0 / K if usable else np.ones(n)
        # The largest: unequal ones would blame joints without for what those that stick do to them.
        self._band = float(observer.dead_band.max())
        self._every = max(1, round(SAMPLE / dt))
        h = self._every * dt
        #: In half samples, of which odd ones lie between two samples.
        self._lags, self._h = np.arange(2 * round(LATEST / h) + 1), h
        self._spans = [max(2, round(window / h)) for window in WINDOWS]
        self._short = self._spans[:-1]
        kept = self._spans[-1] + len(self._lags) // 2 + round(FADED * TIMES[-1] / h) + 2
        self._c, self._m = np.zeros((2, kept, n))
        self._read = np.zeros((2, n))  # the last readings
        self._pairs = list(combinations(range(n), 2))
        unit = np.identity(n)
        self._faults = np.vstack([unit, *(unit[j] - unit[k] for j, k in self._pairs)])
        self._white = np.zeros((n, n))
        self._renew, self._fresh = max(1, round(RENEWED / h)), max(1, round(FRESH / h))
        self._kept = -(-self._spans[-1] // self._renew)  # Jacobians before, of the long window
        names = [chain.joint_names[j] for j in own]
        arms = (chain.robot.arm_joints(arm) for arm in chain.robot.arms)
        self._arms = [np.flatnonzero([name in arm for name in names]) for arm in arms]
        decays = np.exp(-h / TIMES)
        kernels = decays ** np.arange(round(FADED * TIMES[-1] / h) + 1)[:, None]
        self._kernels = kernels / kernels.sum(axis=0)
        self._stuck_for = round(STUCK / h) - 1  # of which the first lasts as long, too
        rings, members = (self._c, self._m), [arm.tolist() for arm in self._arms]
        made = (*rings, own.tolist(), members, self._every, self._stuck_for, self._spans, LONG)
        stands = len(self._lags) // 2, MOVED + self._band, self._band
        found = native.module()
        self._quick = found and found.Samples(*made, self._compliance.tolist(), h, *stands)
        self.forget()

    def forget(self) -> None:
        """Begin anew, as after a rest in which somebody may have moved the joints."""
        self._count = self._samples = self._lag = 0
        self._whitened, self._earlier = -self._renew, list[Array]()
        self._before: list[Suspect | None] = [None, None]  # of the last look, and the last long one
        self.suspect: Suspect | None = None
        self.leapt = self.doubtful = False
        # Sample from which on looks explain what is; reading from which on they are believed.
        self._explained = self._believed = 0
        if self._quick:
            self._quick.forget()

    def update(self, state: State, q_c: Array, q_m: Array) -> Suspect | None:
        """Who does not follow, once two looks in succession agree; c is commanded, m measured."""
        quick = self._quick
        if quick and quick.add(q_c, q_m):
            return None
        found = self._looked(state) if self._add(q_c, q_m) else None
        self.leapt = self._count < self._believed
        self.doubtful = self.leapt or self._samples < self._explained
        if quick:
            calm = not (self.doubtful or any(self._before))
            quick.trust(self._whitened + self._renew if calm else 0, self._lag, self._white)
        return found

    def _looked(self, state: State) -> Suspect | None:
        if self._samples < FEWEST:
            return None
        if self._samples - self._whitened >= self._renew:
            self._white, self._whitened = self._whitening(state), self._samples
        # What the long window has found is looked at again at once, as in the short ones.
        long = self._before[1] is not None or self._samples % LONG == 0
        spans = self._spans if long else self._short
        quick = self._quick
        stands = not quick or quick.stands()
        if quick and not (stands or self._before[1]) and quick.quiet(self._lag, self._white):
            return self._agreed(None, 0, spans)
        if stands and (stuck := self._stuck(self._stuck_for)):
            return stuck
        if self._stuck(AWAITED):
            return None
        if stands and (still := self._still()):
            return still
        return self._agreed(*self._look(state, spans), spans)

    def _agreed(self, found: Suspect | None, span: int, spans: Sequence[int]) -> Suspect | None:
        """What the last look has found, too, or that of the long window, which is a rare one."""
        long, earlier = self._spans[-1], list(self._before)
        self._before[0], self.suspect = found, None
        if long in spans:
            self._before[1] = found if span == long else None
        agree = (e and found and set(e.joints) & set(found.joints) for e in earlier)
        if any(agree):
            return found
        self.suspect = found if span != long else None
        return None

    def _add(self, q_c: Array, q_m: Array) -> bool:
        """Add to the sample that is being taken, unless C++ has; whether it is whole."""
        if self._quick:
            self._count, leapt = self._quick.readings - 1, self._quick.leapt
        at, part = divmod(self._count, self._every)
        if not self._quick:
            q = q_m[self._own]
            if not self._count:
                self._read[:] = q
            leapt = bool((np.abs(q - 2.0 * self._read[0] + self._read[1]) > LEAP).any())
            self._read[:] = np.stack([q, self._read[0]])
            for ring, q in ((self._c, q_c), (self._m, q_m)):
                sample = ring[at % len(ring)]
                sample[:] = (sample if part else 0.0) + q[self._own] / self._every
        self._count += 1
        if leapt:
            self._believed = self._count + 2 * self._every
        self._samples = self._count // self._every
        return self._samples > at

    def _stuck(self, span: int) -> Suspect | None:
        """An arm of which no reading has changed by a bit while it was commanded to move."""
        last, min_way = self._samples - 1, MOVED * span / self._stuck_for + self._band
        if last < span:
            return None
        at = np.arange(last - span, last + 1)
        for arm in (arm for arm in self._arms if len(arm) > 1):
            m, c = (np.diff(self._of(ring, at)[:, arm], axis=0) for ring in (self._m, self._c))
            if not m.any() and c.any(axis=1).all() and np.abs(c).sum(axis=0).max() > min_way:
                return Suspect("readings_stuck", tuple(int(j) for j in self._own[arm]), 0.0)
        return None

    def _still(self) -> Suspect | None:
        """A joint of which no reading has changed by a bit since commands should have moved it."""
        last, late = self._samples - 1, len(self._lags) // 2
        if last < self._stuck_for + late:
            return None
        at = np.arange(max(0, last + 1 - len(self._m)), last + 1)
        m, c = self._of(self._m, at), self._of(self._c, at)
        for j in np.flatnonzero((m[-1 - self._stuck_for :] == m[-1]).all(axis=0)):
            first = int(np.flatnonzero(np.append(True, m[:-1, j] != m[-1, j]))[-1])
            commands = c[first:, j]
            way = np.abs(commands[: max(1, len(commands) - late)] - commands[0]).max()
            lively = first >= self._stuck_for and np.diff(m[: first + 1, j]).all()
            margins = commands.min() - self._lower[j], self._upper[j] - commands.max()
            stops = min(margins) < NEAR
            if way > MOVED * (1.0 if lively else STICKS) + self._band and not stops:
                return Suspect("joint_stands_still", (int(self._own[j]),), 1.0)
        return None

    def _whitening(self, state: State) -> Array:
        """W with r W of unit variance without a fault, and zero for every internal wrench."""
        if self._samples - self._whitened >= self._renew:
            self._earlier = [*self._earlier[-self._kept :], state.J_loop.copy()]
        return self._white_over(self._spans[1], state, self._earlier[-2:][0])

    def _white_over(self, span: int, state: State, before: Array) -> Array:
        """W of so many samples, of sag and speed on their way."""
        J, load = state.J_loop, self._observer.sag(state)
        last, n = self._samples - 1, len(self._own)
        if len(self._passive):
            N = null_space(J[:, self._passive].T)
            J, before = N.T @ J, N.T @ before
        if self._quick:
            W = np.empty(n * n)
            d = self._quick.whiten(span, self._lag, J, before, load, W)
            return W[: n * d].reshape(n, d)
        J, before, load = (each[..., self._own].T for each in (J, before, load))
        A = self._compliance[:, None] * J
        U, values, _ = np.linalg.svd(A)
        rank = int(np.sum(values > SINGULAR * values.max(initial=1e-12)))
        U, parity = U[:, :rank], U[:, rank:]
        at = np.arange(max(0, last - span), last + 1)
        m, c = self._of(self._m, at), self._commanded(at, self._lag)
        r = (m - c) - (m[0] - c[0])
        sag = np.mean((r @ U @ U.T) ** 2, axis=0)
        speed = np.abs(np.diff(c, axis=0)).mean(axis=0) / self._h
        noise = max(NOISE, OF_SECOND_DIFFERENCES * float(np.median(np.abs(np.diff(m, 2, axis=0)))))
        half = (len(c) - 1) // 2
        a = np.abs(c[2 * half] - 2.0 * c[half] + c[0]) / max(half * self._h, self._h) ** 2
        variance = noise**2 + self._band**2 + (LAG_NOISE * speed) ** 2 + STIFFNESS_NOISE**2 * sag
        variance += (INERTIA_NOISE * a) ** 2
        # What pulled as now pulled otherwise before J_c turned with the joints.
        floor = (SINGULAR * values.max(initial=1e-12)) ** 2 * np.identity(A.shape[1])
        lags = (m - c)[-1:] if span <= self._spans[1] else m - c
        pull = np.linalg.solve(A.T @ A + floor, A.T @ lags.T)
        turns = self._compliance[:, None] * ((J - before) @ pull)
        variance += np.mean(turns**2, axis=1) / 3.0  # on the way
        # The object's weight is no internal wrench, changes with the pose, and may be told wrong.
        variance += load**2
        L = np.linalg.cholesky(parity.T @ (variance[:, None] * parity))
        return np.asarray(np.linalg.solve(L, parity.T).T)

    def _look(self, state: State, spans: Sequence[int]) -> tuple[Suspect | None, int]:
        """The suspect of the shortest window that has one, and that window."""
        for span in spans:
            last = self._samples - 1
            first = max(0, last - span)
            r = self._of(self._m, last) - self._of(self._m, first)
            r += self._commanded(first, self._lag) - self._commanded(last, self._lag)
            z = r.dot(self._white)
            is_long = span == self._spans[-1]
            if z.dot(z) < SUSPICIOUS and not (is_long and self._before[1]):
                continue
            if self._samples > self._whitened + self._fresh:
                self._white, self._whitened = self._whitening(state), self._samples
            # On the long one's way joints may have been faster and turned more.
            white = self._white_over(span, state, self._earlier[0]) if is_long else self._white
            if found := self._judge(state, first, last, white):
                return found, span
        return None, 0

    def _commanded(self, at: Any, lag: Any) -> Array:
        """Commands some half samples before."""
        c = self._c
        return 0.5 * (self._of(c, at - lag // 2) + self._of(c, at - (lag + 1) // 2))

    def _of(self, ring: Array, at: Any) -> Array:
        """Samples of a ring by their numbers; the first one before the beginning."""
        oldest = max(0, self._samples - len(ring))
        at = max(at, oldest) if isinstance(at, int) else np.maximum(at, oldest)
        return np.asarray(ring[at % len(ring)])

    def _judge(self, state: State, first: int, last: int, white: Array) -> Suspect | None:
        step = max(1, (last - first) // LOOKS)
        at = np.arange(last, first + step - 2, -step)[::-1] - np.arange(step)[:, None]
        m = self._of(self._m, at).mean(axis=0)
        m = m - m.mean(axis=0)
        c = self._commanded(at[:, None, :], self._lags[:, None]).mean(axis=0)
        c = c - c.mean(axis=1, keepdims=True)  # (lags, T, n)
        z = (m - c) @ white
        sizes = np.einsum("ltd,ltd->l", z, z)
        self._lag = int(sizes.argmin())
        (T, d), self._noise = z.shape[1:], float(_white(z[self._lag]).sum())
        noise = DEVIATIONS * self._noise * (1.9 / (T * d)) ** 0.5
        self._usual = T - step * self._noise / d
        self._enough = max(MEAN_SQUARE * self._usual, noise)
        if sizes[self._lag] - self._noise < self._enough:
            return None
        # A window that nothing explains is in doubt until it is looked at again.
        lasts = LONG if last - first > self._short[-1] else 1
        self._explained = max(self._explained, self._samples + lasts)
        return self._best(state, m, np.concatenate([c, self._slow(at)]), at, white)

    def _slow(self, at: Any) -> Array:
        """Commands as servos of a first order follow them, late as well, shape (servos, T, n)."""
        before = np.arange(len(self._kernels))
        late = np.array([at[..., None] - before - lag // 2 for lag in self._lags[::2]])
        c = np.tensordot(self._kernels, self._of(self._c, late).mean(axis=1), (0, 2))
        c = c.reshape(-1, at.shape[1], len(self._own))
        return np.asarray(c - c.mean(axis=1, keepdims=True))

    def _alike(self, r: Array, c: Array, time: float, white: Array) -> float:
        """What joints that are sound leave of the parity vector where all follow alike.

        They follow a share s of the velocities that their servos are told, of samples after each
        ``time``, and a loop of gain k takes their error to zero: r' = -(1 - s) dq_c' - s k r.
        """
        causes = np.stack([r, c, r.cumsum(axis=1) * time])
        causes = (causes - causes.mean(axis=2, keepdims=True)) @ white
        G = np.einsum("asti,bsti->sab", causes, causes)
        short, gains = (np.linspace(0.0, upper, 7) for upper in ALIKE)
        p = np.stack([np.ones((7, 7)), *np.meshgrid(short, gains)], axis=-1)
        return float(np.einsum("xya,sab,xyb->sxy", p, G, p).min())

    def _pushed(self, state: State, z: Array, white: Array) -> float:
        """What wrenches from outside leave of the parity vector z, shape (servos, T, d).

        Hands that bear h on the object as well move joints by K^-1 J' h, as internal ones do.
        """
        J = np.vstack([state.J_task, state.J_loop])
        N = null_space(J[:, self._passive].T) if len(self._passive) else np.identity(len(J))
        ways = (self._compliance[:, None] * (J.T @ N)[self._own]).T @ white
        _, values, V = np.linalg.svd(ways)
        free = V[int(np.sum(values > SINGULAR * values.max(initial=0.0))) :]
        left = float(np.min(np.sum((z @ free.T) ** 2, axis=(1, 2))))
        return left - self._noise * len(free) / len(V)

    def _best(self, state: State, m: Array, c: Array, at: Any, white: Array) -> Suspect | None:
        """The fault that leaves least beside sound servos' motions c, if it explains the rest."""
        r = m - c
        z = r @ white
        sizes = np.einsum("ltd,ltd->l", z, z)
        n, pairs, above = len(self._own), self._pairs, sizes.min() - self._noise
        commands = self._commanded(at[0], self._lag)
        signs = self._faults @ white  # (faults, d)
        lengths = np.einsum("fd,fd->f", signs, signs)
        lengths[lengths < LEAST_SIGNATURE * lengths.max()] = np.inf
        along = z @ signs.T  # (lags, T, faults)
        left = sizes[:, None] - np.einsum("ltf,ltf->lf", along, along) / lengths
        lags, left, faults = left.argmin(axis=0), left.min(axis=0), np.arange(len(signs))
        delta = along[lags, :, faults].T / lengths  # (T, faults)
        motion = np.einsum("ftn,fn->tf", c[lags], self._faults)
        slope = _slopes(delta, motion)
        moves = np.ptp(motion, axis=0) > LEAST_MOTION
        steps, ranges = np.abs(delta[2:] - delta[:-2]).max(axis=0), np.ptp(delta, axis=0)
        jumped = (steps > JUMP * ranges) & (ranges > LEAST_JUMP)
        noise = self._noise * (1.0 - 1.0 / white.shape[1])
        share = np.maximum(left - noise, 0.0) / above
        explained = 1.0 - np.maximum(left - noise - self._usual, 0.0) / above
        read = m @ self._faults.T
        unlike, size = (np.sum(x**2, axis=0) - _white(x) for x in (delta - 2.0 * read, delta))
        backwards = (unlike < BACKWARDS * size) & (np.ptp(motion, axis=0) > COMMANDED * ranges)
        still = np.ptp(read, axis=0) < STANDS * np.maximum(np.ptp(motion, axis=0), ranges)
        off = moves & (slope > LEAST_SLOPE) & (still | (slope < MOST_SLOPE)) | jumped | backwards
        exchanged = moves & (slope > SWAPPED[0]) & (slope < SWAPPED[1])
        two = exchanged & (explained > EXPLAINED_SWAPPED)
        good = np.where(faults < n, off & (explained > EXPLAINED), two)
        first, second = np.argsort(left)[:2]
        if first >= n and share[first] < ALONE * min(1.0, share[second]):
            good[first] = exchanged[first]
        alike = self._alike(r, c, self._h * len(at), white) - self._noise
        stops = np.minimum(commands - self._lower, self._upper - commands).min(axis=0) < NEAR
        stopped = (share[:n][stops] < 1.0 - EXPLAINED).any()
        if stopped or not good.any() or alike < max(LAGGING * above, self._enough):
            return None
        good &= share <= max(3.0 * share[good].min(), AS_GOOD)
        rest = np.full(len(faults), np.inf)
        for f in np.flatnonzero(good):
            left_r = r[lags[f]] - np.outer(delta[:, f], self._faults[f])
            rest[f] = np.sum(left_r**2) * (1.0 if f < n else PENALTY)
        best = int(rest.argmin())
        others = share[~(self._faults[:, self._faults[best] != 0.0] != 0.0).any(axis=1)]
        pushed = self._pushed(state, z, white) / above
        chance = (1.9 * noise * self._noise / z[0].size) ** 0.5 / above
        if share[best] > max(min(pushed, *others) + chance, CREDIBLE):
            return None
        if best >= n:
            j, k = (int(self._own[i]) for i in pairs[best - n])
            return Suspect("joints_swapped", (j, k), float(slope[best]))
        back = backwards[best] or slope[best] > REVERSED
        kind = "joint_reversed" if back else "joint_not_following"
        kind = "encoder_jumped" if jumped[best] else "joint_stands_still" if still[best] else kind
        others = [f for f in range(n) if f != best and rest[f] < AMBIGUOUS * rest[best]]
        joints = tuple(int(self._own[f]) for f in (best, *others))
        return Suspect(kind, joints, float(slope[best]))


def _white(x: Array) -> Array:
    """Sum of squares of what is white noise in x (T, ...), by von Neumann's second differences."""
    T = len(x)
    return np.asarray(np.sum(np.diff(x, 2, axis=0) ** 2, axis=0)) * (T - 1) / (6.0 * (T - 2))


def _slopes(delta: Array, motion: Array) -> Array:
    """-delta over motion (T, faults) since the onset that explains most of delta, (faults,)."""
    slopes, best = np.zeros((2, delta.shape[1]))
    for onset in (int(share * len(delta)) for share in ONSETS):
        since = np.maximum(np.arange(len(delta)) - onset, 0)
        moved = motion[onset + since] - motion[onset]
        moved -= moved.mean(axis=0)
        squares = np.maximum((moved**2).sum(axis=0), 1e-12)
        along = (delta * moved).sum(axis=0)
        better = along**2 > best * squares
        slopes[better], best[better] = (-along / squares)[better], (along**2 / squares)[better]
    return slopes
