r"""Is there a closed configuration inside all position limits at which the tasks are met.

Random configurations are brought to the manifold of closed loops and met tasks by Newton steps; the
free ones are kept. Where there are none, the searches of ``explain`` say what stands in the way.
Nothing is called unreachable but what a bound proves so: a point of the object is never farther
from an arm's base than the lengths between its joints, up to the point, together.

Configurations are grouped by which way each arm bends: the sign of the rate at which its bend, the
joint that most changes the distance of hand and base, lengthens the arm.

Between some closed configurations no motion keeps the loops closed. A rotation by w has two lifts
to SU(2), +-U with :math:`U = \cos(|w|/2) I - i \sin(|w|/2) w\cdot \sigma / |w|`, and the product of
such U of an arm's joints, at half their angles, is a continuous function of q. Where a loop is
closed, the lifts of the object's attitude by arm i and by arm 0 are equal or opposite. Closed all
the way, they stay what they are: a hand that has turned once round against another is on another
part of the closed configurations (the plate trick; SO(3) is not simply connected). Of this half
angles see odd numbers of turns; of two arms whose bodies keep apart :mod:`coopqp.planning.linking`
sees all.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp.base.errors import InvalidValueError, under
from coopqp.base.spec import Array, seeded
from coopqp.base.wording import counted
from coopqp.closed_loop.forces import Bound, StaticHold
from coopqp.closed_loop.hands import hands
from coopqp.controller import ControlProblem
from coopqp.grasp import SAFETY
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.planning.closed_space import ClosedSpace
from coopqp.program import Kind
from coopqp.robot import axis_of
from coopqp.scenario.scenario import Scenario, needs_scenario
from coopqp.study.explanation import words
from coopqp.study.explanation.diagnosis import BlockedByLimits, NotBlocked, diagnose
from coopqp.study.explanation.goal import Goal, Search, placed
from coopqp.task import Programs

#: Random starts of one look, and of all looks.
BATCH, MAX_TRIES = 64, 4096
#: Free configurations after which the search ends, once so many starts were tried.
ENOUGH, MIN_TRIES = 64, 512
#: The sum of lengths proves only what is farther off than rounding [m].
ROUNDING = 1e-6

PROVEN = "proven unreachable"
#: Why no motion leads from one part to another, for sentences.
CUT_OFF = (
    "from the start's joint angles to such ones a hand turns once round against another, which "
    "closed loops never let it"
)
WOUND = (
    "from the start's joint angles to such ones the arms and what they hold wind round each other, "
    "so that one would have to pass through another"
)

_PAULI = np.array([[[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]]])

Progress = Callable[[float], None]
"""Called now and then with the share that is done; raises to end the search."""


@dataclass(frozen=True)
class Configuration:
    """A closed configuration that meets the tasks."""

    q: Array  #: Shape (n,) [rad, m].
    joint_margin: float  #: Least distance of a joint from its limit [rad, m]; or infinite.
    clearance: float  #: Least distance left by limits in space [m]; infinite where there are none.
    bends: str  #: Which way each arm bends, such as ``left LElbowRoll +``.
    cut_off: bool  #: Whether it is proven that no motion leads there from the start.


@dataclass(frozen=True)
class Reach:
    """Whether the tasks' goals can be met."""

    #: Configurations that meet them, of every group that with the largest margin first.
    solutions: tuple[Configuration, ...]
    proven: bool  #: Whether a bound proves that there are none.
    sentence: str  #: In words.
    tried: int = 0  #: Random starts.

    @property
    def groups(self) -> dict[str, list[Configuration]]:
        """The configurations by which way the arms bend."""
        groups: dict[str, list[Configuration]] = {}
        for configuration in self.solutions:
            groups.setdefault(configuration.bends, []).append(configuration)
        return groups


