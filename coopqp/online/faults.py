"""Faults of a robot that show while its loop runs: their names, and what is done about each.

Joints are judged by :mod:`coopqp.online.following`. Force sensors are judged by one another, by the
object's weight, and by how far the hands were told to close: forces f_i of all hands and the weight
m g add up to m times the object's acceleration.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from coopqp.base.errors import InvalidValueError, unknown_name
from coopqp.base.spec import Array
from coopqp.closed_loop.hands import WrenchReadings, friction_needed, hands
from coopqp.controller import Law
from coopqp.model.loop_observer import AFTER, FEELS
from coopqp.model.state import State
from coopqp.online.following import JointFollowing, Suspect

Reaction = Literal["go_on", "slow_down", "rest"]
Finding = tuple[str, tuple[str, ...], str]
"""Kind of a fault, where it is, and a note."""

#: What is said of joints that do not follow.
JOINTS = {
    "joint_reversed": "{} moves against its commands: has its encoder or motor the wrong sign?",
    "joint_stands_still": "{} stands still against its commands: is its encoder or motor dead?",
    "joint_not_following": "{} does not follow its commands: is it blocked, or its motor off or "
    "too weak?",
    "joints_swapped": "{} move as the other is commanded to: are they swapped?",
    "readings_stuck": "no reading of {} changes, though they shall move: is the driver stuck?",
    "encoder_jumped": "the reading of {} has jumped: has its encoder slipped?",
    "velocities_wrong": "{} does not move at its measured velocity: is its sign or unit wrong?",
}
#: What is done about each kind of fault.
REACTIONS: Mapping[str, Reaction] = {
    **dict.fromkeys(JOINTS, "rest"),
    "loop_offset_at_bound": "go_on",
    "force_sensor_dead": "rest",
    "force_sensor_stuck": "rest",
    "force_sensor_reversed": "rest",
    "force_sensor_scaled": "rest",
    "forces_unbalanced": "slow_down",
    "load_heavier": "go_on",
    "slip_near": "slow_down",
}


class Fault(NamedTuple):
    """A fault that was found: one of :data:`REACTIONS`, in joints or arms, at t [s]."""

    kind: str
    where: tuple[str, ...]
    t: float
    note: str


def checked_reactions(chosen: Any) -> dict[str, Reaction]:
    """The reactions with the user's; InvalidValueError where a kind or a reaction is none."""
    chosen = {} if chosen is None else chosen
    if not isinstance(chosen, Mapping):
        raise InvalidValueError(f"reactions: found {chosen!r}; needs a reaction for each kind")
    for kind, reaction in chosen.items():
        if kind not in REACTIONS:
            raise InvalidValueError(f"reactions: {unknown_name('fault', str(kind), REACTIONS)}")
        if reaction not in get_args(Reaction):
            known = unknown_name("reaction", str(reaction), get_args(Reaction))
            raise InvalidValueError(f"reactions.{kind}: {known}")
    return {**REACTIONS, **chosen}


