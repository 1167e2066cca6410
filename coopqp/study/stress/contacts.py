"""Random rollouts of hands that press, on rigid bodies: what the torque QP says it keeps, it keeps.

A loss is named after what the law gave up, or after the errors without which the draw is held.
What is lost without errors, though the law gave nothing up, breaks the promise: a pad that tips
over its edge, or what has no name.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from coopqp.checked import Array
from coopqp.closed_loop.hands import into_contacts
from coopqp.contact import NO_CONTACT
from coopqp.controller import Command
from coopqp.controllers.torque_qp import TorqueQpLaw
from coopqp.disturbance import Disturbance
from coopqp.errors import CoopqpError, MissingDependencyError
from coopqp.plants.rigid_body import RigidBody
from coopqp.rollout import drive
from coopqp.solver import Solver, Status
from coopqp.state import State
from coopqp.study.engine import Engine
from coopqp.study.stress.draw import DAQP
from coopqp.study.stress.pressing import NOTHING, PressingDraw, draw_pressing
from coopqp.study.stress.trial import HERE, gathered

TICKS = 300
EVERY = 10  # ticks in which round cones are asked as well
KEPT = 1e-6  # a row may be left by rounding [N, N m]
ROUND = 1.01  # friction of round cones is told to half a percent
SOLD = 1e-9  # a motor may be beyond its limit by rounding [N m]
OUTCOMES = ("held", "lost", "refused")
BODIES = RigidBody()


@dataclass(frozen=True)
class ContactRollout:
    """How one rollout went.

    Attributes:
        seed: from which it can be repeated.
        robot, grasp, errors, tasks: as drawn.
        outcome: one of ``OUTCOMES``; empty when it raised.
        reason: why it was lost or refused.
        cause: what a loss is named after: what gave up, or the errors; empty where nothing does.
        broken: promises that were broken, in words.
        ticks: how many.
        given_up: ticks in which a cone was given up, or there was no answer.
        cone, torque: how far a cone that was kept, or a motor's limit, was left [N], [N m].
    """

    seed: int
    robot: str = ""
    grasp: str = ""
    errors: str = ""
    tasks: tuple[str, ...] = ()
    outcome: str = ""
    reason: str = ""
    cause: str = ""
    broken: tuple[str, ...] = ()
    ticks: int = 0
    given_up: int = 0
    cone: float = 0.0
    torque: float = 0.0


@dataclass
class Seen:
    """What a run shows.

    Attributes:
        ticks, given_up, cone, torque: as in :class:`ContactRollout`.
        round_left: whether round cones did not bear what the law said to keep.
        lost: why; empty while held.
        tipped: whether a pad's pressure was beyond its edge then.
    """

    ticks: int = 0
    given_up: Counter[str] = field(default_factory=Counter)
    cone: float = 0.0
    torque: float = 0.0
    round_left: bool = False
    lost: str = ""
    tipped: bool = False

    @property
    def broken(self) -> tuple[str, ...]:
        """Promises that were broken, in words."""
        said = {
            f"left a cone that it kept by {self.cone:.2g}": self.cone > KEPT,
            "left a round cone that it kept": self.round_left,
            f"exceeded a torque limit by {self.torque:.2g} N m": self.torque > SOLD,
        }
        return tuple(words for words, true in said.items() if true)


def stress_contacts(
    count: int,
    solver: Solver = DAQP,
    *,
    seed: int = 0,
    engine: Engine = HERE,
    progress: Callable[[int], None] | None = None,
) -> list[ContactRollout]:
    """Run many rollouts; arguments as for :func:`coopqp.study.stress.stress`."""
    work = partial(_rollouts, solver=solver)
    return gathered(work, range(seed, seed + count), _ended, engine, progress)


def _ended(seed: int, reason: str) -> ContactRollout:
    return ContactRollout(seed, broken=(reason,))


def _rollouts(seeds: Sequence[int], *, solver: Solver) -> list[ContactRollout]:
    return [contact_rollout(seed, solver) for seed in seeds]


def contact_rollout(seed: int, solver: Solver = DAQP) -> ContactRollout:
    """Draw a rollout from a seed and run it; an exception is a broken promise, not raised."""
    try:
        return _judged(seed, solver)
    except MissingDependencyError:
        raise
    except Exception as error:  # noqa: BLE001 - this is what the stress test looks for
        return ContactRollout(seed, broken=(f"raised {type(error).__name__}: {error}",))


def _judged(seed: int, solver: Solver) -> ContactRollout:
    drawn = draw_pressing(seed, solver)
    begun = ContactRollout(seed, drawn.robot, drawn.grasp, drawn.errors, drawn.tasks)
    try:
        drawn.controller.build(drawn.problem)
    except CoopqpError as error:
        return replace(begun, outcome="refused", reason=str(error))
    seen = watched(drawn, seed, drawn.disturbance)
    cause, unnamed = _named(drawn, seed, seen)
    return replace(
        begun,
        outcome="lost" if seen.lost else "held",
        reason=seen.lost,
        cause=cause,
        broken=(*seen.broken, *unnamed),
        ticks=seen.ticks,
        given_up=seen.given_up.total(),
        cone=seen.cone,
        torque=seen.torque,
    )


def _named(drawn: PressingDraw, seed: int, seen: Seen) -> tuple[str, tuple[str, ...]]:
    """What a loss is named after, and in words that it has no name."""
    if not seen.lost:
        return "", ()
    if seen.given_up:
        return "given up", ()
    exact = seen
    if drawn.disturbance != NOTHING:
        exact = watched(drawn, seed, NOTHING)
        if not exact.lost:
            return drawn.errors, ()
        if exact.given_up:
            return "given up", ()
    if exact.tipped:
        return "edge", (f"tips over a pad's edge that it kept: {exact.lost}",)
    return "", (f"lost without a name: {exact.lost}",)


def watched(drawn: PressingDraw, seed: int, disturbance: Disturbance) -> Seen:
    """Run a draw on rigid bodies, and look at every tick until the object is lost.

    Args:
        drawn: the problem.
        seed: of the plant.
        disturbance: what the controller is not told.
    """
    law = drawn.controller.build(drawn.problem)
    assert isinstance(law, TorqueQpLaw)
    plant = BODIES.build(drawn.problem, seed, disturbance)
    state, seen = law.start(), Seen()
    for command, _ in drive(law, plant, state, TICKS):
        if plant.lost:
            break
        look(law, state, command, seen)
    seen.lost = plant.lost
    seen.tipped = bool(plant.lost) and _tipped(
        law, plant.signals["hand_wrench"], plant.truth(state)
    )
    return seen


def _tipped(law: TorqueQpLaw, told: Array, true: State) -> bool:
    """Whether a hand presses, but no friction at all would bear what it does."""
    robot = [arm.name for arm in law.problem.chain.robot.arms]
    by_arm, turned = told.reshape(-1, 6), into_contacts(law.hands.hands, true.R_WO)
    for hand, R in zip(law.hands.hands, turned, strict=True):
        did = by_arm[robot.index(hand.arm)]
        w = np.concatenate([R @ did[:3], R @ did[3:]])
        assert hand.contact
        if w[2] > NO_CONTACT and np.isinf(hand.contact.needed(w)):
            return True
    return False


def look(law: TorqueQpLaw, state: State, command: Command, seen: Seen) -> None:
    """Check what a tick commands, and what it says that it keeps.

    Args:
        law: after the tick.
        state: of the tick.
        command: of the tick.
        seen: written.
    """
    assert command.tau is not None
    seen.ticks += 1
    effort = law.problem.chain.model.effortLimit
    seen.torque = max(seen.torque, float((np.abs(command.tau) - effort).max()))
    for status in command.causes:
        if status is Status.CONTACT_GIVEN_UP or not status.usable:
            seen.given_up[status.name] += 1
            return
    h = law.programs[-1].solution.v[law.layout.h]
    left = (law.hands.cones @ h - law.hands.most).max()
    seen.cone = max(seen.cone, float(left))
    if seen.ticks % EVERY == 1:
        seen.round_left |= not _borne(law, h, state)


def _borne(law: TorqueQpLaw, h: Array, state: State) -> bool:
    """Whether round cones bear what each hand does, with the friction that is counted on."""
    turned = into_contacts(law.hands.hands, state.R_WO)
    for hand, did, R in zip(law.hands.hands, h.reshape(-1, 6), turned, strict=True):
        assert hand.contact
        needed = hand.contact.needed(np.concatenate([R @ did[:3], R @ did[3:]]))
        if needed > ROUND * hand.contact.friction / law.settings.safety:
            return False
    return True


@dataclass(frozen=True)
class ContactSummary:
    """One line of the table: rollouts of one kind.

    Attributes:
        kind: such as "baxter", "pads", "errors none" or "all".
        count: of rollouts.
        outcomes: by name.
        causes: of losses, by name.
        broken: rollouts that broke a promise.
        ticks, given_up: of all rollouts.
        cone, torque: the worst of them [N], [N m].
    """

    kind: str
    count: int
    outcomes: dict[str, int]
    causes: dict[str, int]
    broken: int
    ticks: int
    given_up: int
    cone: float
    torque: float


def summarize_contacts(rollouts: Sequence[ContactRollout]) -> list[ContactSummary]:
    """By robot, grasp and errors, and all together."""
    kinds: dict[str, list[ContactRollout]] = {}
    for key in ("robot", "grasp", "errors"):
        for r in sorted(rollouts, key=lambda r: str(getattr(r, key))):
            if word := str(getattr(r, key)):
                kinds.setdefault(f"errors {word}" if key == "errors" else word, []).append(r)
    kinds["all"] = list(rollouts)
    return [_summary(kind, of_kind) for kind, of_kind in kinds.items()]


def _summary(kind: str, of_kind: Sequence[ContactRollout]) -> ContactSummary:
    return ContactSummary(
        kind,
        len(of_kind),
        dict(sorted(Counter(r.outcome or "raised" for r in of_kind).items())),
        dict(sorted(Counter(r.cause or "no name" for r in of_kind if r.outcome == "lost").items())),
        sum(bool(r.broken) for r in of_kind),
        sum(r.ticks for r in of_kind),
        sum(r.given_up for r in of_kind),
        max(r.cone for r in of_kind),
        max(r.torque for r in of_kind),
    )