def reach(
    scenario: Scenario, *, seed: int | None = None, progress: Progress = lambda share: None,
    threads: int = 0,
) -> Reach:  # fmt: skip
    """Look for closed configurations inside the limits that meet a scenario's tasks at their goals.

    Of a scenario with phases the first counts. ``seed`` is of the random starts, the scenario's
    when omitted. As many ``threads`` bring these to the manifold, all cores when 0; their number
    changes no answer.

    Raises:
        CoopqpError: no task asks for a place, or the kernel is not built.
    """
    needs_scenario(scenario)
    problem, t = scenario.problem(), scenario.schedule[0].duration
    seed = scenario.seed if seed is None else seed
    need_a_place(problem)
    if proof := too_far(problem, t):
        return Reach((), True, proof)
    goals = Goals(problem, t, seed, threads or os.cpu_count() or 1)
    for _ in range(MAX_TRIES // BATCH):
        goals.look()
        share = min(len(goals.solutions) / ENOUGH, goals.tried / MIN_TRIES)
        progress(max(goals.tried / MAX_TRIES, share))
        if len(goals.solutions) >= ENOUGH and goals.tried >= MIN_TRIES:
            break
    why = "" if goals.solutions or goals.cut_off else explained(goals)
    progress(1.0)
    if why:
        return Reach((), False, why, goals.tried)
    found = described(goals)
    groups = len({one.bends for one in found})
    sentence = f"reachable: {counted(len(found), 'configuration')} found"
    sentence += f", which bend the arms in {counted(groups, 'way')}"
    if goals.cut_off:
        of_them = f"{len(goals.cut_off)} of them" if goals.solutions else "all of them"
        sentence += f"; {of_them} no motion leads to: {goals.why}"
    return Reach(found, False, sentence, goals.tried)


def need_a_place(problem: ControlProblem) -> None:
    """Raise an InvalidValueError where no task has a place, as where all ask for velocities."""
    if not placed(problem.tasks, problem.chain):
        with under("tasks"):
            raise InvalidValueError("no task asks for a place, so there is nothing to reach")


class Goals:
    """Closed, free configurations that meet a problem's tasks at t [s], as they are found."""

    def __init__(self, problem: ControlProblem, t: float, seed: int, threads: int = 1) -> None:
        self.goal = Goal(problem.chain, placed(problem.tasks, problem.chain), t)
        self.space = ClosedSpace(problem, self.goal.tasks, t, threads)
        self.solutions: list[Array] = []  # to which a motion may lead, shape (n,) each
        self.cut_off: list[Array] = []  # to which none leads from the start
        self._why: list[str] = []
        self.lost: list[Bound] = []  # of others, where hands that press carry less than the object
        self._presses = any(hand.contact for hand in hands(problem.chain))
        self.tried = 0  # random starts
        self._rng = seeded(seed)

    def look(self) -> None:
        """Try random configurations, in turns from the start to half the way there and anywhere."""
        q = self.space.sample(self._rng, BATCH)
        if not self.tried // BATCH % 2:
            start, share = self.space.chain.q_start, np.linspace(0.0, 0.5, BATCH)[:, None]
            q = start + share * (q - start)
        self.tried += len(q)
        self.take(q[self.space.project(q)])

    def take(self, q: Array) -> None:
        """Keep of closed configurations, (k, n), those that are free and meet the tasks."""
        if not len(q):
            return
        q = q[self.space.is_free(q)]
        for row, why in zip(q, no_way(self.space, q), strict=True):
            if not self.goal.missed(row) and self._holds(row):
                (self.cut_off if why else self.solutions).append(row.copy())
                self._why += [why] * bool(why)

    @property
    def why(self) -> str:
        """Why no motion leads to those that are cut off."""
        return reasons(self._why)

    def _holds(self, q: Array) -> bool:
        """Whether motors and friction, with the laws' safety, hold the object where hands press."""
        if not self._presses:
            return True
        load = StaticHold(self.space.chain, q, safety=SAFETY).load()
        if load.value < 1.0:
            self.lost.append(load)
        return load.value >= 1.0


def explained(goals: Goals) -> str:
    """Nothing was found by Newton steps: why, by the searches of explain, which also descend.

    Empty where these find something, which is among ``goals.solutions`` or ``cut_off`` then.
    """
    if goals.lost:
        load = max(goals.lost, key=lambda bound: bound.value)
        there = counted(len(goals.lost), "configuration")
        return (
            f"not found from {goals.tried} starts: inside the other limits {there} found, but "
            f"hands hold at most {100.0 * load.value:.0f} % of the object's weight there, as "
            f"{load.holds}"
        )
    goal, space = goals.goal, goals.space
    q = space.chain.q_start
    missed = goal.missed(Search(goal, space.bounds).from_(q).q)
    found = diagnose(goal, space.bounds, q)
    place = found.elsewhere if isinstance(found, BlockedByLimits) else getattr(found, "place", None)
    if place:
        goals.take(place.q[None].copy())
    if goals.solutions or goals.cut_off:
        return ""
    tried = f"not found from {goals.tried} starts"
    if isinstance(found, NotBlocked):
        return f"{tried}: it is met only where limits just touch"
    if isinstance(found, BlockedByLimits):
        near = words.stops_short(*(goal.missed(found.place.q) or missed)[0])
        return f"{tried}: {near}; {words.holding(found.shares)}"
    sentence = words.geometry(found, missed, space.chain, ordered=False)
    sentence = sentence.replace(" is unreachable by ", " stays off by ")  # nothing proves more
    return f"{tried}: {sentence}"


def described(goals: Goals) -> tuple[Configuration, ...]:
    """Configurations with their margins and bends, groups together, the largest margins first."""
    space, found = goals.space, [*goals.solutions, *goals.cut_off]
    bends = _bends(space.chain, found)
    all_of_them = []
    for i, (q, bend) in enumerate(zip(found, bends, strict=True)):
        joints = float(
            np.minimum(q - space.bounds.lower, space.bounds.upper - q).min(initial=np.inf)
        )
        clearance = float(space.bounds.at(q).min(initial=np.inf))
        all_of_them.append(Configuration(q, joints, clearance, bend, i >= len(goals.solutions)))
    best: dict[str, float] = {}
    for one in all_of_them:
        best[one.bends] = max(best.get(one.bends, -np.inf), one.joint_margin)
    return tuple(
        sorted(all_of_them, key=lambda one: (-best[one.bends], one.bends, -one.joint_margin))
    )


def _bends(chain: ClosedChain, found: Sequence[Array]) -> list[str]:
    data, model = chain.model.createData(), chain.model
    labels: list[list[str]] = [[] for _ in found]
    for arm, frame in zip(
        chain.arms[chain.standing :], chain.frames[chain.standing :], strict=True
    ):
        names = chain.robot.arm_joints(arm)
        columns = [chain.joint_names.index(name) for name in names]
        base = model.getJointId(names[0])
        rates = []
        for q in found:
            pin.computeJointJacobians(model, data, q)
            X = pin.updateFramePlacement(model, data, frame)
            J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[:3, columns]
            away = X.translation - data.oMi[base].translation
            rates.append(away @ J / max(float(np.linalg.norm(away)), ROUNDING))
        bend = int(np.median(np.abs(rates), axis=0).argmax())
        for label, rate in zip(labels, rates, strict=True):
            label.append(f"{arm.name} {names[bend]} {'+' if rate[bend] >= 0.0 else '-'}")
    return [", ".join(label) for label in labels]


def too_far(problem: ControlProblem, t: float) -> str:
    """The proof that a point's goal is beyond an arm's length; empty where there is none."""
    chain = problem.chain
    programs, at = Programs(State(chain)), State(chain, t=t)
    for task in placed(problem.tasks, chain):
        for primitive in programs.of(task) or ():
            if primitive.kind is not Kind.POINT or len(primitive.rows) < 3:
                continue
            primitive.reference.update(at)
            for arm, frame in zip(
                chain.arms[: len(chain.hold.holders)], chain.frames, strict=False
            ):
                base, length = _length(chain, frame, np.array(primitive.point, float))
                away = float(np.linalg.norm(primitive.reference.c - base))
                beyond = away - length - max(part.tolerance for part in task.parts(chain))
                if beyond > ROUNDING:
                    return (
                        f"{PROVEN}: the goal of {task.name} is {away:.3f} m from the "
                        f"base of {arm.name}, which is {length:.3f} m long up to the object's point"
                    )
    return ""


def _length(chain: ClosedChain, frame: int, p_O: Array) -> tuple[Array, float]:
    """Where an arm's first joint is, and its length from there to a point of the object [m].

    A joint that slides adds what its range allows; without limits the length is infinite.
    """
    model = chain.model
    first, *joints = [j for j in model.supports[model.frames[frame].parentJoint] if j > 0]
    length = float(np.linalg.norm(model.frames[frame].placement.act(p_O)))
    for j in joints:
        length += float(np.linalg.norm(model.jointPlacements[j].translation))
    for j in (first, *joints):
        i = model.idx_vs[j]
        if chain.joint_units[i] == "m":
            length += float(np.abs([chain.lower[i], chain.upper[i]]).max())
    return model.jointPlacements[first].translation.copy(), length


def parts(chain: ClosedChain, q: Array) -> NDArray[np.int_]:
    """Of closed configurations (N, n) the sign of each arm's lift against the first arm's.

    Shape (N, arms - 1); equal rows may be connected by a motion, others never are.
    """
    first, *rest = (_lifted(chain, frame, q) for frame in chain.frames[: chain.holding])
    signs = [np.sign(np.einsum("nab,nab->n", first.conj(), lift).real) for lift in rest]
    return np.array(signs, int).reshape(len(rest), len(q)).T


def cut_off(chain: ClosedChain, q: Array) -> NDArray[np.bool_]:
    """Of closed configurations (N, n), to which ones no motion leads from the start."""
    found = parts(chain, np.vstack([chain.q_start, q]))
    return np.asarray((found[1:] != found[0]).any(axis=1))


def no_way(space: ClosedSpace, q: Array) -> list[str]:
    """Of closed configurations (N, n) why no motion leads there; empty where nothing proves so."""
    turned, wound = cut_off(space.chain, q), np.zeros(len(q), bool)
    if space.line and not turned.all():
        rest = np.vstack([space.chain.q_start, q[~turned]])
        wound[~turned] = space.line.differs(rest)[1:] != 0
    return [CUT_OFF if a else WOUND if b else "" for a, b in zip(turned, wound, strict=True)]


def reasons(found: Sequence[str]) -> str:
    """Each once, in words."""
    return "; to others, ".join(dict.fromkeys(filter(None, found)))


def _lifted(chain: ClosedChain, frame: int, q: Array) -> NDArray[np.complex128]:
    """The lift of a frame's attitude at each row of q, shape (N, 2, 2)."""
    model, placement = chain.model, chain.model.frames[frame].placement
    found = np.tile(np.eye(2, dtype=complex), (len(q), 1, 1))
    for j in model.supports[model.frames[frame].parentJoint]:
        axis = axis_of(model.joints[j]) if j else None
        if axis is not None:
            fixed = _lift(pin.log3(model.jointPlacements[j].rotation)[None])
            found = found @ fixed @ _lift(q[:, model.idx_qs[j], None] * axis[3:])
    return np.asarray(found @ _lift(pin.log3(placement.rotation)[None]))


def _lift(w: Array) -> NDArray[np.complex128]:
    half = 0.5 * np.linalg.norm(w, axis=1)[:, None, None]
    turned = np.sinc(half / np.pi) * np.einsum("nk,kab->nab", w, _PAULI)
    return np.asarray(np.cos(half) * np.eye(2) - 0.5j * turned)