class FaultMonitor:
    """The faults of one phase; joints are judged where commands differ from what is ``observed``.

    Those of the phase ``before`` are kept.

    Attributes:
        faults: those since :meth:`forget`, oldest first.
        failing: for how many ticks now a joint does not follow, or is doubted to.
    """

    def __init__(self, law: Law, before: FaultMonitor | None = None, *, observed: bool) -> None:
        chain, dt = law.problem.chain, law.problem.dt
        self._names, self._law, self._dt, self._at_bound = chain.joint_names, law, dt, 0.0
        self._joints = JointFollowing(chain, dt, law.observer) if observed else None
        self._forces = ForceMonitor(law)
        self.faults: tuple[Fault, ...] = before.faults if before else ()
        self._misled: bool = before._misled if before else False
        self.failing: int = before.failing if before else 0
        law.observer.paused = self._misled

    def forget(self) -> None:
        self.faults = ()
        self._forces.forget()
        self._misled = self._law.observer.paused = False
        if self._joints:
            self._joints.forget()

    def update(self, state: State, q_m: Array | None, misread: tuple[int, ...]) -> Fault | None:
        """The fault that is new in this tick, if any; q_m are measured joints, None without.

        Joints that are ``misread`` do not move at their measured velocities.
        """
        silent = state.hand_wrench is None or state.chain.standing
        findings = [None if silent else self._forces.update(state), self._observed(state)]
        for j in misread:
            findings.append(self._named(Suspect("velocities_wrong", (j,), 0.0)))
        if self._joints and q_m is not None and not self._misled:
            if suspect := self._joints.update(state, state.q, q_m):
                findings.append(self._named(suspect))
                self._misled = True
            # What a wrong encoder says is no error of the model: the loop must not follow it.
            self._law.observer.paused = self._joints.doubtful or self._misled
        self.failing = self.failing + 1 if self._misled or self.doubt else 0
        for kind, where, note in filter(None, findings):
            if not any((kind, where) == fault[:2] for fault in self.faults):
                fault = Fault(kind, where, state.t, note)
                self.faults = (*self.faults, fault)
                return fault
        return None

    @property
    def doubt(self) -> Finding | None:
        """What one look has found at joints, until the next one confirms it or not."""
        suspect = self._joints.suspect if self._joints and not self._misled else None
        return self._named(suspect) if suspect else None

    def _observed(self, state: State) -> Finding | None:
        observer, forces = self._law.observer, self._forces
        self._at_bound = self._at_bound + self._dt if observer.at_bound else 0.0
        if self._at_bound > LASTING:
            return "loop_offset_at_bound", observer.at_bound, observer.note
        load, weight = observer.load, forces.weight  # NaN while it is not known
        if observer.feels_in_motion and state.observer_state[1] < AFTER + 3.0 * FEELS:
            return None  # in motion air and friction pull, too
        if load > weight + SMALL and load > weight + max(OF_WEIGHT * weight, observer.doubt):
            return forces.heavier(load, "the servos sag as under {} or more; weigh the object")
        return None

    def _named(self, suspect: Suspect) -> Finding:
        names = tuple(self._names[j] for j in suspect.joints)
        both = suspect.kind in ("joints_swapped", "readings_stuck")
        who = (" and " if both else " or ").join(names)
        return suspect.kind, names, JOINTS[suspect.kind].format(who)


#: Time for which a force must look wrong [s]; that of its low pass [s].
LASTING, SMOOTH = 0.1, 0.05
#: Forces below which nothing is said [N], as a share of the weight, and of the hands' forces; least
#: step of a sensor that is coarse [N].
SMALL, OF_WEIGHT, OF_FORCES, COARSE = 3.0, 0.3, 0.1, 0.05
#: How far hands are told to close while a dead sensor says nothing [m]. Share of an imbalance that
#: a wrong sensor, or a heavier load, may leave; of the friction that slip is near at.
CLOSED_IN, UNEXPLAINED, NEAR_SLIP = 1e-3, 0.3, 0.95
#: Share by which a borne share is constant, or a unit's; change of height that no table bears [m].
OF_SHARE, LIFTED = 0.1, 0.02
#: Units that sensors are made with, in newtons by the one.
UNITS = {"kilograms-force": 9.80665, "pounds-force": 4.44822}


class ForceMonitor:
    """Judges readings of force sensors; ``weight`` is the object's as the scenario says [N]."""

    def __init__(self, law: Law) -> None:
        chain, self._control = law.problem.chain, law.force_control
        self._hands, self._readings = hands(chain), WrenchReadings(chain)
        self._arms = tuple(hand.arm for hand in self._hands)
        self._dt, self._mass, up = law.problem.dt, chain.held.mass, -chain.model.gravity.linear
        self._g = max(float(np.linalg.norm(up)), 1e-9)  # or in space
        self._up, self.weight = up / self._g, self._mass * self._g
        self._share = min(1.0, self._dt / SMOOTH)
        self.forget()

    def forget(self) -> None:
        N = len(self._hands)
        self._before, self._smooth = np.zeros((N, 6)), np.full((N, 3), np.nan)
        self._zero, self._same, self._changed = np.zeros((3, N))
        self._ways, self._stood, self._began = np.zeros(N), np.zeros((N, N, 3)), 0.0
        self._wrong, self._finest = np.zeros(4), np.full(N, np.inf)
        self._borne = math.inf, 0.0  # share of the weight, and height [m]
        self._first = 0.0, 0.0  # way and squeeze as they began to be contrary [m, N]

    def update(self, state: State) -> Finding | None:
        """Kind, hands and note of what is wrong with a state's wrenches, if anything is."""
        w = self._readings.read(state.hand_wrench)
        if w is None:
            return None
        if np.isnan(self._smooth[0, 0]):
            self._smooth[:], self._before[:] = w[:, :3], w
            self._ways[:] = self._began = self._closed_in(state)
        steps = np.abs(w - self._before)
        step, forces = steps.max(axis=1), np.where(steps > 0.0, steps, np.inf)[:, :3]
        self._finest = np.minimum(self._finest, forces.min(axis=1))
        self._before[:] = w
        self._smooth += self._share * (w[:, :3] - self._smooth)
        return (
            self._silent(w, step, state)
            or self._unbalanced(state)
            or self._contrary(state)
            or self._near_slip(w, state)
        )

    def heavier(self, weight: float, template: str) -> Finding:
        """What is said of an object of another weight [N]; the template has a gap for its mass."""
        found = template.format(f"{weight / self._g:.3g} kg")
        return "load_heavier", (), f"{found}: object.mass says {self._mass:g} kg"

    def _contrary(self, state: State) -> Finding | None:
        """Hands that close and say that they pull, or part and say that they press."""
        if not self._control:
            return None
        squeeze = 0.5 * float(self._control.along[:3].dot(self._smooth[0] - self._smooth[1]))
        way = self._closed_in(state) - self._began
        contrary = abs(way) > CLOSED_IN and abs(squeeze) > SMALL and way * squeeze < 0.0
        # By sound sensors the force becomes what is wanted, whatever way that takes.
        contrary &= abs(self._control.wanted - squeeze) > SMALL
        lasts = self._lasts(2, contrary)
        self._first = (way, squeeze) if lasts <= self._dt else self._first
        # Sound hands that still pull, pull less as they close.
        if lasts < LASTING or (way - self._first[0]) * (squeeze - self._first[1]) > 0.0:
            return None
        close, pull = ("close", "pull") if way > 0.0 else ("part", "press")
        words = (
            f"the hands are told to {close}, and {pull} by what their forces say: are the sensors "
            "of the arms swapped, or of the wrong sign?"
        )
        return "force_sensor_reversed", self._arms, words

    def _lasts(self, which: int, wrong: bool) -> float:
        """For how long now a look has found something wrong [s]."""
        self._wrong[which] = self._wrong[which] + self._dt if wrong else 0.0
        return float(self._wrong[which])

    def _closed_in(self, state: State) -> float:
        """How far the hands are told to be closer than the model says [m]."""
        return -float(self._control.along.dot(state.loop_offset)) if self._control else 0.0

    def _silent(self, w: Array, step: Array, state: State) -> Finding | None:
        """A sensor that says zero, or always the same, where it cannot be so."""
        self._zero = np.where(w.any(axis=1), 0.0, self._zero + self._dt)
        same = step == 0.0
        self._same = np.where(same, self._same + self._dt, 0.0)
        self._changed = np.where(same, self._changed + step.sum() - step, 0.0)
        # A coarse sensor stands where others step to and fro: only changes since then count.
        way, coarse = self._closed_in(state), self._finest > COARSE
        self._stood[~same], self._ways[~same] = self._smooth, way
        changes = np.linalg.norm(self._smooth - self._stood, axis=2)
        changed = np.where(coarse, changes.max(axis=1) - np.diag(changes), self._changed)
        press = np.abs(way - np.where(coarse, self._ways, self._began)) > CLOSED_IN
        forces = np.linalg.norm(self._smooth, axis=1)
        for i, hand in enumerate(self._hands):
            sensor = f"the force sensor of {hand.arm}"
            carried = np.delete(forces, i).max(initial=0.0) > SMALL
            if self._zero[i] > LASTING and (carried or press[i]):
                words = f"{sensor} says zero while the hands press: is it dead?"
                return "force_sensor_dead", (hand.arm,), words
            stuck = self._same[i] > LASTING and self._zero[i] == 0.0
            if stuck and (changed[i] > SMALL or press[i]):
                words = f"{sensor} does not change while others do: is it stuck?"
                return "force_sensor_stuck", (hand.arm,), words
        return None

    def _unbalanced(self, state: State) -> Finding | None:
        """Forces and weight that do not add up: a wrong sign or unit, or another load."""
        f, up, heavy = self._smooth, self._up, self.weight
        off = f.sum(axis=0) - heavy * up
        size, above = float(np.linalg.norm(off)), float(off.dot(up))
        sideways = float(np.linalg.norm(off - above * up)) / max(size, SMALL)
        allowed = max(SMALL, OF_WEIGHT * heavy, OF_FORCES * float(np.abs(f).sum()))
        # By a table, or somebody, but not more than the weight.
        borne = -(1.0 + OF_WEIGHT) * heavy < above < 0.0 and sideways < UNEXPLAINED
        lasts = self._lasts(0, size > allowed and not borne)
        if size > allowed and borne and (scaled := self._scaled(1.0 + above / heavy, state)):
            return scaled
        if lasts < LASTING:
            return None
        if sideways < UNEXPLAINED and above > 0.0:
            return self.heavier(heavy + above, "the hands bear {}; write that as object.mass")
        for i, hand in enumerate(self._hands):
            if np.linalg.norm(off - 2.0 * f[i]) < UNEXPLAINED * size:
                sensor = f"the force sensor of {hand.arm}"
                words = f"{sensor} has the wrong sign, by the sum of all forces"
                return "force_sensor_reversed", (hand.arm,), words
        if np.linalg.norm(off - 2.0 * f.sum(axis=0)) < UNEXPLAINED * size:
            words = "all forces have the wrong sign: needed are those of the hands on the object"
            return "force_sensor_reversed", self._arms, words
        words = f"forces and weight do not add up, by {size:.3g} N: is a sensor wrong, or a push?"
        return "forces_unbalanced", (), words

    def _scaled(self, share: float, state: State) -> Finding | None:
        """Hands that bear a constant share of the weight up or down, which no table does.

        Where they are told to press, a share that is a unit's is enough: each second counts.
        """
        height = float(state.p_WO.dot(self._up))
        self._wrong[3] += self._dt
        if abs(share - self._borne[0]) > OF_SHARE * abs(share):
            self._borne, self._wrong[3] = (share, height), 0.0
        unit = next((u for u, N in UNITS.items() if abs(share * N - 1.0) < OF_SHARE), "")
        press = bool(unit) and abs(self._closed_in(state) - self._began) > CLOSED_IN
        press &= self._wrong[3] > LASTING
        if not press and abs(height - self._borne[1]) < LIFTED:
            return None
        cause = f"are forces in {unit}?" if unit else "is their scale wrong, or object.mass?"
        words = f"the hands bear {share:.2g} of the object's weight by their sensors: {cause}"
        return "force_sensor_scaled", self._arms, words

    def _near_slip(self, w: Array, state: State) -> Finding | None:
        for arm, contact, need in friction_needed(self._hands, w, state.R_WO):
            if need > NEAR_SLIP * contact.friction:
                words = f"{arm} is about to slip: it needs {need:.2g} of {contact.friction:g}"
                lasts = self._lasts(1, True) > LASTING
                return ("slip_near", (arm,), f"{words} friction") if lasts else None
        self._lasts(1, False)
        return None
